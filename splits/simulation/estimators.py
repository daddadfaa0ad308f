"""Estimators of spectra: shared paths for all wavelengths, or analog tracing per wavelength.

Both run until the requested standard error is reached at every wavelength, or the ray limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splits.simulation.path_tally import Derivatives, SharedPathTally, SpectralRows
from splits.simulation.ray_allocation import LARGE_PROBLEM_ROWS, allocate_spectral_rays
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes
from splits.simulation.tally import (
    N_BATCHES,
    RAYS_PER_LARGE_CHUNK,
    PathTally,
    rescale_deviations,
)

PILOT_RAYS = 256
ANALOG_PILOT_RAYS = 2048
"""Rays of the first round per stratum, and per wavelength.  The number of rays still needed is
predicted from them.  Stopping on the variance of the rays that also form the mean biases small
values low; a first round that is large against the few events seen keeps this bias far below the
error."""
_MAX_ROUND_GROWTH = 8.0
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
        steps = zip(strata, step, strict=True)
        work = [(*stratum_of, int(np.ceil(s))) for stratum_of, s in steps if s >= min_step]
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
        runner.format_kernels(tallies),
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
