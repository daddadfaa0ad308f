"""Tally of radiative fluxes at planes in a medium, by batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_batch_stderr
from splits.core.validation import invalid
from splits.instruments.flux_media import TracedMedium
from splits.kernels.records import N_BATCHES
from splits.kernels.scene import Scene
from splits.kernels.tallies.flux import DOWNWELLING, UPWELLING, FluxSums, tally_flux
from splits.simulation.engine import MIN_ROUND_GROWTH
from splits.simulation.spectral_nodes import MAX_LOG_SLOPE, IndexNodes
from splits.simulation.strata import (
    Evaluation,
    StoppingRule,
    Stratum,
    VarianceTerms,
    allocate_rays,
    compute_absorption_per_mfp,
)
from splits.simulation.tally import ExitTally, allow_for_unseen_rays

# --------------------------------------------------------------------------------------------------
# Errors of radiative fluxes inside a medium other than the scatter of batches.

MIN_EFFECTIVE_BATCHES = 8
"""Effective number of batches with light below which an error includes that of one more ray."""
MAX_BRIGHTENING = 4.0
"""Largest ratio of the light at a plane, or along paths below it, to that at the plane above."""


def estimate_rare_event_error(batch_means: np.ndarray, unsampled_light: np.ndarray) -> np.ndarray:
    """Return the errors of means that few batches dominate.

    They may be wrong by one more ray, or by one more contribution like the largest.

    Parameters
    ----------
    batch_means : float, shape (N_BATCHES, ..., wavelengths)
    unsampled_light : float, shape (..., wavelengths)
        Largest contribution of unsampled rays, see `bound_unsampled_light`.
    """
    largest = np.abs(batch_means).max(axis=0) / len(batch_means)
    return np.where(is_sparse(batch_means), np.hypot(unsampled_light, largest), 0.0)


def is_sparse(batch_means: np.ndarray) -> np.ndarray:
    """Return where few batches contribute most of a quantity.

    (Σ x)²/Σ x² is the number of equal batches with the same relative scatter.
    """
    total, square = np.abs(batch_means).sum(axis=0), (batch_means**2).sum(axis=0)
    return np.asarray((square == 0.0) | (total**2 < MIN_EFFECTIVE_BATCHES * square))


def estimate_unseen_reflection(
    downward_irradiance: np.ndarray, upward_irradiance: np.ndarray, unsampled_light: np.ndarray
) -> np.ndarray:
    """Return the errors of upward irradiances by rays that grains reflect without entering.

    Below strongly absorbed light they are few, and all other light has a small weight
    (`splits.simulation.tally`).

    Parameters
    ----------
    downward_irradiance, upward_irradiance : float, shape (N_BATCHES, depths, wavelengths)
    unsampled_light : float, shape (depths, wavelengths)
        See `bound_unsampled_light`.
    """
    downward, upward = downward_irradiance.mean(axis=0), upward_irradiance.mean(axis=0)
    reflectance = np.divide(upward, downward, out=np.zeros_like(upward), where=downward > 0.0)
    single_ray_error = unsampled_light * (1.0 - np.minimum(reflectance, 1.0))
    variance = compute_batch_stderr(upward_irradiance) ** 2
    return np.sqrt(allow_for_unseen_rays(variance, single_ray_error**2) - variance)


def bound_unsampled_light(
    downward_irradiance: np.ndarray, single_ray_error: np.ndarray
) -> np.ndarray:
    """Return a bound on the light of unsampled rays at each depth and below it.

    It is that of one more ray, and at most a multiple of the light that reaches the plane above,
    since unsampled rays are absorbed on the way to it, too.

    Parameters
    ----------
    downward_irradiance : float, shape (N_BATCHES, depths, wavelengths)
        Irradiance downwards.
    single_ray_error : float, shape (wavelengths,)

    Returns
    -------
    float, shape (depths + 1, wavelengths)
        The last below the last depth.
    """
    sparse = is_sparse(downward_irradiance)
    mean_irradiance = downward_irradiance.mean(axis=0)
    bounds, ceiling = [single_ray_error], single_ray_error
    for is_rare, mean in zip(sparse, mean_irradiance, strict=True):
        ceiling = mean + np.where(is_rare, np.minimum(ceiling, single_ray_error), 0.0)
        bounds.append(np.minimum(single_ray_error, MAX_BRIGHTENING * ceiling))
    return np.stack(bounds)


def bound_flux_interpolation_error(
    interpolation_bound: np.ndarray, value: np.ndarray
) -> np.ndarray:
    """Return a bound on the interpolation error of irradiances and similar quantities.

    It is that of a reflectance (`splits.simulation.spectral_nodes`), with the elasticity |ln f| of
    quantities that decay exponentially with depth, where that is larger.

    Parameters
    ----------
    interpolation_bound : float, shape (wavelengths,)
    value : float, shape (..., wavelengths)
        Value of the quantity.
    """
    size = np.clip(np.abs(value), np.finfo(float).tiny, None)
    elastic = size * np.maximum(8.0, np.abs(np.log(size)) / MAX_LOG_SLOPE)
    return interpolation_bound * np.minimum(np.maximum(1.0, size), elastic)


# --------------------------------------------------------------------------------------------------
# Quantities inside a medium whose errors determine when a run stops, and the rays they need.

_MIN_RELATIVE_VARIANCE = 1e-9


class FluxTarget(NamedTuple):
    """Quantities whose standard errors determine when a run stops.

    Attributes
    ----------
    limit_irradiance : bool
        Whether the largest error applies to irradiances at all depths, besides absorptances and
        reflectance.
    band_weights : float, shape (bands, wavelengths), or None
        Fractions of each band's light; None applies to every wavelength.
    variance_fractions : float, shape (bands,)
        Fraction of the variance of each band that is allowed here.
    """

    limit_irradiance: bool = True
    band_weights: np.ndarray | None = None
    variance_fractions: np.ndarray | float = 1.0

    def select_quantities(self, quantities: np.ndarray, n_depths: int) -> np.ndarray:
        """Return the quantities to which the error applies.

        Parameters
        ----------
        quantities : float, shape (..., quantities, wavelengths)
            See `FluxEstimate`.
        n_depths : int
            Number of depths of irradiances.
        """
        if self.limit_irradiance:
            return quantities
        reflectance, absorptance = slice(n_depths, n_depths + 1), slice(2 * n_depths, None)
        parts = [quantities[..., rows, :] for rows in (reflectance, absorptance)]
        return np.concatenate(parts, axis=-2)

    def average_over_bands(self, quantities: np.ndarray) -> np.ndarray:
        """Return quantities by band, or by wavelength without bands."""
        return quantities if self.band_weights is None else quantities @ self.band_weights.T


def make_variance_terms(
    target: FluxTarget, values: np.ndarray, rows: np.ndarray, contributes: np.ndarray
) -> VarianceTerms:
    """Return the terms of the variances of quantities by wavelength, or by band.

    The wavelengths of a band that use the same strata are correlated and form one term.

    Parameters
    ----------
    target : FluxTarget
    values : float, shape (N_BATCHES, quantities, node rows)
        Weighted contributions of node rows by batch, see `splits.simulation.tally.Tally`.
    rows : int, shape (node rows,)
        Wavelengths.
    contributes : bool, shape (strata, node rows)
        Where the rays of a stratum contribute.
    """
    if target.band_weights is None:
        return VarianceTerms(values.var(axis=0, ddof=1) / N_BATCHES, rows, contributes)
    n_bands = len(target.band_weights)
    patterns, pattern = np.unique(contributes, axis=1, return_inverse=True)
    by_pattern = [
        values[..., same] @ target.band_weights[:, rows[same]].T
        for same in (pattern.ravel() == number for number in range(patterns.shape[1]))
    ]
    variances = np.stack(by_pattern, axis=2).var(axis=0, ddof=1) / N_BATCHES
    return VarianceTerms(
        variances.reshape(len(variances), -1),
        np.tile(np.arange(n_bands), patterns.shape[1]),
        np.repeat(patterns, n_bands, axis=1),
    )


def allocate_flux_rays(
    target: FluxTarget,
    strata: Sequence[Stratum],
    values: np.ndarray,
    rows: np.ndarray,
    contributes: np.ndarray,
    max_variance: np.ndarray,
) -> np.ndarray:
    """Return the rays per stratum with which variances reach their limits at the least cost.

    Parameters
    ----------
    target : FluxTarget
    strata : sequence of Stratum
    values, rows, contributes
        See `make_variance_terms`.
    max_variance : float, shape (quantities, columns)
        Largest variances, by wavelength or by band.
    """
    n_rays = np.array([stratum.n_rays for stratum in strata], dtype=float)
    terms = make_variance_terms(target, values, rows, contributes)
    if target.band_weights is not None:
        # Terms of one node use the same rays and are correlated.
        total = compute_batch_stderr(values @ target.band_weights[:, rows].T) ** 2
        summed = terms.sum_columns(terms.variances)
        has_scatter = (summed > 0) & (total > 0)
        max_variance = max_variance * np.divide(
            summed, total, out=np.ones_like(summed), where=has_scatter
        )
    variances = terms.variances * (n_rays @ terms.contributes) / max_variance[:, terms.columns]
    # Rows without scatter need almost no rays.
    terms = terms._replace(variances=np.maximum(variances, _MIN_RELATIVE_VARIANCE))
    allocated = allocate_rays(terms, strata)
    return np.where(allocated > n_rays, np.maximum(allocated, MIN_ROUND_GROWTH * n_rays), n_rays)


# --------------------------------------------------------------------------------------------------
# Tally of radiative fluxes at planes in a medium, by batch.

FLUX_RAYS_PER_CHUNK = 32
"""Rays whose weights are added up together: few, so that a first round of all batches is short."""
IRRADIANCE_ROUNDING = 1e-6
"""Rounding of light absorbed between two planes, relative to the light incident on them: weights
have single precision."""
MAX_TALLY_VALUES = 100_000_000
"""Largest number of sums by batch, layer, material and wavelength; a run takes three times their
memory."""
MIN_SCATTER_FRACTION = 0.1
"""Fraction of the requested variance that is always available for statistical scatter."""


class FluxEstimate(NamedTuple):
    """Batch means at the requested depths, and between them.

    Attributes
    ----------
    quantities : float, shape (N_BATCHES, 2 depths + intervals, wavelengths)
        Downward and then upward irradiances, relative to the incident irradiance, and absorptances:
        differences of the net irradiances at the planes of an interval.
    material_absorptance : float, shape (N_BATCHES, intervals, materials, wavelengths)
        From the lengths in each material.
    path_length : float, shape (N_BATCHES, intervals, wavelengths)
        Metres; of a semi-infinite interval, down to the end of tracing.  Where light is absorbed,
        it is the absorptance times the path per absorbed light.
    """

    quantities: np.ndarray
    material_absorptance: np.ndarray
    path_length: np.ndarray

    @property
    def n_depths(self) -> int:
        """Number of depths of irradiances."""
        return (self.quantities.shape[1] - self.path_length.shape[1]) // 2

    def split_quantities(self, values: np.ndarray) -> list[np.ndarray]:
        """Return the parts of values by quantity: irradiances down, those up, absorptances."""
        return np.split(values, [self.n_depths, 2 * self.n_depths], axis=-2)

    def select_wavelengths(self, wavelengths: slice) -> FluxEstimate:
        """Return the estimate at some wavelengths."""
        return FluxEstimate(*(array[..., wavelengths] for array in self))


class FluxResult(NamedTuple):
    """Estimate with its systematic errors.

    Attributes
    ----------
    estimate : FluxEstimate
    perturbed_estimate : FluxEstimate or None
        Estimate with a more absorbing substrate below a truncation depth, see `TracedMedium`.
    systematic_error : float, shape (quantities, wavelengths)
        Errors of quantities other than the scatter of batches.
    irreducible_error : float, shape (quantities, wavelengths)
        The part of it that more rays do not reduce: of interpolation, and of truncation.
    interpolation_bound : float, shape (wavelengths,)
        See `bound_flux_interpolation_error`.
    unsampled_light : float, shape (intervals, wavelengths)
        See `bound_unsampled_light`.
    """

    estimate: FluxEstimate
    perturbed_estimate: FluxEstimate | None
    systematic_error: np.ndarray
    irreducible_error: np.ndarray
    interpolation_bound: np.ndarray
    unsampled_light: np.ndarray


class FluxTally(ExitTally):
    """Tally of light that crosses the boundaries of all layers, and of paths between them.

    Parameters
    ----------
    nodes : IndexNodes
    traced_medium : TracedMedium
    scene : Scene
        Of the medium, with its planes.
    target : FluxTarget
        Quantities to which the requested error applies.

    Raises
    ------
    ValueError
        If the sums do not fit into memory.

    Attributes
    ----------
    irradiance_sums : float, shape (N_BATCHES, 2, boundaries, node rows)
        Of light that crosses a boundary, downwards and upwards.
    absorptance_sums : float, shape (N_BATCHES, layers, materials, node rows)
    path_length_sums : float, shape (N_BATCHES, layers, node rows)
        Metres.
    """

    first_stream = 8_000_000
    rays_per_chunk = FLUX_RAYS_PER_CHUNK
    rays_per_round = pilot_rays = FLUX_RAYS_PER_CHUNK * N_BATCHES
    shares_kernel = True

    def __init__(
        self, nodes: IndexNodes, traced_medium: TracedMedium, scene: Scene, target: FluxTarget
    ) -> None:
        absorption = traced_medium.constants.absorption
        super().__init__(nodes, absorption, compute_absorption_per_mfp(scene, absorption))
        self.traced_medium, self.target, self.scene = traced_medium, target, scene
        self.path_fractions = traced_medium.path_fractions
        # The boundary above a rough surface is above the depth 0.
        self.boundary_rows = np.append(
            0, np.searchsorted(-scene.layers.boundaries, traced_medium.planes_m[1:])
        )
        self.n_layers = len(scene.layers.boundaries) - 1
        n_rows, n_materials = len(self.rows), absorption.shape[1]
        self.values_per_row = self.n_layers * (3 + n_materials)
        n_values = N_BATCHES * self.values_per_row * n_rows
        if n_values > MAX_TALLY_VALUES:
            n_wavelengths = traced_medium.n_wavelengths
            max_wavelengths = max(1, n_wavelengths * MAX_TALLY_VALUES // n_values)
            raise invalid(
                "wavelength_nm", f"{n_wavelengths} wavelengths",
                f"at most {max_wavelengths} with these depths and layers",
                "use several calls",
            )  # fmt: skip
        self.irradiance_sums = np.zeros((N_BATCHES, 2, self.n_layers + 1, n_rows))
        self.absorptance_sums = np.zeros((N_BATCHES, self.n_layers, n_materials, n_rows))
        self.path_length_sums = np.zeros((N_BATCHES, self.n_layers, n_rows))
        self.add_strata_by_absorption(absorption, scene)

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> FluxSums:
        """Return the sums of a chunk of rays of a stratum."""
        ground_column = self.scene.ground_column
        return tally_flux(
            exits, crossings, stratum.absorption, self.path_fractions, self.n_layers, ground_column
        )

    def merge(self, stratum: Stratum, score: FluxSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        batch, rows = self.get_batch(stratum, N_BATCHES), stratum.node_rows
        self.irradiance_sums[batch][..., rows] += score.boundary_weight
        self.absorptance_sums[batch][..., rows] += score.absorbed
        self.path_length_sums[batch][..., rows] += score.path_length

    def estimate_node_rows(self) -> FluxEstimate:
        """Return the estimate of each node row at the planes.

        In a semi-infinite medium, the last boundary is the end of tracing, and the last interval
        continues below it.
        """
        planes, n_batch_rays = self.boundary_rows, self.count_rays() / N_BATCHES
        levels = self.irradiance_sums / n_batch_rays
        levels[:, 0, 0] = 1.0
        absorbed = self.absorptance_sums[:, : planes[-1]] / n_batch_rays
        path_length = self._estimate_path_lengths(levels)[:, : planes[-1]]
        irradiance = levels[:, :, planes]
        net = irradiance[:, DOWNWELLING] - irradiance[:, UPWELLING]
        absorptance = net[:, :-1] - net[:, 1:]
        by_material = np.add.reduceat(absorbed, planes[:-1], axis=1)
        path_length = np.add.reduceat(path_length, planes[:-1], axis=1)
        if self.traced_medium.semi_infinite:
            irradiance, absorptance[:, -1] = irradiance[:, :, :-1], net[:, -2]
            # Light that enters the rest is absorbed in proportion to the layer just above.
            last = absorbed[:, -1].mean(axis=0)
            total = last.sum(axis=0)
            fraction = np.divide(last, total, out=np.zeros_like(last), where=total > 0.0)
            by_material[:, -1] += fraction * net[:, -1, np.newaxis]
        quantities = np.concatenate(
            [irradiance[:, DOWNWELLING], irradiance[:, UPWELLING], absorptance], axis=1
        )
        return FluxEstimate(quantities, by_material, path_length)

    def _estimate_path_lengths(self, irradiance: np.ndarray) -> np.ndarray:
        """Return path lengths in each layer (m), shape (N_BATCHES, layers, node rows).

        A path between two planes counts with the weight at its end, which Russian roulette raised
        for few rays, and made 0 for most.  Where it did, path lengths scatter much more than the
        light absorbed according to the irradiances.  Otherwise both agree, except for rounding.

        Parameters
        ----------
        irradiance : float, shape (N_BATCHES, 2, boundaries, node rows)
        """
        n_batch_rays = self.count_rays() / N_BATCHES
        scored_path = self.path_length_sums / n_batch_rays
        scored = self.absorptance_sums.sum(axis=2) / n_batch_rays
        net = irradiance[:, DOWNWELLING] - irradiance[:, UPWELLING]
        absorbed = net[:, :-1] - net[:, 1:]
        incident = (irradiance[:, DOWNWELLING, :-1] + irradiance[:, UPWELLING, 1:]).mean(axis=0)
        is_rounding = np.abs((absorbed - scored).mean(axis=0)) <= IRRADIANCE_ROUNDING * incident
        absorbed = np.where(is_rounding, scored, absorbed)
        mean_scored, mean_path = scored.mean(axis=0), scored_path.mean(axis=0)
        # The path per absorbed light of each layer and node row.
        boundaries = self.scene.layers.boundaries
        middles = -0.5 * (boundaries[1:] + boundaries[:-1])
        layers = self.traced_medium.medium.scene_layers
        bottoms = np.cumsum([float(layer.depth_m) for layer in layers])
        owners = np.searchsorted(bottoms[:-1], middles)[:, np.newaxis]
        columns = self.rows % self.traced_medium.n_wavelengths
        path_ratio = self.traced_medium.path_ratio
        ratio, by_rays = path_ratio.value[owners, columns], path_ratio.by_rays[owners, columns]
        has_ratio = by_rays & (mean_scored > 0.0)
        by_rays = has_ratio | np.isinf(ratio)
        scale = np.divide(
            absorbed.mean(axis=0), mean_scored, out=np.ones_like(ratio), where=has_ratio
        )
        ratio = np.divide(
            mean_path, mean_scored, out=np.where(by_rays, 0.0, ratio), where=has_ratio
        )
        # The ratio of the rays varies by batch to first order.
        deviation = np.where(by_rays, scale * (scored_path - ratio * scored), 0.0)
        return ratio * absorbed + deviation

    def evaluate(self, stop: StoppingRule) -> Evaluation:
        """Return the largest standard error.

        Tracing stops with "interpolation_bound" where the rest of the error is a bound that more
        rays do not reduce.
        """
        result = self._combine(self.estimate_node_rows())
        by_batch, systematic, irreducible = (
            self._average_target(result, values)
            for values in (
                result.estimate.quantities, result.systematic_error, result.irreducible_error
            )
        )  # fmt: skip
        stderr = np.hypot(compute_batch_stderr(by_batch), systematic)
        limits = stop.max_error * np.sqrt(self.target.variance_fractions)
        error = float((stderr / limits).max()) * stop.max_error
        has_scatter = stderr**2 - irreducible**2 >= MIN_SCATTER_FRACTION * limits**2
        is_bound = (irreducible > limits).any() and not has_scatter.any()
        return Evaluation(error, result, "interpolation_bound" if is_bound else "")

    def _average_target(self, result: FluxResult, values: np.ndarray) -> np.ndarray:
        """Return values of the quantities of the target, by band or by wavelength."""
        selected = self.target.select_quantities(values, result.estimate.n_depths)
        return self.target.average_over_bands(selected)

    def allocate_rays(self, stop: StoppingRule, evaluation: Evaluation) -> np.ndarray:
        """Return the rays with which the largest standard errors are the requested ones."""
        result, by_node = evaluation.estimate, self.estimate_node_rows()
        irreducible = self._average_target(result, result.irreducible_error)
        limits = stop.max_error * np.sqrt(self.target.variance_fractions)
        requested = self.rows < self.traced_medium.n_wavelengths
        values = self.target.select_quantities(by_node.quantities, by_node.n_depths)
        return allocate_flux_rays(
            self.target,
            self.strata,
            (self.weights * values)[..., requested],
            self.rows[requested],
            self.find_contributions()[:, requested],
            np.maximum(limits**2 - irreducible**2, MIN_SCATTER_FRACTION * limits**2),
        )

    def _combine(self, by_node: FluxEstimate) -> FluxResult:
        """Return the result of all wavelengths from the estimates of node rows."""
        n_wavelengths = self.traced_medium.n_wavelengths
        whole = FluxEstimate(*map(self.combine_nodes, by_node))
        estimate = whole.select_wavelengths(slice(n_wavelengths))
        single_ray_error = np.zeros(len(self.absorption))
        np.maximum.at(single_ray_error, self.rows, self.weights / self.count_rays())
        downward, upward, absorptance = estimate.split_quantities(estimate.quantities)
        unsampled = bound_unsampled_light(downward, single_ray_error[:n_wavelengths])
        unsampled_below = unsampled[1 : absorptance.shape[1] + 1]
        bound = self.nodes.interpolation_bound[:n_wavelengths]
        irreducible = bound_flux_interpolation_error(bound, estimate.quantities.mean(axis=0))
        perturbed = None
        if self.traced_medium.truncated:
            perturbed = whole.select_wavelengths(slice(n_wavelengths, None))
            difference = (estimate.quantities - perturbed.quantities).mean(axis=0)
            irreducible = np.hypot(irreducible, difference)
        unsampled_light = np.concatenate([unsampled[:-1], unsampled[:-1], unsampled_below])
        rare_event_error = estimate_rare_event_error(estimate.quantities, unsampled_light)
        rows = slice(estimate.n_depths, 2 * estimate.n_depths)
        unseen_reflection = estimate_unseen_reflection(downward, upward, unsampled[:-1])
        rare_event_error[rows] = np.maximum(rare_event_error[rows], unseen_reflection)
        systematic_error = np.hypot(irreducible, rare_event_error)
        return FluxResult(
            estimate, perturbed, systematic_error, irreducible, bound, unsampled_below
        )
