"""What was measured: reflectances over wavelengths or bands, and how far they may be off."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.checks import in_range, increasing, refuse, row_of
from splits.skies.bands import Band, bands_of

PER_CENT = 2.0
"""Reflectance factor above which the numbers are taken for per cent."""
ALIKE = ("stderr", "correlation_nm", "independent")
EVEN = 1.0
"""Errors of all wavelengths where none are known, so large that all weigh alike."""
LARGEST = 3.0
"""Noise of a reflectance above which it says nothing."""


class Measurement(NamedTuple):
    """A spectrum that was measured.

    Attributes
    ----------
    values : float, shape (n,)
    wavelength_nm : float, shape (n,)
        Of bands, where their middle is.
    covariance : float, shape (n, n)
        Of its noise.
    bands : dict of Band
        By name; empty for a spectrum.
    told : bool
        Whether the noise is known; else its covariance means nothing but equal weights.
    """

    values: np.ndarray
    wavelength_nm: np.ndarray
    covariance: np.ndarray
    bands: dict[str, Band]
    told: bool = True

    @classmethod
    def of(cls, measured: Any, noise: Any, bands: Any = None) -> Measurement:
        """Return what a user has measured, or refuse it.

        Parameters
        ----------
        measured : xarray.DataArray, pandas.Series or pair of array_like
            Over ``wavelength`` (nm), or (wavelengths, reflectances); a row where there are bands.
        noise : float, array_like, mapping or None
            None where it is not known.  Standard errors, one or as many as values, or their
            covariance matrix; or a mapping of ``stderr`` and ``correlation_nm``, over which errors
            are alike (what two wavelengths d apart have in common is e^(−d/correlation_nm)), and
            perhaps ``independent`` standard errors besides.
        bands : mapping or str, optional
            As for `splits.albedo`, in the order of the values.

        Raises
        ------
        ValueError
            For gaps, per cent, noise that is not above 0, or numbers that do not go together.
        """
        some = bands_of(bands)
        w, values = (None, row_of("measured", measured)) if some else _spectrum(measured)
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            where = f"value {gaps[0]}" if w is None else f"at {w[gaps[0]]:g} nm"
            raise refuse("measured", f"{gaps.size} gaps, the first {where}", "numbers",
                         "leave those wavelengths out")  # fmt: skip
        if np.abs(values).max() > PER_CENT:
            largest = float(values[np.abs(values).argmax()])
            raise refuse("measured", largest, f"at most {PER_CENT:g}", "a share, not per cent")
        if w is None:
            if len(some) != values.size:
                raise refuse("measured", f"{values.size} values", f"{len(some)}, one for each band")
            w = np.array([_middle(band) for band in some.values()])
        if noise is None:
            return cls(values, w, EVEN**2 * np.eye(values.size), some, False)
        return cls(values, w, _covariance(_aligned(noise, w), w), some)

    def check_told(self) -> Measurement:
        """Return it, or refuse noise that is not known."""
        if not self.told:
            raise refuse("noise", None, "given", "only splits.retrieve finds it from the misfit")
        return self


def _spectrum(measured: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return wavelengths and reflectances, or refuse them."""
    allowed = "a DataArray over wavelength, a Series, or (wavelengths, reflectances)"
    if isinstance(measured, pd.DataFrame):
        if measured.shape[1] != 1:
            hint = "choose one: frame['name'], with wavelengths (nm) for an index"
            raise refuse("measured", f"a DataFrame of {measured.shape[1]} columns", allowed, hint)
        measured = measured.iloc[:, 0]
    if isinstance(measured, xr.DataArray):
        if measured.dims != ("wavelength",) or "wavelength" not in measured.coords:
            raise refuse("measured", f"over {', '.join(map(str, measured.dims))}", allowed)
        pair: Any = (measured.wavelength.values, measured.values)
    elif isinstance(measured, pd.Series):
        if isinstance(measured.index, pd.RangeIndex) and measured.index.start == 0:
            hint = "pandas.read_csv(file, index_col=0)['name'], where the first column has them"
            raise refuse("measured", "a Series that is only counted",
                         "one over wavelengths (nm)", hint)  # fmt: skip
        pair = (measured.index.to_numpy(), measured.to_numpy())
    elif isinstance(measured, tuple | list) and len(measured) == 2:
        pair = measured
    else:
        raise refuse("measured", type(measured).__name__, allowed)
    w = row_of("measured (wavelengths)", pair[0])
    try:
        values = np.asarray(pair[1], dtype=float)
    except (TypeError, ValueError):
        raise refuse("measured", pair[1], "numbers") from None
    if values.shape != w.shape:
        found = f"{w.size} wavelengths, {values.size} values"
        raise refuse("measured", found, "as many of both")
    return increasing("measured (wavelengths)", w), values


def _aligned(noise: Any, wavelength_nm: np.ndarray) -> Any:
    """Return noise; of standard errors that have wavelengths, their values, or refuse others."""
    if isinstance(noise, xr.DataArray) and noise.dims == ("wavelength",):
        noise = noise.to_series()
    if not isinstance(noise, pd.Series):
        return noise
    own = noise.index.to_numpy()
    if own.shape != wavelength_nm.shape or (own != wavelength_nm).any():
        raise refuse("noise", "a Series over other wavelengths", "over those that were measured")
    return noise.to_numpy()


def _covariance(noise: Any, wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the covariance of noise, or refuse it."""
    count = wavelength_nm.size
    allowed = f"standard errors above 0, one or {count} of them, or their covariance"
    if isinstance(noise, Mapping):
        if not {"stderr", "correlation_nm"} <= set(noise) <= {*ALIKE}:
            raise refuse("noise", sorted(map(str, noise)), " and ".join(ALIKE[:2]))
        length = in_range("noise.correlation_nm", noise["correlation_nm"], 0.0, 1e5, open_low=True)
        apart = np.abs(wavelength_nm[:, np.newaxis] - wavelength_nm)
        own = _covariance(noise["independent"], wavelength_nm) if "independent" in noise else 0.0
        if np.ndim(noise["stderr"]) > 1:
            raise refuse("noise.stderr", "a matrix", f"one standard error or {count} of them")
        stderr = np.sqrt(np.diag(_covariance(noise["stderr"], wavelength_nm)))
        together: np.ndarray = np.exp(-apart / length) * stderr[:, np.newaxis] * stderr + own
        return together
    try:
        given = np.asarray(noise, dtype=float)
    except (TypeError, ValueError):
        raise refuse("noise", noise, allowed) from None
    if given.shape == (count, count):
        if not np.allclose(given, given.T, rtol=1e-9, atol=0.0):
            raise refuse("noise", "a matrix that is not symmetric", allowed)
        if not np.linalg.eigvalsh(given)[0] > 0.0:
            raise refuse("noise", "a matrix that is not positive definite", allowed)
        if np.diag(given).max() >= LARGEST**2:
            largest = float(np.diag(given).max())
            raise refuse("noise", f"a variance of {largest:g}", f"below {LARGEST**2:g}")
        return given
    if given.shape not in ((), (count,)):
        raise refuse("noise", f"of shape {given.shape}", allowed)
    wrong = ~((given > 0.0) & (given < LARGEST))
    if wrong.any():
        hint = "no measurement is without noise"
        raise refuse("noise", float(given[wrong].flat[0]), allowed, hint)
    return np.diag(np.broadcast_to(given, (count,)) ** 2)


def _middle(band: Band) -> float:
    """Return the mean wavelength (nm) of a band."""
    w = np.linspace(*band.ends, 501)
    response = np.interp(w, band.wavelength_nm, band.response)
    return float((w * response).sum() / response.sum())
