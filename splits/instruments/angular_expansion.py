"""A goniophotometer's expansion in polynomials: rays until every direction is known well enough."""

from __future__ import annotations

import numpy as np

from splits.instruments.angular_estimate import (
    INTERPOLATION_FACTOR,
    AngularEstimate,
    allocate_angular_rays,
    compute_error_reference,
    compute_max_relative_error,
    estimate_brdf,
)
from splits.instruments.angular_tally import RAYS_PER_ROUND, ExpansionTally
from splits.instruments.angular_truncation import make_direction_grid
from splits.instruments.next_event import StoppingRule
from splits.kernels.tallies.angular import make_basis
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.threads import limit_blas_threads

MAX_DEGREE = 24
"""Largest degree of polynomials: details of about 180°/24."""

MAX_CONVERGED_POLAR_DEG = 82.5
"""Polar angle up to which the error asked for is to be reached."""

_MAX_ROUND_GROWTH = 8.0


def trace_expansion(
    runner: Runner,
    nodes: IndexNodes,
    absorption: np.ndarray,
    polar: np.ndarray,
    azimuth: np.ndarray,
    stopping_rule: StoppingRule,
) -> tuple[list[ExpansionTally], AngularEstimate, str]:
    """Trace until the goal is reached; return the paths, the estimate and what stopped them."""
    symmetric, diffuse = (
        runner.tracer.normal_incidence or runner.tracer.diffuse,
        runner.tracer.diffuse,
    )
    angles = make_direction_grid(polar, azimuth, make_basis(MAX_DEGREE))
    seen = make_direction_mask(polar, azimuth)
    ensembles = [
        ExpansionTally(number, m, absorption, w, angles.basis, exclude_unscattered=not diffuse)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    levels = [(e, level) for e in ensembles for level in e.strata]
    limit = stopping_rule.n_rays or stopping_rule.max_rays
    runner.trace(
        [(e, level, RAYS_PER_ROUND) for e, level in levels], 1.0, stopping_rule.relative_stderr
    )
    reached: list[tuple[float, float]] = []
    while True:
        with limit_blas_threads():
            result, variance = estimate_brdf(
                ensembles, nodes.interpolation_bound, angles, symmetric, stopping_rule.side, seen
            )
        error = compute_max_relative_error(
            result, stopping_rule.side, seen, use_stopping_error=True
        )
        have = np.array([level.n_rays for _, level in levels])
        if stopping_rule.n_rays is None and error <= stopping_rule.relative_stderr:
            stated = compute_max_relative_error(result, stopping_rule.side, seen)
            return (
                ensembles,
                result,
                "converged" if stated <= stopping_rule.relative_stderr else "unresolved_lobe",
            )
        # Eight times the rays should divide a statistical error by nearly three.
        idle = any(have.sum() >= 8.0 * rays and error > 0.8 * was for rays, was in reached)
        if stopping_rule.n_rays is None and (
            idle or _is_truncation_limited(result, stopping_rule, seen)
        ):
            return ensembles, result, "max_degree"
        reached.append((float(have.sum()), error))
        if have.sum() >= limit:
            return ensembles, result, "max_rays"
        missed = INTERPOLATION_FACTOR * nodes.interpolation_bound[:, np.newaxis]
        scale = compute_error_reference(result)[stopping_rule.side][:, seen]
        target = (stopping_rule.relative_stderr**2 - missed**2) * scale**2
        wanted = allocate_angular_rays(ensembles, variance, target)
        step = _allocate_round(wanted, have, limit, stopping_rule.n_rays is not None)
        work = [(*who, int(n)) for who, n in zip(levels, step, strict=True) if n > 0]
        left = float((wanted - have - step).clip(0).sum())
        runner.trace(work, error, stopping_rule.relative_stderr, left)


def make_direction_mask(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Tell in which directions the error counts: all of them if only steeper ones are wanted."""
    low = polar <= MAX_CONVERGED_POLAR_DEG
    return np.repeat(low if low.any() else ~low, len(azimuth))


def _is_truncation_limited(
    estimate: AngularEstimate, stopping_rule: StoppingRule, direction_mask: np.ndarray
) -> bool:
    """Tell whether only detail finer than the polynomials keeps a run from its goal."""
    side = stopping_rule.side
    scale, stderr = (
        compute_error_reference(estimate)[side][:, direction_mask],
        estimate.stopping_error[side][:, direction_mask],
    )
    rest = np.sqrt(
        np.maximum(stderr**2 - estimate.truncation_error[side][:, direction_mask] ** 2, 0.0)
    )
    return bool((rest <= stopping_rule.relative_stderr * scale).all())


def _allocate_round(
    target_rays: np.ndarray, n_rays: np.ndarray, max_rays: int, fixed_total: bool
) -> np.ndarray:
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
    step = np.clip(more, 0.0, (_MAX_ROUND_GROWTH - 1.0) * n_rays)
    if not step.any():
        # All have what was foretold, but the error has grown: finer detail came into sight.
        step = 0.25 * n_rays
    step *= min(1.0, room / step.sum())
    return np.ceil(step / RAYS_PER_ROUND).astype(np.int64) * RAYS_PER_ROUND
