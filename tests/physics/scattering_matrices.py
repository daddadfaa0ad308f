"""Scattering matrix of a test, with all elements."""

from __future__ import annotations

import numpy as np


def make_matrix(p22: float = 1.0) -> dict[str, np.ndarray]:
    """Return a smooth scattering matrix with all elements; P22 and P44 are reduced by a factor."""
    angle = np.linspace(0.0, 180.0, 181)
    mu = np.cos(np.radians(angle))
    p11 = 1.0 + 0.8 * mu + 0.5 * mu**2
    p12, p34 = -0.5 * (1.0 - mu**2), 0.3 * (1.0 - mu**2) * mu
    p33 = mu * p11 * 0.8
    return {
        "angle_deg": angle, "P11": p11, "P12": p12, "P33": p22 * p33, "P34": p34,
        "P22": p22 * p11, "P44": (2.0 * p22 - 1.0) * p33,
    }  # fmt: skip
