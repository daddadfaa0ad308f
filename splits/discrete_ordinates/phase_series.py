"""Phase functions from a limited number of moments: error, and extrapolated forward peak."""

from __future__ import annotations

import numpy as np

from splits.discrete_ordinates.integrals import TINY
from splits.discrete_ordinates.pores import WET

N_TAIL_ORDERS = 8
"""Number of the highest orders, which give the error of the phase function."""
N_PEAK_ORDERS, MAX_PEAK_RATIO = 160, 0.97
"""Number of the orders of the forward peak, and largest ratio of two successive moments."""


def estimate_phase_error(
    moments: np.ndarray, cosines: np.ndarray, has_peak: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return ∑ (2l + 1) χ_l P_l without a forward peak, and its error.

    Parameters
    ----------
    moments : float, shape (layers, ..., orders)
        From a limited number of paths.
    cosines : float, shape (..., beams, views, azimuths)
    has_peak : bool
        Whether the last moment is that of a forward peak, which is left out.
    """
    n_orders, tail = moments.shape[-1], slice(-N_TAIL_ORDERS, None)
    factors = 2.0 * np.arange(n_orders) + 1.0
    # Second differences leave the noise of a smooth series; its variance is 6 times as large.
    curvature = np.diff(moments[..., tail], 2)
    noise = (factors[tail][1:-1] * curvature**2).mean(axis=-1) / 6.0
    coefficients = np.moveaxis(moments, -1, 0)[..., np.newaxis, np.newaxis, np.newaxis]
    before, here = np.zeros_like(cosines), np.ones_like(cosines)
    series, peak, power = (np.zeros_like(cosines) for _ in range(3))
    truncated = []
    for order, factor in enumerate(factors):
        if order >= n_orders - N_TAIL_ORDERS:
            truncated.append(series - has_peak * coefficients[order] * peak)
        series = series + factor * coefficients[order] * here
        peak, power = peak + factor * here, power + factor * here**2
        before, here = here, (factor * cosines * here - order * before) / (order + 1.0)
    complete = truncated[-1]
    remainder = np.mean([(complete - one) ** 2 for one in truncated[:-1]], axis=0)
    error = np.sqrt(noise[..., np.newaxis, np.newaxis, np.newaxis] * power + remainder)
    return complete, error


def extend_forward_peak(scattering: np.ndarray) -> np.ndarray:
    """Return scattering (..., 2, 2, orders) with further orders of light that stays in wet pores.

    Grains hardly refract this light, so that its moments decrease slowly.  They continue as a
    geometric series with the mean decrease of the last known orders, and end at 0.
    """
    n_known = scattering.shape[-1]
    own = scattering[..., WET, WET, :]
    last, earlier = (np.maximum(own[..., order], TINY) for order in (-1, -1 - N_TAIL_ORDERS))
    ratio = np.minimum((last / earlier) ** (1.0 / N_TAIL_ORDERS), MAX_PEAK_RATIO)
    extended = np.zeros((*scattering.shape[:-1], N_PEAK_ORDERS))
    extended[..., :n_known] = scattering
    steps = np.arange(1, N_PEAK_ORDERS - n_known + 1)
    # A series that ends with a step oscillates in all directions.
    taper = np.cos(0.5 * np.pi * steps / steps[-1]) ** 2
    tail = last[..., np.newaxis] * ratio[..., np.newaxis] ** steps
    extended[..., WET, WET, n_known:] = tail * taper
    return extended
