"""Mean sensitivity index (MSI) of a spectrum to a parameter, with its error.

SPLITSnow section 5.4 (after Hamby 1994): the mean over wavelengths of |y − ŷ| / max(y, ŷ) for the
spectra y and ŷ at a parameter's extremes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NOISE = 2.0
"""A wavelength counts where the larger value exceeds this many of its standard errors."""


@dataclass(frozen=True)
class Sensitivity:
    """A mean sensitivity index.

    Attributes
    ----------
    index : float
        MSI over all wavelengths; where both values are below the noise the ratio is undefined
        and counts as 0, as two zeros of a coin-tossing run would.
    stderr : float
        Upper bound of its standard error: those of all wavelengths are added linearly, as if all
        went together.  A wavelength near the noise counts in one run and not in another: its
        ratio, or the most it could have at the limit, times the chance of that belongs to them.
    index_resolved : float
        MSI over the wavelengths above the noise only.
    resolved : float
        Share of wavelengths above the noise.
    """

    index: float
    stderr: float
    index_resolved: float
    resolved: float


def mean_sensitivity_index(
    y: np.ndarray, y_stderr: np.ndarray, z: np.ndarray, z_stderr: np.ndarray
) -> Sensitivity:
    """Return the mean sensitivity index of two spectra.

    Parameters
    ----------
    y, z : array_like, shape (wavelengths,)
        Reflectance or transmittance at the two extremes of a parameter.
    y_stderr, z_stderr : array_like
        Their standard errors.
    """
    y, y_stderr, z, z_stderr = (np.asarray(a, dtype=float) for a in (y, y_stderr, z, z_stderr))
    larger = np.maximum(y, z)
    error_of_larger = np.where(y >= z, y_stderr, z_stderr)
    seen = larger > NOISE * error_of_larger
    safe = np.where(seen, larger, 1.0)
    smaller = np.minimum(y, z)
    ratio = np.where(seen, (larger - smaller) / safe, 0.0)
    # d ratio = (smaller/larger) · (relative errors in quadrature).
    error_of_smaller = np.where(y >= z, z_stderr, y_stderr)
    error = np.where(seen, np.hypot(error_of_smaller, smaller * error_of_larger / safe) / safe, 0.0)
    # With p the chance to be seen, √(p (1 − p)) is at most exp(−d²/4)/2 at d errors from the limit.
    limit = NOISE * error_of_larger
    tiny = np.finfo(float).tiny
    away = np.abs(larger - limit) / np.maximum(error_of_larger, tiny)
    most = 1.0 - smaller / np.maximum(np.maximum(larger, limit), tiny)
    flip = np.where(limit > 0.0, 0.5 * most * np.exp(-0.25 * np.minimum(away, 50.0) ** 2), 0.0)
    error = np.hypot(error, flip)
    resolved = float(ratio[seen].mean()) if seen.any() else 0.0
    return Sensitivity(float(ratio.mean()), float(error.mean()), resolved, float(seen.mean()))
