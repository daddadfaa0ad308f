"""A few refractive indices that stand for a whole spectrum.

Absorption is a weight that a path carries for every wavelength at once; reflection and
refraction are not, but they depend on wavelength only through refractive indices that change
slowly.  Paths are therefore traced at a few *nodes* in index space, and each wavelength takes its
answer from the nodes around it, linearly.

The indices of all materials that light can meet, as a point m(λ) = (n₁, k₁², n₂, k₂², …), trace a
thin band in index space (k enters Fresnel's equations squared).  A backbone of equidistant knots
along the band's main direction is fitted to it; where the band has width (two materials do not
disperse alike; tables are rounded), each knot carries a pair of nodes, one on either side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CURVATURE = 0.4
"""Bound on |d²f/d(ln c)²| for f a reflectance, transmittance or absorptance and c = |n/n' − 1| the
contrast between grain and pore.  Measured: `benchmarks/interpolation.py` prints what it is for
dry, wet and water-filled snow."""

MAX_KNOTS = 24
_FLAT = 1e-7


@dataclass(frozen=True)
class Nodes:
    """Nodes and the weights with which wavelengths draw on them.

    Attributes
    ----------
    index : complex, shape (nodes, materials)
        Refractive indices to trace with.
    weights : float, shape (nodes, wavelengths)
        Convex weights; each column sums to 1.
    bias : float, shape (wavelengths,)
        Bound on the error of linear interpolation.
    """

    index: np.ndarray
    weights: np.ndarray
    bias: np.ndarray


def choose_nodes(index: np.ndarray, pore_share: tuple[float, float], tolerance: float) -> Nodes:
    """Return the fewest nodes whose interpolation error stays below a tolerance.

    Parameters
    ----------
    index : complex, shape (wavelengths, materials)
        Refractive indices of dry pores, wet pores and cores (see `splits.transport.scene`).
    pore_share : (dry, wet)
        Fractions of the pore space.
    tolerance : float
        Largest `Nodes.bias` wanted.  It is exceeded only when `MAX_KNOTS` do not reach it.
    """
    points = np.concatenate([index.real, index.imag**2], axis=1)
    centre = points.mean(axis=0)
    spread = np.linalg.svd(points - centre, full_matrices=False)[2]
    along = (points - centre) @ spread[0]
    if np.ptp(along) < _FLAT:
        return Nodes(index[:1].copy(), np.ones((1, len(index))), np.zeros(len(index)))
    nodes = _along_backbone(index, points, along, pore_share, knots=2)
    for knots in range(3, MAX_KNOTS + 1):
        if nodes.bias.max() <= tolerance:
            break
        nodes = _along_backbone(index, points, along, pore_share, knots)
    return nodes


def _along_backbone(index, points, along, pore_share, knots) -> Nodes:
    """Return the nodes for a given number of knots."""
    position = (along - along.min()) / np.ptp(along) * (knots - 1)
    segment = np.minimum(position.astype(int), knots - 2)
    t = position - segment
    hats = np.zeros((len(points), knots))
    rows = np.arange(len(points))
    hats[rows, segment] = 1.0 - t
    hats[rows, segment + 1] = t
    # Knots without wavelengths nearby keep the chord: a whiff of curvature penalty decides.
    bend = np.zeros((max(knots - 2, 0), knots))
    for j in range(knots - 2):
        bend[j, j : j + 3] = 1e-4, -2e-4, 1e-4
    backbone = np.linalg.lstsq(
        np.concatenate([hats, bend]),
        np.concatenate([points, np.zeros((len(bend), points.shape[1]))]),
        rcond=None,
    )[0]
    residual = points - hats @ backbone
    across = np.linalg.svd(residual, full_matrices=False)[2][0]
    offset = residual @ across
    width = np.abs(offset).max()
    materials = index.shape[1]
    if width < _FLAT:
        centres, weights = backbone, hats.T
    else:
        centres = np.concatenate([backbone + width * across, backbone - width * across])
        side = 0.5 * (1.0 + offset / width)
        weights = np.concatenate([hats.T * side, hats.T * (1.0 - side)])
    node_index = centres[:, :materials] + 1j * np.sqrt(np.maximum(centres[:, materials:], 0.0))
    used = weights.max(axis=1) > 0.0
    return Nodes(
        node_index[used], weights[used], _interpolation_bias(backbone, segment, t, pore_share)
    )


def _interpolation_bias(backbone, segment, t, pore_share) -> np.ndarray:
    """Bound f(t) − linear by t(1−t)/2 · CURVATURE · Δ(ln c)² over all pairs of core and pore."""
    materials = backbone.shape[1] // 2
    n = backbone[:, :materials]
    worst = np.zeros(len(t))
    for core in range(2, materials):
        total = np.zeros(len(t))
        for pore in (0, 1):
            contrast = np.maximum(np.abs(n[:, core] / n[:, pore] - 1.0), 1e-4)
            step = np.diff(np.log(contrast))[segment]
            total += pore_share[pore] * step**2
        worst = np.maximum(worst, total)
    return 0.5 * t * (1.0 - t) * CURVATURE * worst
