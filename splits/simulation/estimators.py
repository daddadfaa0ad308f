"""Estimators of spectra: shared paths for all wavelengths, or analog tracing per wavelength.

Both run until the requested standard error is reached at every wavelength, or the ray limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splits.simulation.path_tally import Derivatives, SharedPathTally, SpectralRows
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes
from splits.simulation.tally import (
    N_BATCHES,
    RAYS_PER_CHUNK,
    RAYS_PER_LARGE_CHUNK,
    PathTally,
    Stratum,
    Tally,
    rescale_deviations,
)

PILOT_RAYS = 256
ANALOG_PILOT_RAYS = 2048
"""Rays of the first round per stratum, and per wavelength.  The number of rays still needed is
predicted from them.  Stopping on the variance of the rays that also form the mean biases small
values low; a first round that is large against the few events seen keeps this bias far below the
error."""
_MAX_ROUND_GROWTH = 8.0
LARGE_PROBLEM_ROWS = 4000
"""Number of rows up to which ray allocation considers all of them."""
_INTERPOLATION_FRACTION = 0.4
"""Fraction of the requested error that interpolation between indices may contribute."""


@dataclass(frozen=True)
class SpectralEstimate:
    """Means and standard errors, shape (3, rows): reflected, transmitted, absorbed.

    A row is a wavelength of one medium; several media may share paths.

    Attributes
    ----------
    interpolation_error : float, shape (3, rows)
        Part of the standard error due to interpolation between refractive indices.
    batch_deviations : float, shape (N_BATCHES, 2, rows)
        Contributions of batches to the deviations of the reflected and transmitted means: sums over
        them of squares are unbiased variances, sums of products covariances.
    n_rays : int
        All rays traced.
    n_ensembles : int
        Number of path ensembles, one per index node.
    converged : bool
        Whether the requested error was reached everywhere.
    kernel : str
        "vectorized", "scalar", or both where ensembles differ.
    derivatives : Derivatives
        Derivatives to the requested parameters.
    """

    mean: np.ndarray
    stderr: np.ndarray
    interpolation_error: np.ndarray
    batch_deviations: np.ndarray
    n_rays: int
    n_ensembles: int
    converged: bool
    kernel: str
    derivatives: Derivatives


def estimate_spectral(
    runner: Runner, rows: SpectralRows, max_stderr: float, max_rays: int
) -> SpectralEstimate:
    """Estimate all rows from path ensembles at a few refractive indices.

    The lengths of a path in each material give its weight at every wavelength (SPLITSnow Eqs
    5-6); wavelengths take the weighted mean of the index nodes around them, and the bound on the
    interpolation error is added to the standard error in quadrature.
    """
    nodes = choose_nodes(rows.index, rows.interfaces, _INTERPOLATION_FRACTION * max_stderr)
    tallies = [
        SharedPathTally(number, indices, rows, weight > 0.0, runner.tracer.traits)
        for number, (indices, weight) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    strata = [(tally, stratum) for tally in tallies for stratum in tally.strata]
    weights = nodes.weights[:, np.newaxis, :]
    if len(rows.index) > LARGE_PROBLEM_ROWS and not len(rows.absorption_derivatives):
        runner.rays_per_chunk = RAYS_PER_LARGE_CHUNK
    runner.share_kernel(tallies)
    runner.trace([(*stratum_of, PILOT_RAYS) for stratum_of in strata], 1.0, max_stderr)
    while True:
        mean = np.einsum(
            "jw,jqw->qw",
            nodes.weights,
            np.stack([tally.expand_to_all_rows(tally.compute_means()) for tally in tallies]),
        )
        mean = np.concatenate([mean, 1.0 - mean.sum(axis=0, keepdims=True)])
        # Near 0 and 1 a fraction changes in proportion to its distance from there; 8 allows for
        # elasticities up to 2.4; that of a single reflection is 4/(2 + c).
        bias = nodes.interpolation_bound * np.clip(8.0 * mean * (1.0 - mean), 0.0, 1.0)
        weighted_variances = weights**2 * np.stack(
            [tally.expand_to_all_rows(tally.compute_variances()) for tally in tallies]
        )
        n_rays = np.stack(
            [np.maximum(tally.expand_to_all_rows(tally.n_rays), 1.0) for tally in tallies]
        )
        variance = (weighted_variances / n_rays[:, np.newaxis]).sum(axis=0)
        stderr = np.sqrt(variance + bias**2)
        converged = bool(stderr.max() <= max_stderr)
        stratum_rays = np.array([stratum.n_rays for _, stratum in strata], dtype=float)
        if converged or stratum_rays.sum() >= max_rays:
            break
        target_rays = allocate_spectral_rays(weighted_variances, max_stderr**2 - bias**2, tallies)
        step = np.minimum(target_rays - stratum_rays, (_MAX_ROUND_GROWTH - 1.0) * stratum_rays)
        step *= min(1.0, (max_rays - stratum_rays.sum()) / step.sum())
        remaining_rays = float((target_rays - stratum_rays - step).clip(0).sum())
        # However few rays are left, the stratum that needs most gets some.
        min_step = min(1.0, step.max())
        work = [
            (*stratum_of, int(np.ceil(s)))
            for stratum_of, s in zip(strata, step, strict=True)
            if s >= min_step
        ]
        runner.trace(work, float(stderr.max()), max_stderr, remaining_rays)
    batch_deviations = np.zeros((N_BATCHES, 2, len(rows.absorption)))
    for tally, weight in zip(tallies, nodes.weights, strict=True):
        batch_deviations[..., tally.rows] += weight[tally.rows] * tally.compute_batch_deviations()
    return SpectralEstimate(
        mean,
        stderr,
        bias,
        rescale_deviations(batch_deviations, variance[:2]),
        int(stratum_rays.sum()),
        len(tallies),
        converged,
        runner.list_kernels(tallies),
        _interpolate_derivatives(nodes, tallies),
    )


def _interpolate_derivatives(nodes: IndexNodes, tallies: Sequence[SharedPathTally]) -> Derivatives:
    """Return derivatives as weighted means of the nodes around each row."""
    n_parameters, wavelengths = len(tallies[0].absorption_derivatives), nodes.weights.shape[1]
    mean = np.zeros((2, n_parameters, wavelengths))
    batch_deviations = np.zeros((N_BATCHES, *mean.shape))
    for tally, weight in zip(tallies, nodes.weights, strict=True):
        node_mean, node_deviations = tally.compute_derivatives()
        mean[..., tally.rows] += weight[tally.rows] * node_mean
        batch_deviations[..., tally.rows] += weight[tally.rows] * node_deviations
    # The relative bound is that of light that is nearly all reflected or nearly all absorbed.
    return Derivatives(
        mean, batch_deviations, np.clip(8.0 * nodes.interpolation_bound, 0.0, 1.0) * np.abs(mean)
    )


def allocate_spectral_rays(
    weighted_variances: np.ndarray, target_variances: np.ndarray, tallies: Sequence[Tally]
) -> np.ndarray:
    """Return the rays per stratum that bring every variance to its target at the least cost.

    Parameters
    ----------
    weighted_variances : float, shape (tallies, quantities, wavelengths)
        Variance per ray times squared weight.
    target_variances : float, shape (quantities, wavelengths)
        Variances to reach.
    tallies : sequence of Tally
    """
    strata = [stratum for tally in tallies for stratum in tally.strata]
    membership = np.repeat(np.eye(len(tallies)), [len(tally.strata) for tally in tallies], axis=1)
    return allocate_rays(
        weighted_variances / target_variances,
        membership,
        np.stack([stratum.wavelength_mask for stratum in strata]),
        strata,
    )


def allocate_rays(
    relative_variances: np.ndarray,
    membership: np.ndarray,
    column_mask: np.ndarray,
    strata: Sequence[Stratum],
) -> np.ndarray:
    """Return the rays per stratum that bring sums of variances to their targets at the least cost.

    The cost of a ray is its number of segments.  At the optimum the marginal gain of a stratum,
    summed over wavelengths with multipliers that are nonzero where the target binds, equals its
    cost; multipliers and rays are iterated by multiplicative updates, and then scaled to
    feasibility.

    Parameters
    ----------
    relative_variances : float, shape (members, quantities, columns)
        Variances per ray of the terms that add up, in units of the targets.
    membership : float, shape (members, strata)
        1 where the rays of a stratum contribute to a member, 0 elsewhere.
    column_mask : bool, shape (strata, columns)
        Where the rays of a stratum contribute.
    strata : sequence of Stratum
    """
    floor = np.array([stratum.n_rays for stratum in strata], dtype=float)
    cost = np.array([stratum.n_segments / stratum.n_rays for stratum in strata]) + 1.0
    binding = _select_binding_rows(relative_variances, column_mask)
    variances, mask = relative_variances[..., binding], column_mask[:, binding].astype(float)
    stratum_rays = floor.copy()
    multipliers = np.full(variances.shape[1:], 1.0 / variances[0].size)

    def compute_relative_variance(
        stratum_rays: np.ndarray, variances: np.ndarray = variances, mask: np.ndarray = mask
    ) -> np.ndarray:
        n_rays = np.maximum((membership * stratum_rays) @ mask, 1e-9)
        return (variances / n_rays[:, np.newaxis]).sum(axis=0)

    for _ in range(200):
        before = stratum_rays.copy()
        ratio = compute_relative_variance(stratum_rays)
        multipliers *= (ratio / ratio.max()) ** 0.5
        multipliers /= multipliers.sum()
        n_rays = np.maximum((membership * stratum_rays) @ mask, 1e-9)
        gain = (multipliers * variances).sum(axis=1) / n_rays**2
        stratum_rays *= np.sqrt((((membership.T @ gain) * mask).sum(axis=1) / cost).clip(1e-30))
        stratum_rays *= compute_relative_variance(stratum_rays).max()
        if (np.abs(stratum_rays - before) <= 1e-4 * before).all():
            break
    stratum_rays = np.maximum(stratum_rays, floor)
    # Rays above the optimum in one stratum allow fewer in others.  A margin of 3 % is added, but
    # only where more rays are needed, or strata that have enough would grow with every round.
    target_rays = stratum_rays * max(
        compute_relative_variance(
            stratum_rays, relative_variances, column_mask.astype(float)
        ).max(),
        0.1,
    )
    more = target_rays > floor * (1.0 + 1e-6)
    return (
        np.where(more, np.ceil(1.03 * target_rays), floor) if more.any() else floor + RAYS_PER_CHUNK
    )


def _select_binding_rows(relative_variances: np.ndarray, column_mask: np.ndarray) -> np.ndarray:
    """Return the rows that determine the number of rays: of few rows all of them.

    Of many rows served by the same strata, those with the largest variance in a tally or in total.

    Parameters
    ----------
    relative_variances : float, shape (tallies, quantities, rows)
    column_mask : bool, shape (strata, rows)
    """
    n_rows = relative_variances.shape[2]
    if n_rows <= LARGE_PROBLEM_ROWS:
        return np.arange(n_rows)
    _, pattern = np.unique(np.packbits(column_mask, axis=0), axis=1, return_inverse=True)
    chosen: list[int] = []
    for number in range(int(pattern.max()) + 1):
        rows = np.flatnonzero(pattern.ravel() == number)
        variances = relative_variances[..., rows]
        chosen += rows[variances.argmax(axis=2)].ravel().tolist()
        chosen += rows[variances.sum(axis=0).argmax(axis=1)].tolist()
    return np.unique(chosen)


def estimate_analog(
    runner: Runner, rows: SpectralRows, max_stderr: float, max_rays: int
) -> SpectralEstimate:
    """Estimate each row independently, with analog absorption sampled at each segment.

    This is the algorithm of SPLITS section 4.3 and SPLITSnow section 3, kept as the reference.
    `max_rays` is divided equally among the rows.
    """
    n_rows = len(rows.index)
    limit = max(ANALOG_PILOT_RAYS, max_rays // n_rows)
    mean = np.empty((3, n_rows))
    stderr = np.empty_like(mean)
    batch_deviations = np.empty((N_BATCHES, 2, n_rows))
    mask = np.ones(1, dtype=bool)
    n_rays = 0
    for row, (m, alpha) in enumerate(zip(rows.index, rows.absorption, strict=True)):
        tally = PathTally(row, m, alpha[np.newaxis], mask, runner.tracer.traits)
        stratum = tally.strata[0]
        runner.trace([(tally, stratum, ANALOG_PILOT_RAYS)], 1.0, max_stderr)
        while True:
            variance = tally.compute_variances()[:, 0]
            error = np.sqrt(variance / stratum.n_rays)
            if error.max() <= max_stderr or stratum.n_rays >= limit:
                break
            target_rays = 1.05 * variance.max() / max_stderr**2
            step = min(target_rays, _MAX_ROUND_GROWTH * stratum.n_rays, limit) - stratum.n_rays
            runner.trace([(tally, stratum, int(np.ceil(step)))], float(error.max()), max_stderr)
        reflected, transmitted = tally.compute_means()[:, 0]
        mean[:, row] = reflected, transmitted, 1.0 - reflected - transmitted
        stderr[:, row] = error
        batch_deviations[:, :, row] = tally.compute_batch_deviations()[:, :, 0]
        n_rays += stratum.n_rays
    empty = np.zeros((N_BATCHES, 2, 0, n_rows))
    return SpectralEstimate(
        mean,
        stderr,
        np.zeros_like(mean),
        rescale_deviations(batch_deviations, stderr[:2] ** 2),
        n_rays,
        n_rows,
        bool(stderr.max() <= max_stderr),
        "scalar",
        Derivatives(empty[0], empty, empty[0]),
    )


ESTIMATORS = {"spectral": estimate_spectral, "analog": estimate_analog}
