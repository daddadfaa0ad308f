"""Allowance for light that few rays carry, in variances that are estimated from the same rays.

Where most of the light is in few rays of large weight, a run may contain none of them.  Its scatter
is then that of many rays of small weight, and says nothing about the light that is missing.  For
example, strongly absorbed light that grains reflect without letting it enter has the weight 1, and
all other light hardly any.

Of rays that have the weight W with the probability q, none is among n rays with the probability
exp(−nq), which is 6 % for nq = 2√2.  Twice an error of √2·W/n covers the missing light qW in the
other cases.  This error is that of two rays of the largest possible weight (Agresti and Coull 1998
add two successes to a binomial sample for the same coverage).  The allowance decreases linearly
with the variance, to 0 where it is that of eight such rays.
"""

from __future__ import annotations

import numpy as np

UNSEEN_RAYS, SUFFICIENT_RAYS = 2.0, 8.0
"""Rays of the largest weight that may be missing, and whose scatter is reliable."""
_SCATTER_FRACTION = 1.0 - UNSEEN_RAYS / SUFFICIENT_RAYS


def allow_for_unseen_rays(
    variance: np.ndarray, single_ray_variance: np.ndarray | float
) -> np.ndarray:
    """Return variances that include rays of large weight that a run does not contain.

    Parameters
    ----------
    variance : float
        From the scatter.
    single_ray_variance : float
        Square of the contribution of one ray of the largest possible weight.

    Returns
    -------
    float
        The larger of σ² and 3σ²/4 + 2s² for the variance σ² and that of a single ray s².
    """
    allowed = _SCATTER_FRACTION * variance + UNSEEN_RAYS * single_ray_variance
    return np.maximum(variance, allowed)


def find_required_rays(
    variance: np.ndarray, single_ray_variance: np.ndarray, max_variance: np.ndarray
) -> np.ndarray:
    """Return the rays with which the variance of a mean, with the allowance, is the largest.

    Parameters
    ----------
    variance, single_ray_variance : float
        Variance of the weight of a ray, and square of its largest deviation from the mean.
    max_variance : float
        Largest variance of the mean.
    """
    scatter = _SCATTER_FRACTION * variance / max_variance
    unseen = UNSEEN_RAYS * single_ray_variance / max_variance
    required = 0.5 * (scatter + np.sqrt(scatter**2 + 4.0 * unseen))
    return np.maximum(variance / max_variance, required)
