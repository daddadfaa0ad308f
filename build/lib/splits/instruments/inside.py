"""Rays traced until what they tell of the light inside is known as well as asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.instruments.ensemble import GROUPS
from splits.instruments.estimators import rays_wanted
from splits.instruments.inside_errors import errors_of, missed, one_ray
from splits.instruments.nodes import Nodes
from splits.instruments.planes import ROUND, Planes
from splits.instruments.runner import Runner
from splits.transport.sums.passages import DOWN, UP

_GROWTH = 8.0


class Found(NamedTuple):
    """Means by group of rays at the depths asked for, and between them.

    Attributes
    ----------
    light : float, shape (GROUPS, 2, depths, wavelengths)
        Irradiances downwards and upwards, over that of the light from above.
    absorbed : float, shape (GROUPS, intervals, wavelengths)
        What goes in less what comes out.
    by_material : float, shape (GROUPS, intervals, materials, wavelengths)
        By the lengths in each material.
    way : float, shape (GROUPS, intervals, wavelengths)
        Metres.
    """

    light: np.ndarray
    absorbed: np.ndarray
    by_material: np.ndarray
    way: np.ndarray


def _at_planes(ensembles: Sequence[Planes], weights: np.ndarray, at: np.ndarray) -> list[Found]:
    """Return what each ensemble tells at faces `at`, as its wavelengths weigh it."""
    found = []
    for one, weight in zip(ensembles, weights, strict=True):
        told = one.told()
        light = weight * told.light[:, :, at]
        net = light[:, DOWN] - light[:, UP]
        first = at[:-1]
        found.append(
            Found(
                light,
                net[:, :-1] - net[:, 1:],
                weight * np.add.reduceat(told.absorbed, first, axis=1),
                weight * np.add.reduceat(told.way, first, axis=1),
            )
        )
    return found


def found_by(
    runner: Runner,
    ensembles: Sequence[Planes],
    nodes: Nodes,
    at: np.ndarray,
    max_stderr: float,
    max_rays: int,
) -> tuple[Found, np.ndarray, float]:
    """Trace until the error asked for is reached.

    Returns
    -------
    Found
    least : float, shape (wavelengths,)
        See `errors_of`.
    reached : float
    """
    levels = [(e, level) for e in ensembles for level in e.levels]
    runner.trace([(*who, ROUND) for who in levels], 1.0, max_stderr)
    while True:
        each = _at_planes(ensembles, nodes.weights, at)
        found = Found(*(np.sum(part, axis=0) for part in zip(*each, strict=True)))
        # Light and absorbed shares, one after the other.
        values = [np.concatenate([*one.light.swapaxes(0, 1), one.absorbed], axis=1) for one in each]
        bias = missed(nodes.bias, np.sum(values, axis=0).mean(axis=0))
        parts = np.stack([one.var(axis=0, ddof=1) for one in values]) / GROUPS
        least = one_ray(ensembles, nodes.weights)
        stderr = errors_of(np.sum(values, axis=0), nodes.bias, least)
        rays = np.array([level.rays for _, level in levels], dtype=float)
        converged = bool(stderr.max() <= max_stderr)
        if converged or rays.sum() >= max_rays:
            return found, least, float(stderr.max())
        count = np.stack([e.count for e in ensembles])[:, np.newaxis]
        target = np.maximum(max_stderr**2 - bias**2, 0.1 * max_stderr**2)
        wanted = rays_wanted(parts * count, target, ensembles)
        step = np.minimum(wanted - rays, (_GROWTH - 1.0) * rays)
        step = np.ceil(step * min(1.0, (max_rays - rays.sum()) / step.sum()) / ROUND)
        left = float((wanted - rays - step * ROUND).clip(0).sum())
        work = [(*who, int(s) * ROUND) for who, s in zip(levels, step, strict=True) if s > 0]
        runner.trace(work, float(stderr.max()), max_stderr, left)


def shares_of(found: Found, materials: int) -> np.ndarray:
    """Return absorbed shares by material, whose sums are those of `Found.absorbed`.

    Shape (GROUPS, intervals, materials, wavelengths); the materials' parts vary by group to first
    order.  Where no path tells of an interval, its shares are those of the whole sample, and the
    same for all materials where none tells of that; errors say so (`share_missed`).
    """
    parts = found.by_material[:, :, :materials]
    whole = parts.sum(axis=2, keepdims=True)
    mean = whole.mean(axis=0)
    of_all = parts.mean(axis=0).sum(axis=0, keepdims=True)
    every = of_all.sum(axis=1, keepdims=True)
    even = np.full_like(of_all, 1.0 / of_all.shape[1])
    share = np.broadcast_to(
        np.divide(of_all, every, out=even, where=every > 0.0), mean.shape[:1] + of_all.shape[1:]
    ).copy()
    np.divide(parts.mean(axis=0), mean, out=share, where=mean > 0.0)
    absorbed = found.absorbed[:, :, np.newaxis]
    total = absorbed.mean(axis=0)
    scale = np.divide(total, mean, out=np.zeros_like(total), where=mean > 0.0)
    result: np.ndarray = absorbed * share + scale * (parts - share * whole)
    return result
