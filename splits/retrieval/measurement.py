"""What was measured: reflectances over wavelengths or bands, and how far they may be off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import align_to_labels, as_1d_array, check_increasing, find_labels
from splits.core.validation import ROUNDING_TOLERANCE, check_range, invalid
from splits.illumination.bands import SpectralBand, as_bands

MAX_REFLECTANCE = 2.0
"""Reflectance factor above which the numbers are taken for per cent."""
NOISE_KEYS = ("stderr", "correlation_nm", "independent")
UNKNOWN_NOISE_STDERR = 1.0
"""Errors of all wavelengths where none are known, so large that all weigh alike."""
MAX_NOISE_STDERR = 3.0
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
    noise_known : bool
        Whether the noise is known; else its covariance means nothing but equal weights.
    """

    values: np.ndarray
    wavelength_nm: np.ndarray
    covariance: np.ndarray
    bands: dict[str, SpectralBand]
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
        some = as_bands(bands)
        w, values = _read_bands(measured, some) if some else _read_spectrum(measured)
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            where = f"in band {[*some][gaps[0]]}" if some else f"at {w[gaps[0]]:g} nm"
            hint = "masked, NaN or missing: leave those out"
            raise invalid("measured", f"{gaps.size} gaps, the first {where}", "numbers", hint)
        if np.abs(values).max() > MAX_REFLECTANCE:
            largest = float(values[np.abs(values).argmax()])
            raise invalid(
                "measured", largest, f"at most {MAX_REFLECTANCE:g}", "a share, not per cent"
            )
        if noise is None:
            return cls(values, w, UNKNOWN_NOISE_STDERR**2 * np.eye(values.size), some, False)
        return cls(values, w, _make_covariance("noise", noise, w, list(some)), some)

    def check_noise_known(self) -> Measurement:
        """Return it, or refuse noise that is not known."""
        if not self.noise_known:
            raise invalid("noise", None, "given", "only splits.retrieve finds it from the misfit")
        return self


def _read_bands(measured: Any, bands: Mapping[str, SpectralBand]) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles (nm) and the reflectances of bands, or refuse them."""
    values = np.atleast_1d(align_to_labels("measured", measured, list(bands), allow_gaps=True))
    if values.shape != (len(bands),):
        raise invalid("measured", f"{values.size} values", f"{len(bands)}, one for each band")
    return np.array([_compute_mean_wavelength(band) for band in bands.values()]), values


def _read_spectrum(measured: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return wavelengths and reflectances, or refuse them."""
    allowed = "a DataArray over wavelength, a Series, or (wavelengths, reflectances)"
    if isinstance(measured, pd.DataFrame):
        if measured.shape[1] != 1:
            hint = "choose one: frame['name'], with wavelengths (nm) for an index"
            raise invalid("measured", f"a DataFrame of {measured.shape[1]} columns", allowed, hint)
        measured = measured.iloc[:, 0]
    if isinstance(measured, xr.DataArray):
        if measured.dims != ("wavelength",) or "wavelength" not in measured.coords:
            raise invalid("measured", f"over {', '.join(map(str, measured.dims))}", allowed)
        pair: Any = (measured.wavelength.values, measured.values)
    elif isinstance(measured, pd.Series):
        if isinstance(measured.index, pd.RangeIndex) and measured.index.start == 0:
            hint = "pandas.read_csv(file, index_col=0)['name'], where the first column has them"
            raise invalid("measured", "a Series that is only counted",
                         "one over wavelengths (nm)", hint)  # fmt: skip
        pair = (measured.index.to_numpy(), measured.to_numpy())
    elif isinstance(measured, tuple | list) and len(measured) == 2:
        pair = measured
    else:
        raise invalid("measured", type(measured).__name__, allowed)
    w = check_increasing("measured (wavelengths)", as_1d_array("measured (wavelengths)", pair[0]))
    values = align_to_labels("measured", pair[1], w, find_labels(pair[0]), allow_gaps=True)
    if values.shape != w.shape:
        found = f"{w.size} wavelengths, {values.size} values"
        raise invalid("measured", found, "as many of both")
    return w, values


def _make_covariance(
    key: str, noise: Any, wavelength_nm: np.ndarray, bands: Sequence[str]
) -> np.ndarray:
    """Return the covariance of noise, in the order of wavelengths or bands, or refuse it."""
    count = wavelength_nm.size
    allowed = f"standard errors above 0, one or {count} of them, or their covariance"
    if isinstance(noise, Mapping):
        return _make_correlated_covariance(noise, wavelength_nm, bands)
    # Wavelengths that are only counted tell nothing; bands have an order.
    labels = [bands] if bands else [wavelength_nm]
    given = align_to_labels(key, noise, *labels, allowed=allowed, ignore_default_labels=bool(bands))
    if given.shape == (count, count):
        if not np.allclose(given, given.T, rtol=ROUNDING_TOLERANCE, atol=0.0):
            raise invalid(key, "a matrix that is not symmetric", allowed)
        if not np.linalg.eigvalsh(given)[0] > 0.0:
            raise invalid(key, "a matrix that is not positive definite", allowed)
        if np.diag(given).max() >= MAX_NOISE_STDERR**2:
            largest = float(np.diag(given).max())
            raise invalid(key, f"a variance of {largest:g}", f"below {MAX_NOISE_STDERR**2:g}")
        return given
    if given.shape not in ((), (count,)):
        raise invalid(key, f"of shape {given.shape}", allowed)
    wrong = ~((given > 0.0) & (given < MAX_NOISE_STDERR))
    if wrong.any():
        hint = "no measurement is without noise"
        raise invalid(key, float(given[wrong].flat[0]), allowed, hint)
    return np.diag(np.broadcast_to(given, (count,)) ** 2)


def _make_correlated_covariance(
    noise: Mapping[str, Any], wavelength_nm: np.ndarray, bands: Sequence[str]
) -> np.ndarray:
    """Return the covariance of noise that is alike at near wavelengths, or refuse it."""
    if not {"stderr", "correlation_nm"} <= set(noise) <= {*NOISE_KEYS}:
        raise invalid("noise", sorted(map(str, noise)), " and ".join(NOISE_KEYS[:2]))
    length = check_range("noise.correlation_nm", noise["correlation_nm"], 0.0, 1e5, open_low=True)
    if np.ndim(noise["stderr"]) > 1:
        raise invalid(
            "noise.stderr", "a matrix", f"one standard error or {wavelength_nm.size} of them"
        )
    own: Any = 0.0
    stderr = _make_covariance("noise.stderr", noise["stderr"], wavelength_nm, bands)
    if "independent" in noise:
        own = _make_covariance("noise.independent", noise["independent"], wavelength_nm, bands)
    apart = np.abs(wavelength_nm[:, np.newaxis] - wavelength_nm)
    error = np.sqrt(np.diag(stderr))
    together: np.ndarray = np.exp(-apart / length) * error[:, np.newaxis] * error + own
    return together


def _compute_mean_wavelength(band: SpectralBand) -> float:
    """Return the mean wavelength (nm) of a band."""
    w = np.linspace(*band.limits_nm, 501)
    response = np.interp(w, band.wavelength_nm, band.response)
    return float((w * response).sum() / response.sum())
