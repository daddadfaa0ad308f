"""Polynomial expansion of BRDFs: tracing until every direction has the requested error."""

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
"""Largest degree of the polynomials, which resolve details of about 180°/24."""

MAX_CONVERGED_POLAR_DEG = 82.5
"""Largest polar angle at which the requested error must be reached."""

_MAX_ROUND_GROWTH = 8.0


def trace_expansion(
    runner: Runner,
    nodes: IndexNodes,
    absorption: np.ndarray,
    polar: np.ndarray,
    azimuth: np.ndarray,
    stopping_rule: StoppingRule,
) -> tuple[list[ExpansionTally], AngularEstimate, str]:
    """Trace until the stopping rule is satisfied; return tallies, estimate and stop reason."""
    diffuse, side = runner.tracer.diffuse, stopping_rule.side
    axisymmetric = runner.tracer.normal_incidence or diffuse
    directions = make_direction_grid(polar, azimuth, make_basis(MAX_DEGREE))
    direction_mask = make_direction_mask(polar, azimuth)
    tallies = [
        ExpansionTally(
            number, indices, absorption, weights, directions.basis, exclude_unscattered=not diffuse
        )
        for number, (indices, weights) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    strata = [(tally, stratum) for tally in tallies for stratum in tally.strata]
    max_rays = stopping_rule.n_rays or stopping_rule.max_rays
    first_round = [(*stratum_of, RAYS_PER_ROUND) for stratum_of in strata]
    runner.trace(first_round, 1.0, stopping_rule.relative_stderr)
    history: list[tuple[float, float]] = []
    while True:
        with limit_blas_threads():
            result, variance = estimate_brdf(
                tallies, nodes.interpolation_bound, directions, axisymmetric, side, direction_mask
            )
        error = compute_max_relative_error(result, side, direction_mask, use_stopping_error=True)
        n_rays = np.array([stratum.n_rays for _, stratum in strata])
        if stopping_rule.n_rays is None and error <= stopping_rule.relative_stderr:
            stated_error = compute_max_relative_error(result, side, direction_mask)
            resolved = stated_error <= stopping_rule.relative_stderr
            return tallies, result, "converged" if resolved else "unresolved_lobe"
        # Eight times the rays should reduce a statistical error by a factor of nearly three.
        stagnates = any(
            n_rays.sum() >= 8.0 * earlier_rays and error > 0.8 * earlier
            for earlier_rays, earlier in history
        )
        if stopping_rule.n_rays is None and (
            stagnates or _is_truncation_limited(result, stopping_rule, direction_mask)
        ):
            return tallies, result, "max_degree"
        history.append((float(n_rays.sum()), error))
        if n_rays.sum() >= max_rays:
            return tallies, result, "max_rays"
        interpolation_error = INTERPOLATION_FACTOR * nodes.interpolation_bound[:, np.newaxis]
        reference = compute_error_reference(result)[side][:, direction_mask]
        target = (stopping_rule.relative_stderr**2 - interpolation_error**2) * reference**2
        target_rays = allocate_angular_rays(tallies, variance, target)
        step = _allocate_round(target_rays, n_rays, max_rays, stopping_rule.n_rays is not None)
        work = [(*stratum_of, int(n)) for stratum_of, n in zip(strata, step, strict=True) if n > 0]
        remaining = float((target_rays - n_rays - step).clip(0).sum())
        runner.trace(work, error, stopping_rule.relative_stderr, remaining)


def make_direction_mask(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Return the directions of the stopping rule: all if only steeper ones are requested."""
    low = polar <= MAX_CONVERGED_POLAR_DEG
    return np.repeat(low if low.any() else ~low, len(azimuth))


def _is_truncation_limited(
    estimate: AngularEstimate, stopping_rule: StoppingRule, direction_mask: np.ndarray
) -> bool:
    """Return whether only detail finer than the polynomials prevents convergence."""
    side = stopping_rule.side
    reference, stderr = (
        compute_error_reference(estimate)[side][:, direction_mask],
        estimate.stopping_error[side][:, direction_mask],
    )
    statistical_error = np.sqrt(
        np.maximum(stderr**2 - estimate.truncation_error[side][:, direction_mask] ** 2, 0.0)
    )
    return bool((statistical_error <= stopping_rule.relative_stderr * reference).all())


def _allocate_round(
    target_rays: np.ndarray, n_rays: np.ndarray, max_rays: int, fixed_total: bool
) -> np.ndarray:
    """Return the rays to add to each stratum: those required, or in proportion to them."""
    remaining = float(max_rays - n_rays.sum())
    more = target_rays - n_rays
    if fixed_total:
        low, high = 0.0, (n_rays.sum() + remaining) / target_rays.min()
        for _ in range(60):
            middle = 0.5 * (low + high)
            enough = np.clip(middle * target_rays - n_rays, 0.0, None).sum() >= remaining
            low, high = (low, middle) if enough else (middle, high)
        more = high * target_rays - n_rays
    step = np.clip(more, 0.0, (_MAX_ROUND_GROWTH - 1.0) * n_rays)
    if not step.any():
        # All have the predicted number, but the error has grown, as finer detail was resolved.
        step = 0.25 * n_rays
    step *= min(1.0, remaining / step.sum())
    return np.ceil(step / RAYS_PER_ROUND).astype(np.int64) * RAYS_PER_ROUND
