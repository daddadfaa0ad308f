"""Estimates of radiative fluxes inside a medium, traced to the requested error."""

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
    """Batch means at the requested depths, and between them.

    Attributes
    ----------
    irradiance : float, shape (N_BATCHES, 2, depths, wavelengths)
        Downward and upward irradiances, relative to the incident irradiance.
    absorptance : float, shape (N_BATCHES, intervals, wavelengths)
        Difference of the net irradiances at the planes of an interval.
    material_absorptance : float, shape (N_BATCHES, intervals, materials, wavelengths)
        From the lengths in each material.
    path_length : float, shape (N_BATCHES, intervals, wavelengths)
        Metres; of a semi-infinite interval, down to the end of tracing.
    """

    irradiance: np.ndarray
    absorptance: np.ndarray
    material_absorptance: np.ndarray
    path_length: np.ndarray

    def select_wavelengths(self, wavelengths: slice) -> FluxEstimate:
        """Return the estimate at some wavelengths."""
        return FluxEstimate(*(array[..., wavelengths] for array in self))


class FluxResult(NamedTuple):
    """Estimate with its systematic error, the error reached and the stop reason.

    Attributes
    ----------
    estimate : FluxEstimate
    systematic_error : SystematicError
    perturbed_estimate : FluxEstimate or None
        Estimate with a more absorbing substrate below a truncation depth, see `TracedMedium`.
    max_stderr_reached : float
    stop_reason : {"converged", "max_rays", "interpolation_bound"}
        Whether the error or the number of rays was reached, or the rest is a bound that more rays
        do not reduce.
    """

    estimate: FluxEstimate
    systematic_error: SystematicError
    perturbed_estimate: FluxEstimate | None
    max_stderr_reached: float
    stop_reason: str


def _estimate_at_planes(
    tally: FluxPathTally, weight: np.ndarray, boundary_rows: np.ndarray, semi_infinite: bool
) -> FluxEstimate:
    """Return the weighted estimate of a tally at the boundaries `boundary_rows`.

    In a semi-infinite medium, the last boundary is the end of tracing, and the last interval
    continues below it.
    """
    means = tally.compute_batch_means()
    irradiance = weight * means.irradiance[:, :, boundary_rows]
    net = irradiance[:, DOWNWARD] - irradiance[:, UPWARD]
    first_layers = boundary_rows[:-1]
    absorptance = net[:, :-1] - net[:, 1:]
    by_material = weight * np.add.reduceat(
        means.absorptance[:, : boundary_rows[-1]], first_layers, axis=1
    )
    path_length = weight * np.add.reduceat(
        means.path_length[:, : boundary_rows[-1]], first_layers, axis=1
    )
    if semi_infinite:
        irradiance, absorptance[:, -1] = irradiance[:, :, :-1], net[:, -2]
        # Light that enters the rest is absorbed by materials in proportion to the layer just above.
        last = means.absorptance[:, boundary_rows[-1] - 1].mean(axis=0)
        total = last.sum(axis=0)
        fraction = np.divide(last, total, out=np.zeros_like(last), where=total > 0.0)
        by_material[:, -1] += fraction * net[:, -1, np.newaxis]
    return FluxEstimate(irradiance, absorptance, by_material, path_length)


def _compute_stopping_errors(
    estimate: FluxEstimate, systematic_error: SystematicError, stopping_rule: FluxStoppingRule
) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard errors of the quantities of a rule, and their irreducible parts."""
    scatter = compute_batch_stderr(
        stopping_rule.average_over_bands(
            stopping_rule.select_quantities(estimate.irradiance, estimate.absorptance)
        )
    )
    irreducible = stopping_rule.average_over_bands(
        stopping_rule.select_quantities(*systematic_error.irreducible)
    )
    systematic = stopping_rule.average_over_bands(
        stopping_rule.select_quantities(systematic_error.irradiance, systematic_error.absorptance)
    )
    return np.hypot(scatter, systematic), irreducible


def estimate_flux(
    runner: Runner,
    tallies: Sequence[FluxPathTally],
    nodes: IndexNodes,
    traced_medium: TracedMedium,
    stopping_rule: FluxStoppingRule,
    max_rays: int,
) -> FluxResult:
    """Trace until the requested error or the largest number of rays is reached."""
    strata = [(tally, stratum) for tally in tallies for stratum in tally.strata]
    # The boundary above a rough surface is above the depth 0.
    boundary_rows = np.append(
        0, np.searchsorted(runner.tracer.boundary_depths_m, traced_medium.planes_m[1:])
    )
    requested = slice(traced_medium.n_wavelengths)
    runner.trace(
        [(*stratum_of, FLUX_RAYS_PER_ROUND) for stratum_of in strata], 1.0, stopping_rule.max_stderr
    )
    while True:
        all_estimates = [
            _estimate_at_planes(tally, weight, boundary_rows, traced_medium.semi_infinite)
            for tally, weight in zip(tallies, nodes.weights, strict=True)
        ]
        arrays = zip(*all_estimates, strict=True)
        whole = FluxEstimate(*(np.sum(each, axis=0) for each in arrays))
        estimate = whole.select_wavelengths(requested)
        rest = whole.select_wavelengths(slice(traced_medium.n_wavelengths, None))
        perturbed = rest if traced_medium.truncated else None
        systematic_error = estimate_systematic_error(
            estimate[:2],
            None if perturbed is None else perturbed[:2],
            nodes.interpolation_bound[requested],
            compute_single_ray_error(tallies, nodes.weights)[requested],
        )
        stderr, irreducible = _compute_stopping_errors(estimate, systematic_error, stopping_rule)
        reached = float((stderr / stopping_rule.stderr_limits).max()) * stopping_rule.max_stderr
        n_rays = np.array([stratum.n_rays for _, stratum in strata], dtype=float)
        if reached <= stopping_rule.max_stderr:
            return FluxResult(estimate, systematic_error, perturbed, reached, "converged")
        if (irreducible > stopping_rule.stderr_limits).any() and (
            stderr**2 - irreducible**2 < MIN_SCATTER_FRACTION * stopping_rule.stderr_limits**2
        ).all():
            return FluxResult(estimate, systematic_error, perturbed, reached, "interpolation_bound")
        if n_rays.sum() >= max_rays:
            return FluxResult(estimate, systematic_error, perturbed, reached, "max_rays")
        estimates = [one.select_wavelengths(requested) for one in all_estimates]
        quantities = [
            stopping_rule.select_quantities(one.irradiance, one.absorptance) for one in estimates
        ]
        target_rays = allocate_flux_rays(stopping_rule, tallies, quantities, irreducible)
        step = np.minimum(target_rays - n_rays, (_MAX_ROUND_GROWTH - 1.0) * n_rays)
        step = np.ceil(
            step * min(1.0, (max_rays - n_rays.sum()) / step.sum()) / FLUX_RAYS_PER_ROUND
        )
        remaining = float((target_rays - n_rays - step * FLUX_RAYS_PER_ROUND).clip(0).sum())
        work = [
            (*stratum_of, int(n_rounds) * FLUX_RAYS_PER_ROUND)
            for stratum_of, n_rounds in zip(strata, step, strict=True)
            if n_rounds > 0
        ]
        runner.trace(work, reached, stopping_rule.max_stderr, remaining)


def compute_absorbed_fractions(estimate: FluxEstimate) -> np.ndarray:
    """Return the absorptance of each material; the sum over materials is the total absorptance.

    The shape is (N_BATCHES, intervals, materials, wavelengths); the materials' parts vary by batch
    to first order.  Where no path scores an interval, the fractions are those of the whole sample,
    and equal for all materials where none scores that either; the errors include this
    (`bound_material_absorptance_error`).
    """
    parts = estimate.material_absorptance
    total_scored = parts.sum(axis=2, keepdims=True)
    mean_scored = total_scored.mean(axis=0)
    sample_parts = parts.mean(axis=0).sum(axis=0, keepdims=True)
    sample_total = sample_parts.sum(axis=1, keepdims=True)
    equal = np.full_like(sample_parts, 1.0 / sample_parts.shape[1])
    fraction = np.broadcast_to(
        np.divide(sample_parts, sample_total, out=equal, where=sample_total > 0.0),
        mean_scored.shape[:1] + sample_parts.shape[1:],
    ).copy()
    np.divide(parts.mean(axis=0), mean_scored, out=fraction, where=mean_scored > 0.0)
    absorbed = estimate.absorptance[:, :, np.newaxis]
    mean_absorbed = absorbed.mean(axis=0)
    scale = np.divide(
        mean_absorbed, mean_scored, out=np.zeros_like(mean_absorbed), where=mean_scored > 0.0
    )
    absorptance: np.ndarray = absorbed * fraction + scale * (parts - fraction * total_scored)
    return absorptance
