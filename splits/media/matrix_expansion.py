"""Scattering matrix as a sum of Wigner functions.

With the functions d^l_mn of the scattering angle, the elements are

    P11 = Σ α1 d_00            P22 + P33 = Σ (α2 + α3) d_22        P12 = −Σ β1 d_02
    P44 = Σ α4 d_00            P22 − P33 = Σ (α2 − α3) d_2,−2      P34 = −Σ β2 d_02

(Mishchenko, Travis & Lacis 2002, Scattering, Absorption, and Emission of Light by Small Particles,
section 4.11; de Haan, Bosma & Hovenier 1987, Astron. Astrophys. 183, 371, write the same sums with
generalized spherical functions).
"""

from __future__ import annotations

import numpy as np

from splits.core.optional import import_optional

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
    special = import_optional("scipy.special", "retrieval", "expansions need")
    alpha1, alpha2, alpha3, alpha4, beta1, beta2 = coefficients
    orders = np.arange(alpha1.size)
    n_angles = int(np.clip(ANGLES_PER_ORDER * orders.size + 1, MIN_ANGLES, MAX_ANGLES))
    angle = np.linspace(0.0, 180.0, n_angles)
    mu = np.cos(np.radians(angle))[:, np.newaxis]
    d00, high = special.eval_legendre(orders, mu), np.maximum(orders - 2, 0)
    has_high = orders >= 2
    norm = np.sqrt(
        np.divide(
            (orders + 1.0) * (orders + 2.0), np.maximum(orders * (orders - 1.0), 1.0),
        )
    )  # fmt: skip
    d02 = np.where(has_high, 0.25 * norm * (1.0 - mu**2) * special.eval_jacobi(high, 2, 2, mu), 0.0)
    d22, d2m2 = (
        np.where(has_high, half**2 * special.eval_jacobi(high, *powers, mu), 0.0)
        for half, powers in ((0.5 + 0.5 * mu, (0, 4)), (0.5 - 0.5 * mu, (4, 0)))
    )
    total, difference = d22 @ (alpha2 + alpha3), d2m2 @ (alpha2 - alpha3)
    elements = [
        d00 @ alpha1, -d02 @ beta1, 0.5 * (total - difference), -d02 @ beta2,
        0.5 * (total + difference), d00 @ alpha4,
    ]  # fmt: skip
    return angle, np.stack(elements, axis=-1)
