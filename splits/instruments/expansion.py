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
    stopping_rule: Goal,
) -> tuple[list[Directional], Estimate, str]:
    """Trace until the goal is reached; return the paths, the estimate and what stopped them."""
    symmetric, diffuse = runner.tracer.normal_incidence or runner.tracer.diffuse, runner.tracer.diffuse
    angles = angles_of(polar, azimuth, basis_of(DEGREE))
    seen = counted(polar, azimuth)
    ensembles = [
        Directional(number, m, absorption, w, angles.basis, exclude_unscattered=not diffuse)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    levels = [(e, level) for e in ensembles for level in e.strata]
    limit = stopping_rule.n_rays or stopping_rule.max_rays
    runner.trace([(e, level, ROUND) for e, level in levels], 1.0, stopping_rule.relative_stderr)
    reached: list[tuple[float, float]] = []
    while True:
        with linear_algebra_alone():
            result, variance = estimate(ensembles, nodes.interpolation_bound, angles, symmetric, stopping_rule.side, seen)
        error = largest_error(result, stopping_rule.side, seen, use_stopping_error=True)
        have = np.array([level.n_rays for _, level in levels])
        if stopping_rule.n_rays is None and error <= stopping_rule.relative_stderr:
            stated = largest_error(result, stopping_rule.side, seen)
            return ensembles, result, "error" if stated <= stopping_rule.relative_stderr else "detail"
        # Eight times the rays should divide a statistical error by nearly three.
        idle = any(have.sum() >= 8.0 * rays and error > 0.8 * was for rays, was in reached)
        if stopping_rule.n_rays is None and (idle or _too_fine(result, stopping_rule, seen)):
            return ensembles, result, "degree"
        reached.append((float(have.sum()), error))
        if have.sum() >= limit:
            return ensembles, result, "rays"
        missed = BIAS * nodes.interpolation_bound[:, np.newaxis]
        scale = reference(result)[stopping_rule.side][:, seen]
        target = (stopping_rule.relative_stderr**2 - missed**2) * scale**2
        wanted = rays_wanted(ensembles, variance, target)
        step = _share_out(wanted, have, limit, stopping_rule.n_rays is not None)
        work = [(*who, int(n)) for who, n in zip(levels, step, strict=True) if n > 0]
        left = float((wanted - have - step).clip(0).sum())
        runner.trace(work, error, stopping_rule.relative_stderr, left)


def counted(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Tell in which directions the error counts: all of them if only steeper ones are wanted."""
    low = polar <= STEEPEST_DEG
    return np.repeat(low if low.any() else ~low, len(azimuth))


def _too_fine(estimate: Estimate, stopping_rule: Goal, direction_mask: np.ndarray) -> bool:
    """Tell whether only detail finer than the polynomials keeps a run from its goal."""
    side = stopping_rule.side
    scale, stderr = reference(estimate)[side][:, direction_mask], estimate.stopping_error[side][:, direction_mask]
    rest = np.sqrt(np.maximum(stderr**2 - estimate.truncation_error[side][:, direction_mask] ** 2, 0.0))
    return bool((rest <= stopping_rule.relative_stderr * scale).all())


def _share_out(target_rays: np.ndarray, n_rays: np.ndarray, max_rays: int, fixed_total: bool) -> np.ndarray:
    """Return how many rays to add to each level: those wanted, or as many in these proportions."""
    room = float(max_rays - n_rays.sum())
    more = target_rays - n_rays
    if fixed_total:
        low, high = 0.0, (n_rays.sum() + room) / target_rays.min()
        for _ in range(60):
            middle = 0.5 * (low + high)
            enough = np.clip(middle * target_rays - n_rays, 0.0, None).sum() >= room
            low, high = (low, middle) if enough else (middle, high)
        more = high * target_rays - n_rays
    step = np.clip(more, 0.0, (_GROWTH - 1.0) * n_rays)
    if not step.any():
        # All have what was foretold, but the error has grown: finer detail came into sight.
        step = 0.25 * n_rays
    step *= min(1.0, room / step.sum())
    return np.ceil(step / ROUND).astype(np.int64) * ROUND
