"""Two ways to a spectrum: all wavelengths from shared paths, or each by itself.

Both run until the standard error asked for is reached at every wavelength, or the ray limit.
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
"""Rays per level, and per wavelength, of the first round, from which the number needed is
foretold.  Stopping on the variance of the very rays that form the mean draws dark values down; a
first round that is large against the few events seen there keeps this far below the error."""
_MAX_ROUND_GROWTH = 8.0
LARGE_PROBLEM_ROWS = 4000
"""Rows of which all are looked at where rays are shared out."""
_INTERPOLATION_FRACTION = 0.4
"""Part of the error asked for that interpolation between indices may take."""


@dataclass(frozen=True)
class SpectralEstimate:
    """Means and standard errors, shape (3, rows): reflected, transmitted, absorbed.

    A row is a wavelength, of the one medium or of one of several that share paths.

    Attributes
    ----------
    interpolation_error : float, shape (3, rows)
        Part of the standard error that stands for interpolation between refractive indices.
    batch_deviations : float, shape (GROUPS, 2, rows)
        How far groups of rays take the reflected and transmitted means off: sums over them of
        squares are the variance without bias, sums of products covariances.
    n_rays : int
        All rays traced.
    n_ensembles : int
        Number of path ensembles among which they are shared.
    converged : bool
        Whether the error asked for was reached everywhere.
    kernel : str
        "vectorized", "scalar", or both where ensembles differ.
    derivatives : Derivatives
        Derivatives, of as many parameters as were asked for.
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
    5-6); wavelengths take the weighted mean of the index nodes around them, and the bound on what
    this interpolation misses is added to the standard error in quadrature.
    """
    nodes = choose_nodes(rows.index, rows.interfaces, _INTERPOLATION_FRACTION * max_stderr)
    ensembles = [
        SharedPathTally(number, m, rows, w > 0.0, runner.tracer.traits)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    levels = [(e, level) for e in ensembles for level in e.strata]
    weights = nodes.weights[:, np.newaxis, :]

    if len(rows.index) > LARGE_PROBLEM_ROWS and not len(rows.absorption_derivatives):
        runner.rays_per_chunk = RAYS_PER_LARGE_CHUNK
    runner.share_kernel(ensembles)
    runner.trace([(e, level, PILOT_RAYS) for e, level in levels], 1.0, max_stderr)
    while True:
        mean = np.einsum(
            "jw,jqw->qw",
            nodes.weights,
            np.stack([e.expand_to_all_rows(e.compute_means()) for e in ensembles]),
        )
        mean = np.concatenate([mean, 1.0 - mean.sum(axis=0, keepdims=True)])
        # Near 0 and 1 a share changes in proportion to its distance from there; 8 allows for
        # elasticities up to 2.4, what a single reflection has is 4/(2 + c).
        bias = nodes.interpolation_bound * np.clip(8.0 * mean * (1.0 - mean), 0.0, 1.0)
        parts = weights**2 * np.stack(
            [e.expand_to_all_rows(e.compute_variances()) for e in ensembles]
        )
        count = np.stack([np.maximum(e.expand_to_all_rows(e.n_rays), 1.0) for e in ensembles])
        variance = (parts / count[:, np.newaxis]).sum(axis=0)
        stderr = np.sqrt(variance + bias**2)
        converged = bool(stderr.max() <= max_stderr)
        rays = np.array([level.n_rays for _, level in levels], dtype=float)
        if converged or rays.sum() >= max_rays:
            break
        wanted = allocate_spectral_rays(parts, max_stderr**2 - bias**2, ensembles)
        step = np.minimum(wanted - rays, (_MAX_ROUND_GROWTH - 1.0) * rays)
        step *= min(1.0, (max_rays - rays.sum()) / step.sum())
        left = float((wanted - rays - step).clip(0).sum())
        # However few rays are left, at least the level that wants most gets some.
        least = min(1.0, step.max())
        work = [(*who, int(np.ceil(s))) for who, s in zip(levels, step, strict=True) if s >= least]
        runner.trace(work, float(stderr.max()), max_stderr, left)
    groups = np.zeros((N_BATCHES, 2, len(rows.absorption)))
    for e, w in zip(ensembles, nodes.weights, strict=True):
        groups[..., e.rows] += w[e.rows] * e.compute_batch_deviations()
    return SpectralEstimate(
        mean,
        stderr,
        bias,
        rescale_deviations(groups, variance[:2]),
        int(rays.sum()),
        len(ensembles),
        converged,
        runner.list_kernels(ensembles),
        _interpolate_derivatives(nodes, ensembles),
    )


def _interpolate_derivatives(nodes: IndexNodes, tallies: Sequence[SharedPathTally]) -> Derivatives:
    """Return derivatives, rows taking the weighted mean of the nodes around them."""
    some, wavelengths = len(tallies[0].absorption_derivatives), nodes.weights.shape[1]
    mean = np.zeros((2, some, wavelengths))
    groups = np.zeros((N_BATCHES, *mean.shape))
    for e, w in zip(tallies, nodes.weights, strict=True):
        own, off = e.compute_derivatives()
        mean[..., e.rows] += w[e.rows] * own
        groups[..., e.rows] += w[e.rows] * off
    # As much of themselves as of light that is nearly all reflected or nearly all absorbed.
    return Derivatives(
        mean, groups, np.clip(8.0 * nodes.interpolation_bound, 0.0, 1.0) * np.abs(mean)
    )


def allocate_spectral_rays(
    weighted_variances: np.ndarray, target_variances: np.ndarray, tallies: Sequence[Tally]
) -> np.ndarray:
    """Return the rays per level that bring every variance to its target at the least cost.

    Parameters
    ----------
    weighted_variances : float, shape (ensembles, quantities, wavelengths)
        Variance per ray times squared weight.
    target_variances : float, shape (quantities, wavelengths)
        Variances to reach.
    tallies : sequence of Tally
    """
    levels = [level for e in tallies for level in e.strata]
    owner = np.repeat(np.eye(len(tallies)), [len(e.strata) for e in tallies], axis=1)
    return allocate_rays(
        weighted_variances / target_variances,
        owner,
        np.stack([x.wavelength_mask for x in levels]),
        levels,
    )


def allocate_rays(
    relative_variances: np.ndarray,
    membership: np.ndarray,
    column_mask: np.ndarray,
    strata: Sequence[Stratum],
) -> np.ndarray:
    """Return the rays per level that bring sums of variances to their targets at the least cost.

    The cost of a ray is the number of its legs.  At the optimum a level's marginal gain, summed
    over wavelengths with multipliers that stand at the binding ones, equals its cost; multipliers
    and rays are iterated to that by multiplicative updates, and then scaled to feasibility.

    Parameters
    ----------
    relative_variances : float, shape (members, quantities, columns)
        Variances per ray of what adds up, in units of the targets.
    membership : float, shape (members, levels)
        1 where the rays of a level count for a member, 0 elsewhere.
    column_mask : bool, shape (levels, columns)
        Where the rays of a level count.
    strata : sequence of Stratum
    """
    floor = np.array([level.n_rays for level in strata], dtype=float)
    cost = np.array([level.n_segments / level.n_rays for level in strata]) + 1.0
    binding = _select_binding_rows(relative_variances, column_mask)
    share, served = relative_variances[..., binding], column_mask[:, binding].astype(float)
    rays = floor.copy()
    multipliers = np.full(share.shape[1:], 1.0 / share[0].size)

    def excess(
        rays: np.ndarray, share: np.ndarray = share, served: np.ndarray = served
    ) -> np.ndarray:
        count = np.maximum((membership * rays) @ served, 1e-9)
        return (share / count[:, np.newaxis]).sum(axis=0)

    for _ in range(200):
        before = rays.copy()
        ratio = excess(rays)
        multipliers *= (ratio / ratio.max()) ** 0.5
        multipliers /= multipliers.sum()
        count = np.maximum((membership * rays) @ served, 1e-9)
        gain = (multipliers * share).sum(axis=1) / count**2
        rays *= np.sqrt((((membership.T @ gain) * served).sum(axis=1) / cost).clip(1e-30))
        rays *= excess(rays).max()
        if (np.abs(rays - before) <= 1e-4 * before).all():
            break
    rays = np.maximum(rays, floor)
    # What the floor gives away can be saved elsewhere; a little is added against falling short,
    # but only where more is wanted, or levels that have enough would grow with every round.
    wanted = rays * max(excess(rays, relative_variances, column_mask.astype(float)).max(), 0.1)
    more = wanted > floor * (1.0 + 1e-6)
    return np.where(more, np.ceil(1.03 * wanted), floor) if more.any() else floor + RAYS_PER_CHUNK


def _select_binding_rows(relative_variances: np.ndarray, column_mask: np.ndarray) -> np.ndarray:
    """Return the rows that decide how many rays are wanted: of few all.

    Of many that draw on the same levels, those that want most of an ensemble, or of all together.

    Parameters
    ----------
    relative_variances : float, shape (ensembles, quantities, rows)
    column_mask : bool, shape (levels, rows)
    """
    many = relative_variances.shape[2]
    if many <= LARGE_PROBLEM_ROWS:
        return np.arange(many)
    _, which = np.unique(np.packbits(column_mask, axis=0), axis=1, return_inverse=True)
    chosen: list[int] = []
    for alike in range(int(which.max()) + 1):
        rows = np.flatnonzero(which.ravel() == alike)
        part = relative_variances[..., rows]
        chosen += rows[part.argmax(axis=2)].ravel().tolist()
        chosen += rows[part.sum(axis=0).argmax(axis=1)].tolist()
    return np.unique(chosen)


def estimate_analog(
    runner: Runner, rows: SpectralRows, max_stderr: float, max_rays: int
) -> SpectralEstimate:
    """Estimate each row by itself, with absorption decided by coin toss on every leg.

    This is the algorithm of SPLITS section 4.3 and SPLITSnow section 3, kept as the reference.
    `max_rays` is shared equally among the rows.
    """
    many = len(rows.index)
    limit = max(ANALOG_PILOT_RAYS, max_rays // many)
    mean = np.empty((3, many))
    stderr = np.empty_like(mean)
    groups = np.empty((N_BATCHES, 2, many))
    one = np.ones(1, dtype=bool)
    traced = 0
    for row, (m, alpha) in enumerate(zip(rows.index, rows.absorption, strict=True)):
        ensemble = PathTally(row, m, alpha[np.newaxis], one, runner.tracer.traits)
        level = ensemble.strata[0]
        runner.trace([(ensemble, level, ANALOG_PILOT_RAYS)], 1.0, max_stderr)
        while True:
            variance = ensemble.compute_variances()[:, 0]
            error = np.sqrt(variance / level.n_rays)
            if error.max() <= max_stderr or level.n_rays >= limit:
                break
            wanted = 1.05 * variance.max() / max_stderr**2
            step = min(wanted, _MAX_ROUND_GROWTH * level.n_rays, limit) - level.n_rays
            runner.trace([(ensemble, level, int(np.ceil(step)))], float(error.max()), max_stderr)
        reflected, transmitted = ensemble.compute_means()[:, 0]
        mean[:, row] = reflected, transmitted, 1.0 - reflected - transmitted
        stderr[:, row] = error
        groups[:, :, row] = ensemble.compute_batch_deviations()[:, :, 0]
        traced += level.n_rays
    none = np.zeros((N_BATCHES, 2, 0, many))
    return SpectralEstimate(
        mean,
        stderr,
        np.zeros_like(mean),
        rescale_deviations(groups, stderr[:2] ** 2),
        traced,
        many,
        bool(stderr.max() <= max_stderr),
        "scalar",
        Derivatives(none[0], none, none[0]),
    )


ESTIMATORS = {"spectral": estimate_spectral, "analog": estimate_analog}
