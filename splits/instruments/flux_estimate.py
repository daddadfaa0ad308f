"""Rays traced until what they tell of the light inside is known as well as asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.flux_errors import (
    SystematicError,
    compute_single_ray_error,
    estimate_systematic_error,
)
from splits.instruments.flux_media import TracedMedium
from splits.instruments.flux_stopping_rule import (
    MIN_SCATTER_FRACTION,
    FluxStoppingRule,
    allocate_flux_rays,
)
from splits.instruments.flux_tally import FLUX_RAYS_PER_ROUND, FluxPathTally
from splits.kernels.tallies.flux import DOWNWARD, UPWARD
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import IndexNodes

_MAX_ROUND_GROWTH = 8.0


class FluxEstimate(NamedTuple):
    """Means by batch of rays at the depths asked for, and between them.

    Attributes
    ----------
    irradiance : float, shape (GROUPS, 2, depths, wavelengths)
        Irradiances downwards and upwards, over that of the light from above.
    absorptance : float, shape (GROUPS, intervals, wavelengths)
        What goes in less what comes out.
    material_absorptance : float, shape (GROUPS, intervals, materials, wavelengths)
        By the lengths in each material.
    path_length : float, shape (GROUPS, intervals, wavelengths)
        Metres; of an interval without end, down to where tracing ends.
    """

    irradiance: np.ndarray
    absorptance: np.ndarray
    material_absorptance: np.ndarray
    path_length: np.ndarray

    def select_wavelengths(self, wavelengths: slice) -> FluxEstimate:
        """Return what was found at some wavelengths."""
        return FluxEstimate(*(each[..., wavelengths] for each in self))


class FluxResult(NamedTuple):
    """What was found, with what errors hold besides scatter, and the error reached.

    Attributes
    ----------
    estimate : Found
    systematic_error : SystematicError
    perturbed_estimate : Found or None
        What would have been found if the part below a cut kept more, see `TracedMedium`.
    max_stderr_reached : float
    stop_reason : {"converged", "max_rays", "interpolation_bound"}
        The error was reached, or so many rays, or what remains is a bound that rays do not lower.
    """

    estimate: FluxEstimate
    systematic_error: SystematicError
    perturbed_estimate: FluxEstimate | None
    max_stderr_reached: float
    stop_reason: str


def _estimate_at_planes(
    tally: FluxPathTally, weight: np.ndarray, boundary_rows: np.ndarray, semi_infinite: bool
) -> FluxEstimate:
    """Return what an ensemble tells at faces `boundary_rows`, as its wavelengths weigh it.

    In a medium without end, the last face is where tracing ends, and the last interval goes on.
    """
    told = tally.compute_batch_means()
    light = weight * told.irradiance[:, :, boundary_rows]
    net = light[:, DOWNWARD] - light[:, UPWARD]
    first = boundary_rows[:-1]
    absorbed = net[:, :-1] - net[:, 1:]
    by_material = weight * np.add.reduceat(told.absorptance[:, : boundary_rows[-1]], first, axis=1)
    way = weight * np.add.reduceat(told.path_length[:, : boundary_rows[-1]], first, axis=1)
    if semi_infinite:
        light, absorbed[:, -1] = light[:, :, :-1], net[:, -2]
        # What enters below is absorbed by the materials of the lowest layer, as just above.
        last = told.absorptance[:, boundary_rows[-1] - 1].mean(axis=0)
        whole = last.sum(axis=0)
        share = np.divide(last, whole, out=np.zeros_like(last), where=whole > 0.0)
        by_material[:, -1] += share * net[:, -1, np.newaxis]
    return FluxEstimate(light, absorbed, by_material, way)


def estimate_flux(
    runner: Runner,
    tallies: Sequence[FluxPathTally],
    nodes: IndexNodes,
    traced_medium: TracedMedium,
    stopping_rule: FluxStoppingRule,
    max_rays: int,
) -> FluxResult:
    """Trace until the error asked for is reached, or so many rays."""
    levels = [(e, level) for e in tallies for level in e.strata]
    # The face above a rough surface is above the depth 0.
    at = np.append(0, np.searchsorted(runner.tracer.boundary_depths_m, traced_medium.planes_m[1:]))
    own = slice(traced_medium.n_wavelengths)
    runner.trace([(*who, FLUX_RAYS_PER_ROUND) for who in levels], 1.0, stopping_rule.max_stderr)
    while True:
        every = [
            _estimate_at_planes(e, weight, at, traced_medium.semi_infinite)
            for e, weight in zip(tallies, nodes.weights, strict=True)
        ]
        whole = FluxEstimate(*(np.sum(part, axis=0) for part in zip(*every, strict=True)))
        found, each = whole.select_wavelengths(own), [one.select_wavelengths(own) for one in every]
        moved = (
            whole.select_wavelengths(slice(traced_medium.n_wavelengths, None))
            if traced_medium.truncated
            else None
        )
        least = compute_single_ray_error(tallies, nodes.weights)[own]
        doubt = estimate_systematic_error(
            found[:2], None if moved is None else moved[:2], nodes.interpolation_bound[own], least
        )
        scatter = compute_batch_stderr(
            stopping_rule.average_over_bands(
                stopping_rule.select_quantities(found.irradiance, found.absorptance)
            )
        )
        bias = stopping_rule.average_over_bands(stopping_rule.select_quantities(*doubt.irreducible))
        stderr = np.hypot(
            scatter,
            stopping_rule.average_over_bands(
                stopping_rule.select_quantities(doubt.irradiance, doubt.absorptance)
            ),
        )
        reached = float((stderr / stopping_rule.stderr_limits).max()) * stopping_rule.max_stderr
        rays = np.array([level.n_rays for _, level in levels], dtype=float)
        if reached <= stopping_rule.max_stderr:
            return FluxResult(found, doubt, moved, reached, "converged")
        if (bias > stopping_rule.stderr_limits).any() and (
            stderr**2 - bias**2 < MIN_SCATTER_FRACTION * stopping_rule.stderr_limits**2
        ).all():
            return FluxResult(found, doubt, moved, reached, "interpolation_bound")
        if rays.sum() >= max_rays:
            return FluxResult(found, doubt, moved, reached, "max_rays")
        more = allocate_flux_rays(
            stopping_rule,
            tallies,
            [stopping_rule.select_quantities(one.irradiance, one.absorptance) for one in each],
            bias,
        )
        step = np.minimum(more - rays, (_MAX_ROUND_GROWTH - 1.0) * rays)
        step = np.ceil(step * min(1.0, (max_rays - rays.sum()) / step.sum()) / FLUX_RAYS_PER_ROUND)
        left = float((more - rays - step * FLUX_RAYS_PER_ROUND).clip(0).sum())
        work = [
            (*who, int(s) * FLUX_RAYS_PER_ROUND)
            for who, s in zip(levels, step, strict=True)
            if s > 0
        ]
        runner.trace(work, reached, stopping_rule.max_stderr, left)


def compute_absorbed_fractions(estimate: FluxEstimate) -> np.ndarray:
    """Return absorbed shares by material, whose sums are those of `Found.absorbed`.

    Shape (GROUPS, intervals, materials, wavelengths); the materials' parts vary by group to first
    order.  Where no path tells of an interval, its shares are those of the whole sample, and the
    same for all materials where none tells of that; errors say so (`share_missed`).
    """
    parts = estimate.material_absorptance
    whole = parts.sum(axis=2, keepdims=True)
    mean = whole.mean(axis=0)
    of_all = parts.mean(axis=0).sum(axis=0, keepdims=True)
    every = of_all.sum(axis=1, keepdims=True)
    even = np.full_like(of_all, 1.0 / of_all.shape[1])
    share = np.broadcast_to(
        np.divide(of_all, every, out=even, where=every > 0.0), mean.shape[:1] + of_all.shape[1:]
    ).copy()
    np.divide(parts.mean(axis=0), mean, out=share, where=mean > 0.0)
    absorbed = estimate.absorptance[:, :, np.newaxis]
    total = absorbed.mean(axis=0)
    scale = np.divide(total, mean, out=np.zeros_like(total), where=mean > 0.0)
    result: np.ndarray = absorbed * share + scale * (parts - share * whole)
    return result
