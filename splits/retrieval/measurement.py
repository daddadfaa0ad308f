"""What was measured: reflectances over wavelengths or bands, and how far they may be off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.arrays import find_labels, increasing, read_in_order, row_of
from splits.checks import ROUNDING, in_range, refuse
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
    noise_known: bool = True

    @classmethod
    def from_input(cls, measured: Any, noise: Any, bands: Any = None) -> Measurement:
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
        w, values = _in_bands(measured, some) if some else _spectrum(measured)
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            where = f"in band {[*some][gaps[0]]}" if some else f"at {w[gaps[0]]:g} nm"
            hint = "masked, NaN or missing: leave those out"
            raise refuse("measured", f"{gaps.size} gaps, the first {where}", "numbers", hint)
        if np.abs(values).max() > PER_CENT:
            largest = float(values[np.abs(values).argmax()])
            raise refuse("measured", largest, f"at most {PER_CENT:g}", "a share, not per cent")
        if noise is None:
            return cls(values, w, EVEN**2 * np.eye(values.size), some, False)
        return cls(values, w, _covariance("noise", noise, w, list(some)), some)

    def check_noise_known(self) -> Measurement:
        """Return it, or refuse noise that is not known."""
        if not self.noise_known:
            raise refuse("noise", None, "given", "only splits.retrieve finds it from the misfit")
        return self


def _in_bands(measured: Any, bands: Mapping[str, Band]) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles (nm) and the reflectances of bands, or refuse them."""
    values = np.atleast_1d(read_in_order("measured", measured, list(bands), allow_gaps=True))
    if values.shape != (len(bands),):
        raise refuse("measured", f"{values.size} values", f"{len(bands)}, one for each band")
    return np.array([_middle(band) for band in bands.values()]), values


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
    w = increasing("measured (wavelengths)", row_of("measured (wavelengths)", pair[0]))
    values = read_in_order("measured", pair[1], w, find_labels(pair[0]), allow_gaps=True)
    if values.shape != w.shape:
        found = f"{w.size} wavelengths, {values.size} values"
        raise refuse("measured", found, "as many of both")
    return w, values


def _covariance(
    key: str, noise: Any, wavelength_nm: np.ndarray, bands: Sequence[str]
) -> np.ndarray:
    """Return the covariance of noise, in the order of wavelengths or bands, or refuse it."""
    count = wavelength_nm.size
    allowed = f"standard errors above 0, one or {count} of them, or their covariance"
    if isinstance(noise, Mapping):
        return _alike(noise, wavelength_nm, bands)
    # Wavelengths that are only counted tell nothing; bands have an order.
    labels = [bands] if bands else [wavelength_nm]
    given = read_in_order(key, noise, *labels, allowed=allowed, ignore_default_labels=bool(bands))
    if given.shape == (count, count):
        if not np.allclose(given, given.T, rtol=ROUNDING, atol=0.0):
            raise refuse(key, "a matrix that is not symmetric", allowed)
        if not np.linalg.eigvalsh(given)[0] > 0.0:
            raise refuse(key, "a matrix that is not positive definite", allowed)
        if np.diag(given).max() >= LARGEST**2:
            largest = float(np.diag(given).max())
            raise refuse(key, f"a variance of {largest:g}", f"below {LARGEST**2:g}")
        return given
    if given.shape not in ((), (count,)):
        raise refuse(key, f"of shape {given.shape}", allowed)
    wrong = ~((given > 0.0) & (given < LARGEST))
    if wrong.any():
        hint = "no measurement is without noise"
        raise refuse(key, float(given[wrong].flat[0]), allowed, hint)
    return np.diag(np.broadcast_to(given, (count,)) ** 2)


def _alike(noise: Mapping[str, Any], wavelength_nm: np.ndarray, bands: Sequence[str]) -> np.ndarray:
    """Return the covariance of noise that is alike at near wavelengths, or refuse it."""
    if not {"stderr", "correlation_nm"} <= set(noise) <= {*ALIKE}:
        raise refuse("noise", sorted(map(str, noise)), " and ".join(ALIKE[:2]))
    length = in_range("noise.correlation_nm", noise["correlation_nm"], 0.0, 1e5, open_low=True)
    if np.ndim(noise["stderr"]) > 1:
        raise refuse(
            "noise.stderr", "a matrix", f"one standard error or {wavelength_nm.size} of them"
        )
    own: Any = 0.0
    stderr = _covariance("noise.stderr", noise["stderr"], wavelength_nm, bands)
    if "independent" in noise:
        own = _covariance("noise.independent", noise["independent"], wavelength_nm, bands)
    apart = np.abs(wavelength_nm[:, np.newaxis] - wavelength_nm)
    error = np.sqrt(np.diag(stderr))
    together: np.ndarray = np.exp(-apart / length) * error[:, np.newaxis] * error + own
    return together


def _middle(band: Band) -> float:
    """Return the mean wavelength (nm) of a band."""
    w = np.linspace(*band.limits_nm, 501)
    response = np.interp(w, band.wavelength_nm, band.response)
    return float((w * response).sum() / response.sum())
