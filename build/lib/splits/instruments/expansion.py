"""A goniophotometer's expansion in polynomials: rays until every direction is known well enough."""

from __future__ import annotations

import numpy as np

from splits.instruments.angular import (
    BIAS,
    Estimate,
    estimate,
    largest_error,
    rays_wanted,
    reference,
)
from splits.instruments.detail import angles_of
from splits.instruments.directional import ROUND, Directional
from splits.instruments.local import Goal
from splits.instruments.nodes import Nodes
from splits.instruments.runner import Runner
from splits.instruments.threads import linear_algebra_alone
from splits.transport.sums.directions import basis_of

DEGREE = 24
"""Largest degree of polynomials: details of about 180°/24."""

STEEPEST_DEG = 82.5
"""Polar angle up to which the error asked for is to be reached."""

_GROWTH = 8.0


def expand(
    runner: Runner,
    nodes: Nodes,
    absorption: np.ndarray,
    polar: np.ndarray,
    azimuth: np.ndarray,
    goal: Goal,
) -> tuple[list[Directional], Estimate, str]:
    """Trace until the goal is reached; return the paths, the estimate and what stopped them."""
    symmetric, diffuse = runner.tracer.upright or runner.tracer.diffuse, runner.tracer.diffuse
    angles = angles_of(polar, azimuth, basis_of(DEGREE))
    seen = counted(polar, azimuth)
    ensembles = [
        Directional(number, m, absorption, w, angles.basis, sharp=not diffuse)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    levels = [(e, level) for e in ensembles for level in e.levels]
    limit = goal.rays or goal.max_rays
    runner.trace([(e, level, ROUND) for e, level in levels], 1.0, goal.relative_stderr)
    reached: list[tuple[float, float]] = []
    while True:
        with linear_algebra_alone():
            result, variance = estimate(ensembles, nodes.bias, angles, symmetric, goal.side, seen)
        error = largest_error(result, goal.side, seen, steering=True)
        have = np.array([level.rays for _, level in levels])
        if goal.rays is None and error <= goal.relative_stderr:
            stated = largest_error(result, goal.side, seen)
            return ensembles, result, "error" if stated <= goal.relative_stderr else "detail"
        # Eight times the rays should divide a statistical error by nearly three.
        idle = any(have.sum() >= 8.0 * rays and error > 0.8 * was for rays, was in reached)
        if goal.rays is None and (idle or _too_fine(result, goal, seen)):
            return ensembles, result, "degree"
        reached.append((float(have.sum()), error))
        if have.sum() >= limit:
            return ensembles, result, "rays"
        missed = BIAS * nodes.bias[:, np.newaxis]
        scale = reference(result)[goal.side][:, seen]
        target = (goal.relative_stderr**2 - missed**2) * scale**2
        wanted = rays_wanted(ensembles, variance, target)
        step = _share_out(wanted, have, limit, goal.rays is not None)
        work = [(*who, int(n)) for who, n in zip(levels, step, strict=True) if n > 0]
        left = float((wanted - have - step).clip(0).sum())
        runner.trace(work, error, goal.relative_stderr, left)


def counted(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Tell in which directions the error counts: all of them if only steeper ones are wanted."""
    low = polar <= STEEPEST_DEG
    return np.repeat(low if low.any() else ~low, len(azimuth))


def _too_fine(result: Estimate, goal: Goal, seen: np.ndarray) -> bool:
    """Tell whether only detail finer than the polynomials keeps a run from its goal."""
    side = goal.side
    scale, stderr = reference(result)[side][:, seen], result.steering[side][:, seen]
    rest = np.sqrt(np.maximum(stderr**2 - result.beyond[side][:, seen] ** 2, 0.0))
    return bool((rest <= goal.relative_stderr * scale).all())


def _share_out(wanted: np.ndarray, have: np.ndarray, limit: int, fixed: bool) -> np.ndarray:
    """Return how many rays to add to each level: those wanted, or as many in these proportions."""
    room = float(limit - have.sum())
    more = wanted - have
    if fixed:
        low, high = 0.0, (have.sum() + room) / wanted.min()
        for _ in range(60):
            middle = 0.5 * (low + high)
            enough = np.clip(middle * wanted - have, 0.0, None).sum() >= room
            low, high = (low, middle) if enough else (middle, high)
        more = high * wanted - have
    step = np.clip(more, 0.0, (_GROWTH - 1.0) * have)
    if not step.any():
        # All have what was foretold, but the error has grown: finer detail came into sight.
        step = 0.25 * have
    step *= min(1.0, room / step.sum())
    return np.ceil(step / ROUND).astype(np.int64) * ROUND
