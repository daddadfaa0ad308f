"""Single-scattering properties of the grains of a scene, from rays that hit one grain each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.core.uncertainty import compute_batch_stderr, compute_leave_one_out_means
from splits.kernels.records import (
    N_ELEMENTS,
    N_MATRIX_BATCHES,
    N_SCATTERING_BATCHES,
    IsolatedGrain,
    ScatteringSums,
)
from splits.kernels.scene import DRY_PORE, WET_PORE, Scene
from splits.media.medium import GranularMedium
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import IncidentPolarization, OpticalConstants, build_scene
from splits.simulation.spectral_nodes import (
    INTERPOLATION_FACTOR,
    IndexNodes,
    bound_fraction_error,
    choose_nodes,
    make_nodes,
)
from splits.simulation.strata import StoppingRule, Stratum
from splits.simulation.tally import Tally

# --------------------------------------------------------------------------------------------------
# Tally of light scattered by single grains: means over grains, and their errors.

GRAIN_RAYS_PER_CHUNK = 2048
"""Rays per chunk, the unit of parallel work."""
MOMENT_SLOPE_RATIO = 2.0
"""Ratio of the largest slope of a Legendre moment to that of a reflectance: a forward lobe as wide
as the contrast c has χ_l ~ exp(−c² l²/2), and |dχ/d(ln c)| up to 2/e."""
WEIGHTED_MEANS = (
    "displacement_along_incident",
    "displacement_along_exit",
    "mean_square_displacement",
    "wet_fraction",
)
"""Other means weighted by scattered light, in the order of `tally_single_scattering`."""


class SingleScatteringTally(Tally):
    """Tally of the directions and displacements of scattered rays, see `Tally`.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    wet_fractions : float, shape (nodes,)
        Fraction of the light in pore space that is in wet pores, at each index node.
    n_orders : int
        Number of Legendre moments.
    n_rays : int
        Rays per node: a multiple of `GRAIN_RAYS_PER_CHUNK`, or a smaller one of
        `N_SCATTERING_BATCHES`.
    n_wet_orders : int
        Number of Legendre moments of the light that enters a wet pore, at most `n_orders`.

    Attributes
    ----------
    sums : float, shape (3, scores, node rows)
    batch_sums : float, shape (N_SCATTERING_BATCHES, scores, node rows)
        See `splits.kernels.grains.single_grain.tally_single_scattering`.
    """

    first_stream = 2_000_000

    def __init__(
        self,
        nodes: IndexNodes,
        absorption: np.ndarray,
        wet_fractions: np.ndarray,
        n_orders: int,
        n_rays: int,
        n_wet_orders: int = 1,
    ) -> None:
        super().__init__(nodes, absorption)
        self.wet_fractions, self.n_orders = wet_fractions, n_orders
        self.n_wet_orders = n_wet_orders
        self.rays_per_chunk = self.rays_per_round = min(n_rays, GRAIN_RAYS_PER_CHUNK)
        n_scores = n_orders + len(WEIGHTED_MEANS) - 1 + n_wet_orders
        self.sums = np.zeros((3, n_scores, len(self.rows)))
        self.batch_sums = np.zeros((N_SCATTERING_BATCHES, *self.sums.shape[1:]))
        self.values_per_row = (3 + N_SCATTERING_BATCHES) * self.sums.shape[1]
        self.add_strata()

    def trace_chunk(
        self, seed: int, scene: Scene, stratum: Stratum, first_ray: int
    ) -> tuple[ScatteringSums, int]:
        """Return the sums of a chunk of rays that hit one grain each, and their number."""
        from splits.kernels.grains.single_grain import tally_single_scattering

        wet_fraction = self.wet_fractions[self.node_of_row[stratum.node_rows.start]]
        grain = IsolatedGrain(wet_fraction, scene, stratum.optics)
        work = np.array([stratum.stream, first_ray, self.rays_per_chunk, stratum.max_order])
        orders = self.n_orders, self.n_wet_orders
        sums = tally_single_scattering(seed, work, orders, grain, stratum.absorption)
        return sums, self.rays_per_chunk

    def merge(self, stratum: Stratum, score: ScatteringSums) -> None:
        """Add the sums of the next chunk of a stratum."""
        self.sums[..., stratum.node_rows] += score.sums
        self.batch_sums[..., stratum.node_rows] += score.batches

    def compute_grain_means(self) -> dict[str, np.ndarray]:
        """Return means over grains and their standard errors, by name.

        All but the albedo are ratios of means, <w x>/<w>; the error is that of w (x − <w x>/<w>),
        to first order.
        """
        n_rays, bound, orders = self.count_rays(), self.nodes.interpolation_bound, self.n_orders
        mean_sum, product_sum, square_sum = self.sums / n_rays
        mean = self.combine_nodes(mean_sum)
        batch_means = self.combine_nodes(self.batch_sums * (N_SCATTERING_BATCHES / n_rays))
        albedo = mean[0]
        # Where nothing is scattered, the moments are 0 instead of NaN.
        tiny = np.finfo(float).tiny
        scattered = np.maximum(albedo, tiny)
        ratio = mean / scattered
        node_ratio = ratio[:, self.rows]
        residual = square_sum - 2.0 * node_ratio * product_sum + node_ratio**2 * square_sum[0]
        residual -= (mean_sum - node_ratio * mean_sum[0]) ** 2
        ratio_variance = self.combine_nodes(np.maximum(residual, 0.0) / n_rays, power=2)
        albedo_variance = self.combine_nodes(
            np.maximum(square_sum[0] - mean_sum[0] ** 2, 0.0) / n_rays, power=2
        )
        error_bound = MOMENT_SLOPE_RATIO * bound * np.abs(ratio)
        # 0 where a moment cannot depend on the refractive index.
        error_bound[:orders] = MOMENT_SLOPE_RATIO * bound_fraction_error(bound, ratio[:orders])
        error = np.sqrt(ratio_variance / scattered**2 + error_bound**2)
        jackknife_means = compute_leave_one_out_means(batch_means)
        jackknife_ratios = jackknife_means / np.maximum(jackknife_means[:, :1], tiny)
        albedo_bound = bound_fraction_error(bound, albedo)
        values = {
            "single_scattering_albedo": albedo,
            "single_scattering_albedo_stderr": np.sqrt(albedo_variance + albedo_bound**2),
            "single_scattering_albedo_jackknife": jackknife_means[:, 0],
            "single_scattering_albedo_interpolation_error_bound": albedo_bound,
        }
        rows = {"legendre_moment": slice(orders), "asymmetry_parameter": 1}
        rows |= {name: orders + row for row, name in enumerate(WEIGHTED_MEANS)}
        tables = {"": ratio, "_stderr": error, "_interpolation_error_bound": error_bound}
        for name, row in rows.items():
            values |= {f"{name}{suffix}": table[row].T for suffix, table in tables.items()}
            values[f"{name}_jackknife"] = np.moveaxis(jackknife_ratios[:, row], 1, -1)
        return values


# --------------------------------------------------------------------------------------------------
# Tally of the scattering matrix of single grains, and its errors.


class ScatteringMatrixTally(Tally):
    """Tally of polarized rays that hit one grain each, see `Tally`.

    Parameters
    ----------
    nodes, absorption
        See `Tally`.
    wet_fractions : float, shape (nodes,)
        Fraction of the light in pore space that is in wet pores, at each index node.
    angle_deg : float, shape (angles,)
        Scattering angles (degrees), rising from 0 to 180.

    Attributes
    ----------
    sums : float, shape (batches, 6, node rows, angles)
        See `splits.kernels.grains.single_grain.tally_scattering_matrix`; rising cosines.
    """

    first_stream = 3_000_000
    rays_per_round = GRAIN_RAYS_PER_CHUNK

    def __init__(
        self,
        nodes: IndexNodes,
        absorption: np.ndarray,
        wet_fractions: np.ndarray,
        angle_deg: np.ndarray,
    ) -> None:
        super().__init__(nodes, absorption)
        self.wet_fractions = wet_fractions
        self.cosines = np.cos(np.radians(angle_deg[::-1]))
        self.cosines[[0, -1]] = -1.0, 1.0
        shape = (N_MATRIX_BATCHES, N_ELEMENTS, len(self.rows), angle_deg.size)
        self.sums = np.zeros(shape)
        self.values_per_row = N_MATRIX_BATCHES * N_ELEMENTS * angle_deg.size
        self.add_strata()

    def trace_chunk(
        self, seed: int, scene: Scene, stratum: Stratum, first_ray: int
    ) -> tuple[np.ndarray, int]:
        """Return the sums of a chunk of rays that hit one grain each, and their number."""
        from splits.kernels.grains.single_grain import tally_scattering_matrix

        wet_fraction = self.wet_fractions[self.node_of_row[stratum.node_rows.start]]
        grain = IsolatedGrain(wet_fraction, scene, stratum.optics)
        work = np.array([stratum.stream, first_ray, GRAIN_RAYS_PER_CHUNK, stratum.max_order])
        sums = tally_scattering_matrix(seed, work, self.cosines, grain, stratum.absorption)
        return sums, GRAIN_RAYS_PER_CHUNK

    def merge(self, stratum: Stratum, score: np.ndarray) -> None:
        """Add the sums of the next chunk of a stratum."""
        self.sums[:, :, stratum.node_rows] += score

    def estimate_matrix(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrix, with errors from the scatter of batches and of interpolation.

        See `compute_grain_matrix`.
        """
        width = np.diff(self.cosines)
        # Integral over all directions of the linear function of the cosine that is 1 at an angle.
        weight = 0.5 * (np.append(width, 0.0) + np.append(0.0, width))
        by_batch = np.moveaxis(self.sums, 2, -1) * (N_MATRIX_BATCHES / self.count_rays())
        batches = np.moveaxis(self.combine_nodes(by_batch), -1, 2)
        scattered = batches[:, 0].sum(axis=-1).mean(axis=0)
        scale = np.divide(2.0, scattered, out=np.zeros_like(scattered), where=scattered > 0.0)
        batches = (batches * scale[:, np.newaxis] / weight)[..., ::-1]
        mean = batches.mean(axis=0)
        bound = INTERPOLATION_FACTOR * self.nodes.interpolation_bound[:, np.newaxis]
        stderr = np.hypot(compute_batch_stderr(batches), bound * np.abs(mean))
        return mean, stderr


# --------------------------------------------------------------------------------------------------
# Single-scattering properties of the grains of a scene, from rays that hit one grain each.

INTERPOLATION_TOLERANCE = 0.0005
"""Interpolation error allowed, as for a reflectance (see `splits.simulation.spectral_nodes`)."""


class GrainOpticsRequest(NamedTuple):
    """Request for single-scattering properties, see `splits.single_scattering`.

    The number of rays is a multiple of `GRAIN_RAYS_PER_CHUNK`, or a smaller
    one of `N_SCATTERING_BATCHES`.
    """

    max_moment: int
    n_rays: int
    wet_pores: str
    run: RunOptions


def compute_grain_optics(
    medium: GranularMedium,
    scene: Scene,
    constants: OpticalConstants,
    request: GrainOpticsRequest,
    nodes: IndexNodes,
) -> dict[str, np.ndarray]:
    """Return the single-scattering properties of a scene's grains by name, see `single_scattering`.

    Parameters
    ----------
    medium : GranularMedium
    scene : Scene
        Scene of the medium, possibly with a subset of its grain types.
    constants : OpticalConstants
        Of its materials, at every wavelength.
    request : GrainOpticsRequest
    nodes : IndexNodes
        Of the medium at these wavelengths.
    """
    index, absorption = constants
    wet_fraction = _compute_wet_fraction(medium.wet_fraction, index, request.wet_pores)
    node_wet_fractions = _compute_wet_fraction(medium.wet_fraction, nodes.index, request.wet_pores)
    n_orders = request.max_moment + 1
    tally = SingleScatteringTally(nodes, absorption, node_wet_fractions, n_orders, request.n_rays)
    stop = StoppingRule(0.0, request.n_rays * len(nodes.index), fixed=True)
    simulate(scene, tally, stop, request.run)
    values = tally.compute_grain_means()
    dry, wet = absorption[:, DRY_PORE], absorption[:, WET_PORE]
    grain_extinction = medium.extinction_per_m
    values["extinction"] = grain_extinction + ((1.0 - wet_fraction) * dry + wet_fraction * wet)
    for name in list(values):
        if name.startswith("single_scattering_albedo"):
            values[name] *= grain_extinction / values["extinction"]
    return values


def compute_grain_matrix(
    medium: GranularMedium,
    constants: OpticalConstants,
    request: GrainOpticsRequest,
    nodes: IndexNodes,
    angle_deg: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the scattering matrix of the grains of a medium with errors.

    Returns
    -------
    elements, stderr : float, shape (6, wavelengths, angles)
        P11, P12, P33, P34, P22 and P44, see `single_scattering`; the mean of P11 over all
        directions is 1, or 0 where nothing is scattered.
    """
    wet_fractions = _compute_wet_fraction(medium.wet_fraction, nodes.index, request.wet_pores)
    tally = ScatteringMatrixTally(nodes, constants.absorption, wet_fractions, angle_deg)
    stop = StoppingRule(0.0, request.n_rays * len(nodes.index), fixed=True)
    simulate(build_scene(medium, 0.0, False, IncidentPolarization()), tally, stop, request.run)
    return tally.estimate_matrix()


def estimate_pilot_optics(
    medium: GranularMedium, constants: OpticalConstants, request: GrainOpticsRequest
) -> xr.Dataset:
    """Return an approximation of the result of `pool_optics_by_type` at a fraction of its cost.

    All grain types are sampled together, and all properties but absorption are those of the row
    with the least absorption, at which light penetrates deepest.
    """
    least_absorbing = int(constants.absorption.max(axis=1).argmin())
    nodes = make_nodes(constants.indices, medium.list_interfaces(), [least_absorbing])
    scene = build_scene(medium, 0.0, False)
    values = compute_grain_optics(medium, scene, constants, request, nodes)
    names = ("single_scattering_albedo", "asymmetry_parameter", "extinction", *WEIGHTED_MEANS)
    rows = len(constants.indices)
    variables = {name: ("row", np.broadcast_to(values[name], rows)) for name in names}
    return xr.Dataset(variables)


def pool_optics_by_type(
    medium: GranularMedium, constants: OpticalConstants, request: GrainOpticsRequest
) -> xr.Dataset:
    """Return means over grains from the same number of rays for each type, however rare it is.

    A few rays over all types would undersample rare ones and their absorption.

    Parameters
    ----------
    medium : GranularMedium
    constants : OpticalConstants
        Of its materials, one row for each row of the result.
    request : GrainOpticsRequest

    Returns
    -------
    xarray.Dataset
        Over ``row``, without errors: ``single_scattering_albedo``, ``asymmetry_parameter``,
        `WEIGHTED_MEANS`, ``extinction``.
    """
    scene = build_scene(medium, 0.0, False)
    fractions = np.diff(scene.layers.type_cdf[0], prepend=0.0)
    names = ("asymmetry_parameter", *WEIGHTED_MEANS)
    rows = len(constants.indices)
    nodes = choose_nodes(constants.indices, medium.list_interfaces(), INTERPOLATION_TOLERANCE)
    scattered, absorbed, extinction = np.zeros((3, rows))
    sums = {name: np.zeros(rows) for name in names}
    for grain_type in np.flatnonzero(fractions > 0.0):
        single_type_cdf = (np.arange(fractions.size) >= grain_type).astype(float)[np.newaxis]
        single_type_scene = scene._replace(layers=scene.layers._replace(type_cdf=single_type_cdf))
        values = compute_grain_optics(medium, single_type_scene, constants, request, nodes)
        weight = fractions[grain_type] * values["single_scattering_albedo"]
        scattered, extinction = scattered + weight, values["extinction"]
        # Summed separately, so that a lossless medium has exactly no loss.
        absorbed += fractions[grain_type] * (1.0 - values["single_scattering_albedo"])
        for name in names:
            sums[name] += weight * values[name]
    denominator = np.maximum(scattered, np.finfo(float).tiny)
    means = {name: ("row", weighted_sum / denominator) for name, weighted_sum in sums.items()}
    means["single_scattering_albedo"] = ("row", 1.0 - absorbed)
    means["extinction"] = ("row", extinction)
    return xr.Dataset(means)


def _compute_wet_fraction(wet_fraction: float, index: np.ndarray, wet_pores: str) -> np.ndarray:
    """Return the fraction of the light in pore space that is in wet pores, by row of indices."""
    if wet_pores == "saturation":
        return np.full(len(index), float(wet_fraction))
    dry = (1.0 - wet_fraction) * index[:, DRY_PORE].real ** 2
    wet = wet_fraction * index[:, WET_PORE].real ** 2
    return wet / (wet + dry)
