"""Scattering matrices of tests: a smooth one with all elements, and that of geometric optics."""

import numpy as np

from splits.media.particle_layer import ELEMENTS


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


def compute_sphere_matrix(index: float, angle_deg: np.ndarray, n_rays: int = 400_000) -> np.ndarray:
    """Return the matrix of a sphere without absorption, by quadrature over the impact parameter.

    Light of order 0 is reflected outside; light of order k is refracted after k − 1 internal
    reflections.  Amplitudes are those of Fresnel's equations, parallel and perpendicular.
    """
    sine = np.sqrt((np.arange(n_rays) + 0.5) / n_rays)
    i, r = np.arcsin(sine), np.arcsin(sine / index)
    cos_i, cos_r = np.cos(i), np.cos(r)
    s = (cos_i - index * cos_r) / (cos_i + index * cos_r)
    p = (index * cos_i - cos_r) / (index * cos_i + cos_r)
    t = (1.0 - s**2) * (1.0 - p**2)
    cosines = np.cos(np.radians(angle_deg[::-1]))
    sums = np.zeros((len(ELEMENTS), angle_deg.size))
    for order in range(40):
        if order == 0:
            theta, square_s, square_p, product = np.pi - 2.0 * i, s**2, p**2, s * p
        else:
            theta = 2.0 * (i - r) + (order - 1) * (np.pi - 2.0 * r)
            square_s = (1.0 - s**2) ** 2 * s ** (2 * order - 2)
            square_p = (1.0 - p**2) ** 2 * p ** (2 * order - 2)
            product = t * (s * p) ** (order - 1)
        node = np.clip(np.searchsorted(cosines, np.cos(theta)) - 1, 0, angle_deg.size - 2)
        above = (np.cos(theta) - cosines[node]) / (cosines[node + 1] - cosines[node])
        mean, difference = 0.5 * (square_p + square_s), 0.5 * (square_p - square_s)
        for row, element in enumerate((mean, difference, product, 0.0 * mean, mean, product)):
            for nodes, weight in ((node, 1.0 - above), (node + 1, above)):
                sums[row] += np.bincount(nodes, weight * element, angle_deg.size)
    width = np.diff(cosines)
    weight = 0.5 * (np.append(width, 0.0) + np.append(0.0, width))
    return (2.0 * sums / n_rays / weight)[:, ::-1]
