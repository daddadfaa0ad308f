"""Divided differences and derivatives of the impedances of a layer, as functions of k².

The derivative of a function of a matrix has the divided differences of the function at all pairs
of eigenvalues (Daleckii & Krein 1965; Higham 2008, Functions of Matrices, theorem 3.11),

    Γ_ij = (g_i − g_j)/(λ_i − λ_j),    λ = k²,    g = k tanh(kτ/2) or k coth(kτ/2),

and the derivative dg/dλ where both eigenvalues are equal.
"""

from __future__ import annotations

import numpy as np

from splits.discrete_ordinates.integrals import TINY

MAX_SERIES_DEPTH = 0.1
"""Largest kτ/2 for which the odd impedance is a series."""
MIN_FAR_RATIO = 0.3
"""Smallest relative difference of two k whose divided difference is the plain quotient."""


def divide_impedances(k: np.ndarray, thickness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the divided differences of k tanh(kτ/2) and of k coth(kτ/2), without cancellation.

    With t = tanh(kτ/2), and likewise for coth,

        Γ_ij = ½ (t_i − t_j)/(k_i − k_j) + ½ (t_i + t_j)/(k_i + k_j),

    where tanh a − tanh b = sinh(a − b)/(cosh a cosh b), coth a − coth b = −sinh(a − b)/(sinh a
    sinh b).  Both terms cancel for the coth of small arguments: small k have the series of
    x coth x = 1 + z/3 − z²/45 + …, z = x², there, and different k the plain quotient.

    Parameters
    ----------
    k : float, shape (..., modes)
        Positive.
    thickness : float, shape (..., 1)
        τ, positive or infinite.

    Returns
    -------
    two arrays, shape (..., modes, modes)
    """
    first, second, half = k[..., :, np.newaxis], k[..., np.newaxis, :], 0.5 * thickness
    low, high, total = np.minimum(first, second), np.maximum(first, second), first + second
    gap, tau = high - low, thickness[..., np.newaxis]
    tanh, decay = np.tanh(k * half), np.exp(-k * thickness)
    tanh = np.maximum(tanh, TINY)
    odd_decay = np.maximum(-np.expm1(-k * thickness), TINY)
    falling = np.exp(-low * tau)
    with np.errstate(invalid="ignore", divide="ignore"):
        # 2 sinh(a − b) / (k_i − k_j), times the exponentials of both hyperbolic functions.
        slope = np.where(gap * tau > 0.0, -np.expm1(-gap * tau) / gap, tau)
        sinh = np.where(falling > 0.0, 2.0 * falling * slope, 0.0)
    even = 0.5 * (sinh / _multiply_pairs(1.0 + decay) + _add_pairs(tanh) / total)
    near = 0.5 * (_add_pairs(1.0 / tanh) / total - sinh / _multiply_pairs(odd_decay))
    impedance = k / tanh
    is_far = gap > MIN_FAR_RATIO * high
    difference = impedance[..., :, np.newaxis] - impedance[..., np.newaxis, :]
    far = difference / np.where(is_far, (first - second) * total, 1.0)
    small = high * half[..., np.newaxis] < MAX_SERIES_DEPTH
    depth = np.minimum(k * half, MAX_SERIES_DEPTH)
    series = 0.5 * np.where(small, tau, 0.0) * _divide_series(depth**2)
    return even, np.where(small, series, np.where(is_far, far, near))


def differentiate_impedances(k: np.ndarray, thickness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of k tanh(kτ/2) and of k coth(kτ/2) with respect to τ."""
    decay = np.exp(-k * thickness)
    odd_decay = np.maximum(-np.expm1(-k * thickness), TINY)
    return 2.0 * decay * (k / (1.0 + decay)) ** 2, -2.0 * decay * (k / odd_decay) ** 2


def _divide_series(z: np.ndarray) -> np.ndarray:
    """Return the divided differences of the series of x coth x with respect to z = x²."""
    a, b = z[..., :, np.newaxis], z[..., np.newaxis, :]
    second, third = a + b, a**2 + a * b + b**2
    fourth, fifth = (a + b) * (a**2 + b**2), a**4 + a * b * third + b**4
    series: np.ndarray = (
        1.0 / 3.0 - second / 45.0 + third * 2.0 / 945.0 - fourth / 4725.0 + fifth * 2.0 / 93555.0
    )
    return series


def _multiply_pairs(values: np.ndarray) -> np.ndarray:
    return values[..., :, np.newaxis] * values[..., np.newaxis, :]


def _add_pairs(values: np.ndarray) -> np.ndarray:
    return values[..., :, np.newaxis] + values[..., np.newaxis, :]
