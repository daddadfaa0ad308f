"""Tabulation of single scattering by the grains of snow, from paths through single grains."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from splits.core.uncertainty import compute_jackknife_stderr, compute_leave_one_out_means
from splits.discrete_ordinates.adding import Boundary, Element, compute_budget, make_isotropic
from splits.discrete_ordinates.grains import MAX_ABSORPTION, Axis, GrainTable
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.granular_stack import GranularStack
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab
from splits.kernels.records import N_SCATTERING_BATCHES
from splits.kernels.scene import WET_PORE
from splits.materials.library import load_dataset
from splits.media.snow import NATURAL_REFRACTIVE_INDICES, Snow
from splits.simulation.engine import simulate
from splits.simulation.grain_optics import (
    GRAIN_RAYS_PER_CHUNK,
    WEIGHTED_MEANS,
    SingleScatteringTally,
)
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import build_scene
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.strata import StoppingRule

WEAK_ABSORPTION = 1e-6
"""Absorption x at which the derivative of the moments at 0 is taken."""
CONTRAST_LIMITS = (0.16, 0.4)
"""Contrasts of ice with air, which are those of 200 to 2700 nm."""
WATER_WAVELENGTHS_NM = (200.0, 2701.0, 5.0)
"""First wavelength, end and step (nm) for the index of water that belongs to a contrast of ice."""
SATURATION_LIMITS, N_SATURATIONS = (0.02, 0.5), 7
N_ABSORPTIONS, N_ORDERS = 16, 33
N_RAYS = 16_000 * GRAIN_RAYS_PER_CHUNK
"""Rays per refractive index of dry grains, for an error of a reflectance below 0.0001."""
WET_RAYS_DIVISOR = 8
"""Rays of dry grains relative to those of wet ones, whose table has eight times as many rows."""
ERROR_STREAMS, ERROR_COSINES = 16, (1.0, 0.5, 0.1)
"""Streams, and cosines of beams, for the error of a reflectance."""


class TableAxes(NamedTuple):
    """Axes of a table of grains, and the water of wet pores.

    Attributes
    ----------
    contrast, saturation, absorption : Axis
        See `GrainTable`.
    water : float, shape (contrasts,)
        Refractive index of water for each contrast.
    """

    contrast: Axis
    saturation: Axis
    absorption: Axis
    water: np.ndarray

    @classmethod
    def from_water(cls, is_wet: bool, contrasts: int, absorptions: int) -> TableAxes:
        """Return the axes for dry or wet grains of natural snow, with numbers of nodes."""
        contrast = Axis.from_limits(*CONTRAST_LIMITS, contrasts)
        wavelengths = np.arange(*WATER_WAVELENGTHS_NM)
        ice, water = (
            load_dataset(material, NATURAL_REFRACTIVE_INDICES[material])(wavelengths).real
            for material in ("ice", "water")
        )
        order = np.argsort(ice)
        return cls(
            contrast,
            Axis.from_limits(*SATURATION_LIMITS, N_SATURATIONS) if is_wet else Axis(np.zeros(1)),
            Axis.from_limits(0.0, MAX_ABSORPTION / (1.0 + MAX_ABSORPTION), absorptions),
            np.interp(1.0 + contrast.nodes, ice[order], water[order]),
        )


def tabulate_grains(
    snow: Snow, axes: TableAxes, orders: int, rays: int, run: RunOptions
) -> GrainTable:
    """Return the table of the grains of snow, of which size and density have no effect.

    Parameters
    ----------
    snow : Snow
        Its grains and its interpretation are used.
    axes : TableAxes
    orders : int
        Number of Legendre moments.
    rays : int
        Rays per refractive index, saturation and pore, see
        `splits.simulation.grain_optics.GrainOpticsRequest`.
    run : RunOptions
    """
    q = axes.absorption.nodes
    absorption = np.concatenate([[0.0, WEAK_ABSORPTION], q[1:] / (1.0 - q[1:])])
    pores = (0.0, 1.0) if axes.saturation.nodes.any() else (0.0,)
    shape = (axes.contrast.nodes.size, axes.saturation.nodes.size, len(pores), len(pores))
    moments = np.empty((*shape, absorption.size, orders))
    stderr = np.zeros((axes.contrast.nodes.size, q.size))
    for row, saturation in enumerate(axes.saturation.nodes):
        wet = replace(snow, saturation=float(saturation))
        for source, is_wet in enumerate(pores):
            tally = _trace_grains(wet, axes, is_wet, absorption, orders, rays, run)
            mean = tally.combine_nodes(tally.sums[0] / tally.count_rays())
            by_row = mean.T.reshape(axes.contrast.nodes.size, -1, len(mean))
            moments[:, row, source, 0] = by_row[..., :orders]
            if saturation:
                into_wet = by_row[..., orders + len(WEIGHTED_MEANS) - 1 :]
                moments[:, row, source, 1] = into_wet / wet.saturation
            stderr = np.maximum(stderr, _compute_reflectance_error(tally, axes, orders)[:, 1:])
    without, weak = moments[..., 0, :], moments[..., 1:, :]
    x = absorption[1:, np.newaxis]
    slopes = (without[..., np.newaxis, :] - weak) * (1.0 + x) / x
    return GrainTable(*axes[:3], without, slopes, stderr, axes.water)


def _trace_grains(
    snow: Snow, axes: TableAxes, is_wet: float, absorption: np.ndarray, orders: int, rays: int,
    run: RunOptions,
) -> SingleScatteringTally:  # fmt: skip
    """Return the tally of light from dry or wet pores; rows are contrasts times absorptions."""
    materials = snow.list_materials()
    index = np.ones((axes.contrast.nodes.size, len(materials)), dtype=complex)
    index[:, WET_PORE] = axes.water
    index[:, -1] = 1.0 + axes.contrast.nodes
    per_metre = np.zeros((len(index) * absorption.size, len(materials)))
    per_metre[:, -1] = np.tile(absorption * snow.attenuation_per_m, len(index))
    weights = np.repeat(np.eye(len(index)), absorption.size, axis=1)
    nodes = IndexNodes(index, weights, np.zeros(len(per_metre)))
    fractions = np.full(len(index), is_wet)
    n_wet_orders = orders if snow.saturation else 1
    tally = SingleScatteringTally(nodes, per_metre, fractions, orders, rays, n_wet_orders)
    stop = StoppingRule(0.0, rays * len(index), fixed=True)
    simulate(build_scene(snow, 0.0, False), tally, stop, run)
    return tally


def _compute_reflectance_error(
    tally: SingleScatteringTally, axes: TableAxes, orders: int
) -> np.ndarray:
    """Return the jackknife error of the reflectance of a half-space of grains.

    It is the largest of that under diffuse light and under beams, shape (contrasts, absorptions).
    """
    scale = N_SCATTERING_BATCHES / tally.count_rays()
    batches = tally.combine_nodes(tally.batch_sums[:, :orders] * scale)
    means = np.moveaxis(compute_leave_one_out_means(batches), 1, -1)
    albedo = np.minimum(means[..., 0], 1.0)
    optics = LayerOptics.from_albedo(
        np.full(albedo.shape, np.inf), albedo, means / means[..., :1]
    ).truncate(ERROR_STREAMS)
    streams, cosines = Streams.from_number(ERROR_STREAMS), np.array(ERROR_COSINES)
    isotropic = make_isotropic(optics, streams, cosines.size)
    slab = solve_slab(optics, streams, cosines[np.newaxis])
    face = Boundary.make_transparent(streams.cosines.size, cosines.size)
    budget = compute_budget(
        [Element.from_slab(slab, isotropic)], (isotropic, isotropic), (face, face),
        np.zeros(albedo.shape), streams.cosines.size,
    )  # fmt: skip
    error = compute_jackknife_stderr(budget.reflectance).max(axis=-1)
    return error.reshape(axes.contrast.nodes.size, -1)


def compute_saturation_error(table: GrainTable) -> np.ndarray:
    """Return the error of a reflectance between the saturations of a table of wet grains.

    It is the change of the reflectance of a half-space, as in `_compute_reflectance_error`, without
    the polynomial of the highest degree in the saturation, shape (contrasts, absorptions).
    """
    n, q = table.saturation.nodes.size, table.absorption.nodes
    signs = (-1.0) ** np.arange(n)
    ends_halved = np.where(np.arange(n) % (n - 1) == 0, 0.5, 1.0)

    def lower_degree(values: np.ndarray) -> np.ndarray:
        # At the nodes, this polynomial of Chebyshev is 1 and −1 in turn.
        by_node = np.moveaxis(values, 1, -1)
        highest = (by_node @ (ends_halved * signs))[..., np.newaxis] / (n - 1)
        return np.moveaxis(by_node - highest * signs, -1, 1)

    lower = table._replace(moments=lower_degree(table.moments), slopes=lower_degree(table.slopes))
    contrast, water = (np.repeat(one, q.size) for one in (table.contrast.nodes, table.water))
    absorption = np.tile(q / (1.0 - q), table.contrast.nodes.size)
    half_space = GranularLayer(
        np.asarray(np.inf), np.asarray(1.0), np.asarray(0.0), contrast, water, absorption,
        np.zeros((absorption.size, 2)), table,
    )  # fmt: skip
    error = np.zeros(absorption.size)
    for saturation in table.saturation.nodes:
        wet = half_space._replace(wet_fraction=np.asarray(saturation))
        complete, without = (
            GranularStack([wet._replace(grains=grains)], np.zeros(absorption.size))
            .solve(np.array(ERROR_COSINES), ERROR_STREAMS)
            .reflectance
            for grains in (table, lower)
        )
        error = np.maximum(error, np.abs(complete - without).max(axis=-1))
    return error.reshape(table.contrast.nodes.size, -1)


def save_natural_grains(folder: Path, rays: int, run: RunOptions) -> None:
    """Write the tables of dry and of wet grains of natural snow into a folder.

    Parameters
    ----------
    folder : pathlib.Path
    rays : int
        Rays per refractive index of dry grains.
    run : RunOptions
    """
    snow = Snow.natural(specific_surface_area_m2_kg=20.0)
    for name, n_contrasts, n_rays in (("dry", 8, rays), ("wet", 7, rays // WET_RAYS_DIVISOR)):
        axes = TableAxes.from_water(name == "wet", n_contrasts, N_ABSORPTIONS)
        table = tabulate_grains(snow, axes, N_ORDERS, n_rays, run)
        if table.n_states > 1:
            between = compute_saturation_error(table)
            table = table._replace(stderr=np.hypot(table.stderr, between))
        dataset = table.to_dataset()
        compact = {"dtype": "f4", "zlib": True, "complevel": 9}
        encoding = {variable: compact for variable in dataset.data_vars}
        dataset.to_netcdf(folder / f"natural_grains_{name}.nc", encoding=encoding)


if __name__ == "__main__":
    # Called by the workflow with a folder and a number of threads.
    save_natural_grains(Path(sys.argv[1]), N_RAYS, RunOptions.start(1, int(sys.argv[2])))
