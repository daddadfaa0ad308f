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

CURVATURE = 0.25
"""Bound on |d²f/d(ln c)²| for f a reflectance, transmittance or absorptance and c = |n/n' − 1| the
contrast between grain and pore; `benchmarks/interpolation.py` measures it for dry, wet and
water-filled snow."""

MAX_KNOTS = 48
MAX_EXTINCTION = 0.005
"""Wavelengths at which a material's k exceeds this are traced by themselves: there k decides
reflection as much as n does, and both change fast."""
MAX_RESIDUAL = 1e-4
"""Largest index (or k²) difference that nodes may leave unaccounted for."""
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
    """Return few nodes, such that the interpolation error stays below a tolerance everywhere.

    Wavelengths that the backbone cannot serve within `tolerance`, `MAX_EXTINCTION` and
    `MAX_RESIDUAL` become nodes of their own.

    Parameters
    ----------
    index : complex, shape (wavelengths, materials)
        Refractive indices of dry pores, wet pores and cores (see `splits.transport.scene`).
    pore_share : (dry, wet)
        Fractions of the pore space.
    tolerance : float
        Largest `Nodes.bias` allowed.
    """
    alone = index.imag.max(axis=1) > MAX_EXTINCTION
    for _ in range(3):
        nodes, bad = _shared(index[~alone], pore_share, tolerance)
        if not bad.any():
            break
        alone[np.flatnonzero(~alone)[bad]] = True
    else:
        alone[:] = True
        nodes, _ = _shared(index[:0], pore_share, tolerance)
    own, which = np.unique(index[alone], axis=0, return_inverse=True)
    weights = np.zeros((len(nodes.index) + len(own), len(index)))
    weights[: len(nodes.index), ~alone] = nodes.weights
    weights[len(nodes.index) + which.reshape(-1), np.flatnonzero(alone)] = 1.0
    bias = np.zeros(len(index))
    bias[~alone] = nodes.bias
    return Nodes(np.concatenate([nodes.index, own]), weights, bias)


def _shared(
    index: np.ndarray, pore_share: tuple[float, float], tolerance: float
) -> tuple[Nodes, np.ndarray]:
    """Return backbone nodes, and which wavelengths they do not serve well enough."""
    count, _materials = index.shape
    good = np.zeros(count, dtype=bool)
    if count == 0:
        return Nodes(index, np.zeros((0, 0)), np.zeros(0)), good
    points = np.concatenate([index.real, index.imag**2], axis=1)
    spread = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    along = (points - points[0]) @ spread[0]
    if np.ptp(along) < _FLAT:
        return Nodes(index[:1].copy(), np.ones((1, count)), np.zeros(count)), good
    for knots in range(2, MAX_KNOTS + 1):
        nodes = _along_backbone(index, points, along, pore_share, knots)
        if nodes.bias.max() <= tolerance:
            break
    node_points = np.concatenate([nodes.index.real, nodes.index.imag**2], axis=1)
    missed = np.abs(nodes.weights.T @ node_points - points).max(axis=1) > MAX_RESIDUAL
    low, high = index.real.min(axis=0), index.real.max(axis=0)
    room = 0.25 * (high - low) + MAX_RESIDUAL
    astray = ((nodes.index.real < low - room) | (nodes.index.real > high + room)).any(axis=1)
    bad = (nodes.bias > tolerance) | missed | (nodes.weights[astray] > 0.0).any(axis=0)
    return nodes, bad


def _along_backbone(
    index: np.ndarray,
    points: np.ndarray,
    along: np.ndarray,
    pore_share: tuple[float, float],
    knots: int,
) -> Nodes:
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
    fixed = np.ptp(points, axis=0) == 0.0
    backbone[:, fixed] = points[0, fixed]
    residual = points - hats @ backbone
    across = np.linalg.svd(residual, full_matrices=False)[2][0]
    across[fixed] = 0.0
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
    bias = _interpolation_bias(node_index[used].real, weights[used], index.real, pore_share)
    return Nodes(node_index[used], weights[used], bias)


def _interpolation_bias(
    node_n: np.ndarray, weights: np.ndarray, n: np.ndarray, pore_share: tuple[float, float]
) -> np.ndarray:
    """Bound what the nodes' mean misses: Σ_j w_j · CURVATURE/2 · ((c_j − c)/c)².

    This is the gap of Jensen's inequality for a function of the contrast c of core and pore with
    second derivative CURVATURE in ln c, added over both pores, the largest over cores.  Where the
    nodes lie on both sides of a vanishing contrast it is infinite, and rightly so.
    """
    bias = np.zeros(len(n))
    drawn = weights > 0.0
    for core in range(2, n.shape[1]):
        total = np.zeros(len(n))
        for pore in (0, 1):
            if pore_share[pore] == 0.0:
                continue
            c_node = (node_n[:, core] / node_n[:, pore] - 1.0)[:, np.newaxis]
            c = n[:, core] / n[:, pore] - 1.0
            least = np.minimum(np.abs(c_node), np.abs(c))
            apart = np.where(drawn, np.abs(c_node - c), 0.0)
            relative = np.divide(apart, least, out=np.full(apart.shape, np.inf), where=least > 0.0)
            relative[(apart == 0.0) | ~drawn] = 0.0
            relative[drawn & (c_node * c < 0.0)] = np.inf
            gap = np.multiply(weights, relative**2, out=np.zeros(apart.shape), where=drawn)
            total += pore_share[pore] * 0.5 * CURVATURE * gap.sum(axis=0)
        bias = np.maximum(bias, total)
    return bias
