"""Exponential modes of a homogeneous layer: impedances, and integrals along directions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

TINY = float(np.finfo(float).tiny)


class ModeIntegrals(NamedTuple):
    """Integrals of the modes along a direction, weighted by e^(−rt) with a rate r, of 0 to τ.

    "even" are those of cosh(k(τ/2 − t)) and k sinh(k(τ/2 − t)) over cosh(kτ/2); "odd" those of sinh
    and k cosh over sinh(kτ/2).  The last two are even_cosh − odd_sinh and even_sinh − odd_cosh,
    without cancellation where kτ is large.
    """

    even_cosh: np.ndarray
    even_sinh: np.ndarray
    odd_sinh: np.ndarray
    odd_cosh: np.ndarray
    cosh_gap: np.ndarray
    sinh_gap: np.ndarray


def integrate_modes(k: np.ndarray, thickness: np.ndarray, rates: np.ndarray) -> ModeIntegrals:
    """Return the integrals, shape (..., directions, modes).

    Parameters
    ----------
    k : float, shape (..., modes)
    thickness : float, shape (..., 1)
        τ, positive or infinite.
    rates : float, shape (..., directions)
    """
    k, thickness, rates = k[..., np.newaxis, :], thickness[..., np.newaxis], rates[..., np.newaxis]
    depth, slant = k * thickness, rates * thickness
    decay, direct, intercepted = np.exp(-depth), np.exp(-slant), -np.expm1(-slant)
    # ∫ e^(−kt) e^(−rt) dt and ∫ e^(−k(τ−t)) e^(−rt) dt.
    falling = -np.expm1(-depth - slant) / (k + rates)
    rising = convolve_exponentials(k, rates, thickness)
    even = 1.0 / (1.0 + decay)
    even_cosh, even_sinh = even * (falling + rising), even * (falling - rising)
    # Odd modes of small k/r, by partial integration: k coth(kτ/2) is finite there.
    k_coth = k / np.maximum(np.tanh(0.5 * depth), TINY)
    small = k < 0.5 * rates
    denominator = np.where(small, (rates - k) * (rates + k), 1.0)
    by_parts = (rates * (1.0 + direct) - k_coth * intercepted) / denominator
    odd = 1.0 / np.maximum(-np.expm1(-depth), TINY)
    odd_sinh = np.where(small, by_parts, odd * (falling - rising))
    odd_cosh = (k_coth * intercepted - k**2 * odd_sinh) / rates
    gap, decayed = 2.0 * even * odd, decay * falling
    cosh_gap, sinh_gap = gap * (rising - decayed), -k * gap * (rising + decayed)
    return ModeIntegrals(even_cosh, k * even_sinh, odd_sinh, odd_cosh, cosh_gap, sinh_gap)


def convolve_exponentials(a: np.ndarray, b: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Return ∫ e^(−at) e^(−b(τ−t)) dt from 0 to τ, without cancellation at a = b."""
    low = np.minimum(a * thickness, b * thickness)
    with np.errstate(invalid="ignore"):
        excess = np.abs(a - b) * thickness
        ratio = np.where(excess > 0.0, -np.expm1(-excess) / np.maximum(excess, TINY), 1.0)
        integral: np.ndarray = np.where(np.isinf(low), 0.0, np.exp(-low) * ratio * thickness)
    return integral


def compute_impedances(
    k: np.ndarray, thickness: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return k tanh(kτ/2), k coth(kτ/2), and their difference, which is 2k/sinh(kτ)."""
    depth = k * thickness
    tanh = np.maximum(np.tanh(0.5 * depth), TINY)
    difference = 4.0 * k * np.exp(-depth) / np.maximum(-np.expm1(-2.0 * depth), TINY)
    return k * tanh, k / tanh, difference
