"""Scattering matrix as a sum of Wigner functions.

With the functions d^l_mn of the scattering angle, the elements are

    P11 = Σ α1 d_00            P22 + P33 = Σ (α2 + α3) d_22        P12 = −Σ β1 d_02
    P44 = Σ α4 d_00            P22 − P33 = Σ (α2 − α3) d_2,−2      P34 = −Σ β2 d_02

(Mishchenko, Travis & Lacis 2002, Scattering, Absorption, and Emission of Light by Small Particles,
section 4.11; de Haan, Bosma & Hovenier 1987, Astron. Astrophys. 183, 371, write the same sums with
generalized spherical functions).
"""

from __future__ import annotations

import math

import numpy as np

COEFFICIENTS = ("alpha1", "alpha2", "alpha3", "alpha4", "beta1", "beta2")
ANGLES_PER_ORDER = 40
"""Angles at which elements are tabulated, per order: the error of linear interpolation is below
1e-3 of the highest term."""
MIN_ANGLES, MAX_ANGLES = 361, 20_001


def sum_expansion(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return scattering angles (degrees) and the elements of the matrix there.

    Parameters
    ----------
    coefficients : float, shape (6, orders)
        See `COEFFICIENTS`; orders from 0 on.

    Returns
    -------
    angle_deg : float, shape (n,)
    elements : float, shape (n, 6)
        P11, P12, P33, P34, P22 and P44.
    """
    alpha1, alpha2, alpha3, alpha4, beta1, beta2 = coefficients
    n_angles = int(np.clip(ANGLES_PER_ORDER * alpha1.size + 1, MIN_ANGLES, MAX_ANGLES))
    angle = np.linspace(0.0, 180.0, n_angles)
    mu = np.cos(np.radians(angle))
    p11, p44 = _sum_functions(0, 0, mu, alpha1, alpha4)
    p12, p34 = _sum_functions(0, 2, mu, -beta1, -beta2)
    (total,) = _sum_functions(2, 2, mu, alpha2 + alpha3)
    (difference,) = _sum_functions(2, -2, mu, alpha2 - alpha3)
    p22, p33 = 0.5 * (total + difference), 0.5 * (total - difference)
    return angle, np.stack([p11, p12, p33, p34, p22, p44], axis=-1)


def _sum_functions(m: int, n: int, mu: np.ndarray, *coefficients: np.ndarray) -> np.ndarray:
    """Return sums of the functions d^l_mn over l, for |m| ≤ |n|, each with its coefficients.

    Functions of successive orders follow from the recurrence of Mishchenko et al. (2002), Eq. B.22.

    Parameters
    ----------
    m, n : int
    mu : float, shape (angles,)
        Cosines.
    *coefficients : float, shape (orders,)
        From order 0 on.

    Returns
    -------
    float, shape (sums, angles)
    """
    first = abs(n)
    orders = np.arange(coefficients[0].size + 1.0)
    above = np.maximum(orders, 1.0)
    root = np.sqrt(np.maximum((orders**2 - m**2) * (orders**2 - n**2), 0.0)) / above
    shift = m * n / (above * (orders + 1.0))
    scale = 0.5**first * math.sqrt(
        math.factorial(2 * first) / (math.factorial(abs(m - n)) * math.factorial(abs(m + n)))
    )
    low = np.zeros_like(mu)
    high = scale * (1.0 - mu) ** (abs(m - n) // 2) * (1.0 + mu) ** (abs(m + n) // 2)
    sums = np.zeros((len(coefficients), mu.size))
    for order in range(first, coefficients[0].size):
        for total, values in zip(sums, coefficients, strict=True):
            total += values[order] * high
        following = (2.0 * order + 1.0) * (mu - shift[order]) * high - root[order] * low
        low, high = high, following / root[order + 1]
    return sums
