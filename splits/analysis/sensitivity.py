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
"""A wavelength counts where the larger value exceeds this many of its standard errors."""


@dataclass(frozen=True)
class SensitivityIndex:
    """A mean sensitivity index.

    Attributes
    ----------
    index : float
        MSI over all wavelengths; where both values are below the noise the ratio is undefined
        and counts as 0, as two zeros of a coin-tossing run would.
    stderr : float
        Its standard error, of `compute_spectral_sensitivity`; of `compute_mean_sensitivity_index`
        an upper bound: those of all wavelengths are added linearly, as if all went together.  A
        wavelength near the noise counts in one run and not in another: its ratio, or the most it
        could have at the limit, times the chance of that belongs to them.
    index_resolved : float
        MSI over the wavelengths above the noise only.
    resolved_fraction : float
        Share of wavelengths above the noise.
    """

    index: float
    stderr: float
    index_resolved: float
    resolved_fraction: float


def compute_spectral_sensitivity(
    y: xr.Dataset, z: xr.Dataset, quantity: str, floor: float = 0.0
) -> SensitivityIndex:
    """Return the mean sensitivity index of two measured spectra.

    Its error knows how errors go together along each spectrum, see `splits.core.uncertainty`.

    Parameters
    ----------
    y, z : xarray.Dataset
        Over ``wavelength`` alone, as `splits.spectrophotometer` returns them; independent.
    quantity : str
        Such as ``reflectance``.
    floor : float
        Wavelengths where both are below this count as if there were no light.
    """
    values = [
        np.asarray(one[name].values, dtype=float)
        for one in (y, z)
        for name in (quantity, f"{quantity}_stderr")
    ]
    dark = np.maximum(values[0], values[2]) < floor
    values = [np.where(dark, 0.0, value) for value in values]
    found = compute_mean_sensitivity_index(*values)
    larger, _, safe, seen = _compare_with_noise(*values)
    smaller = np.minimum(values[0], values[2])
    # |y - z| / max: the larger value moves it by smaller/larger², the smaller one by -1/larger.
    up, down = smaller / safe**2, -1.0 / safe
    first = values[0] >= values[2]
    variance = 0.0
    for one, leads in ((y, first), (z, ~first)):
        slope = np.where(seen, np.where(leads, up, down), 0.0) / larger.size
        error = compute_weighted_error(one, quantity, xr.DataArray(slope, dims="wavelength"))
        variance += float(error) ** 2
    return replace(
        found, stderr=float(np.hypot(variance**0.5, _estimate_threshold_error(*values).mean()))
    )


def _compare_with_noise(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the larger values, their errors, safe divisors, and which exceed the noise."""
    larger = np.maximum(y, z)
    error = np.where(y >= z, y_stderr, z_stderr)
    seen = larger > NOISE_THRESHOLD_SIGMA * error
    return larger, error, np.where(seen, larger, 1.0), seen


def _estimate_threshold_error(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> np.ndarray:
    """Return the error of a wavelength that counts in one run and not in another.

    With p the chance to be seen, √(p (1 − p)) is at most exp(−d²/4)/2 at d errors from the limit.
    """
    larger, error, _, _ = _compare_with_noise(y, y_stderr, z, z_stderr)
    limit = NOISE_THRESHOLD_SIGMA * error
    tiny = np.finfo(float).tiny
    away = np.abs(larger - limit) / np.maximum(error, tiny)
    most = 1.0 - np.minimum(y, z) / np.maximum(np.maximum(larger, limit), tiny)
    return np.where(limit > 0.0, 0.5 * most * np.exp(-0.25 * np.minimum(away, 50.0) ** 2), 0.0)


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
    y, y_stderr, z, z_stderr = (np.asarray(a, dtype=float) for a in (y, y_stderr, z, z_stderr))
    larger, error_of_larger, safe, seen = _compare_with_noise(y, y_stderr, z, z_stderr)
    smaller = np.minimum(y, z)
    ratio = np.where(seen, (larger - smaller) / safe, 0.0)
    # d ratio = (smaller/larger) · (relative errors in quadrature).
    error_of_smaller = np.where(y >= z, z_stderr, y_stderr)
    error = np.where(seen, np.hypot(error_of_smaller, smaller * error_of_larger / safe) / safe, 0.0)
    error = np.hypot(error, _estimate_threshold_error(y, y_stderr, z, z_stderr))
    resolved = float(ratio[seen].mean()) if seen.any() else 0.0
    return SensitivityIndex(float(ratio.mean()), float(error.mean()), resolved, float(seen.mean()))
