"""Tally of light scattered by single grains: means over grains, and their errors."""

from __future__ import annotations

import numpy as np

from splits.core.uncertainty import compute_leave_one_out_means
from splits.kernels.base.scene import Scene
from splits.kernels.grains.single_grain import (
    N_SCATTERING_BATCHES,
    IsolatedGrain,
    ScatteringSums,
    tally_single_scattering,
)
from splits.simulation.interpolation_bounds import bound_fraction_error
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.stratum import Stratum
from splits.simulation.tally import Tally

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
            "single_scattering_albedo_interpolation_bound": albedo_bound,
        }
        rows = {"legendre_moment": slice(orders), "asymmetry_parameter": 1}
        rows |= {name: orders + row for row, name in enumerate(WEIGHTED_MEANS)}
        tables = {"": ratio, "_stderr": error, "_interpolation_bound": error_bound}
        for name, row in rows.items():
            values |= {f"{name}{suffix}": table[row].T for suffix, table in tables.items()}
            values[f"{name}_jackknife"] = np.moveaxis(jackknife_ratios[:, row], 1, -1)
        return values
