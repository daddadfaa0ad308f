"""Mean sensitivity index (MSI) of a spectrum to a parameter, with its error.

SPLITSnow section 5.4 (after Hamby 1994): the mean over wavelengths of |y − ŷ| / max(y, ŷ) for the
spectra y and ŷ at a parameter's extremes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from splits.core.uncertainty import compute_weighted_error

NOISE_THRESHOLD_SIGMA = 2.0
"""Threshold of the larger value, in its standard errors, for a wavelength to count."""


@dataclass(frozen=True)
class SensitivityIndex:
    """A mean sensitivity index.

    Attributes
    ----------
    index : float
        MSI over all wavelengths.  Where both values are below the noise, the ratio is undefined and
        counts as 0, as for two zeros of an analog run.
    stderr : float
        Standard error; from `compute_mean_sensitivity_index` an upper bound that assumes fully
        correlated errors of all wavelengths.  It includes the effect of wavelengths near the noise
        threshold, which are counted in some runs only.
    index_resolved : float
        MSI over the wavelengths above the noise only.
    resolved_fraction : float
        Fraction of wavelengths above the noise.
    """

    index: float
    stderr: float
    index_resolved: float
    resolved_fraction: float


def compute_spectral_sensitivity(
    y: xr.Dataset, z: xr.Dataset, quantity: str, floor: float = 0.0
) -> SensitivityIndex:
    """Return the mean sensitivity index of two simulated spectra.

    Its error includes the correlation of errors along each spectrum, see `splits.core.uncertainty`.

    Parameters
    ----------
    y, z : xarray.Dataset
        Independent outputs of `splits.spectrophotometer` over ``wavelength``.
    quantity : str
        Name of the quantity, such as ``reflectance``.
    floor : float
        Value below which both spectra count as 0.
    """
    values = [
        np.asarray(spectrum[name].values, dtype=float)
        for spectrum in (y, z)
        for name in (quantity, f"{quantity}_stderr")
    ]
    is_dark = np.maximum(values[0], values[2]) < floor
    values = [np.where(is_dark, 0.0, value) for value in values]
    index = compute_mean_sensitivity_index(*values)
    larger, _, divisor, is_above_noise = _compare_with_noise(*values)
    smaller = np.minimum(values[0], values[2])
    # Derivatives of |y - z| / max: smaller/larger² by the larger value, -1/larger by the smaller.
    slope_larger, slope_smaller = smaller / divisor**2, -1.0 / divisor
    y_is_larger = values[0] >= values[2]
    variance = 0.0
    for spectrum, is_larger in ((y, y_is_larger), (z, ~y_is_larger)):
        slope = (
            np.where(is_above_noise, np.where(is_larger, slope_larger, slope_smaller), 0.0)
            / larger.size
        )
        error = compute_weighted_error(spectrum, quantity, xr.DataArray(slope, dims="wavelength"))
        variance += float(error) ** 2
    return replace(
        index, stderr=float(np.hypot(variance**0.5, _estimate_threshold_error(*values).mean()))
    )


def _compare_with_noise(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the larger values, their errors, nonzero divisors, and which exceed the noise."""
    larger = np.maximum(y, z)
    error = np.where(y >= z, y_stderr, z_stderr)
    is_above_noise = larger > NOISE_THRESHOLD_SIGMA * error
    return larger, error, np.where(is_above_noise, larger, 1.0), is_above_noise


def _estimate_threshold_error(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> np.ndarray:
    """Return the error due to wavelengths near the noise threshold.

    With the probability p to count, √(p (1 − p)) ≤ exp(−d²/4)/2 at a distance d from the threshold.
    """
    larger, error, _, _ = _compare_with_noise(y, y_stderr, z, z_stderr)
    limit = NOISE_THRESHOLD_SIGMA * error
    tiny = np.finfo(float).tiny
    distance = np.abs(larger - limit) / np.maximum(error, tiny)
    max_ratio = 1.0 - np.minimum(y, z) / np.maximum(np.maximum(larger, limit), tiny)
    return np.where(
        limit > 0.0, 0.5 * max_ratio * np.exp(-0.25 * np.minimum(distance, 50.0) ** 2), 0.0
    )


def compute_mean_sensitivity_index(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> SensitivityIndex:
    """Return the mean sensitivity index of two spectra.

    Parameters
    ----------
    y, z : array_like, shape (wavelengths,)
        Reflectance or transmittance at the two extremes of a parameter.
    y_stderr, z_stderr : array_like
        Their standard errors.
    """
    y, y_stderr, z, z_stderr = (
        np.asarray(array, dtype=float) for array in (y, y_stderr, z, z_stderr)
    )
    larger, error_of_larger, divisor, is_above_noise = _compare_with_noise(y, y_stderr, z, z_stderr)
    smaller = np.minimum(y, z)
    ratio = np.where(is_above_noise, (larger - smaller) / divisor, 0.0)
    # d ratio = (smaller/larger) · (relative errors in quadrature).
    error_of_smaller = np.where(y >= z, z_stderr, y_stderr)
    error = np.where(
        is_above_noise,
        np.hypot(error_of_smaller, smaller * error_of_larger / divisor) / divisor,
        0.0,
    )
    error = np.hypot(error, _estimate_threshold_error(y, y_stderr, z, z_stderr))
    resolved = float(ratio[is_above_noise].mean()) if is_above_noise.any() else 0.0
    return SensitivityIndex(
        float(ratio.mean()), float(error.mean()), resolved, float(is_above_noise.mean())
    )
