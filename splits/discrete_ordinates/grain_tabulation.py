"""Tabulation of single scattering by the grains of snow, from paths through single grains."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.grain_table import MAX_ABSORPTION, Axis, GrainTable
from splits.kernels.base.scene import WET_PORE
from splits.media.snow import Snow
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import build_scene
from splits.simulation.single_scattering_tally import WEIGHTED_MEANS, SingleScatteringTally
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.stopping_rule import StoppingRule

WEAK_ABSORPTION = 1e-6
"""Absorption x at which the derivative of the moments at 0 is taken."""


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


def tabulate_grains(snow: Snow, axes: TableAxes, orders: int, rays: int, run: RunOptions) -> GrainTable:
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
    for row, saturation in enumerate(axes.saturation.nodes):
        wet = replace(snow, saturation=float(saturation))
        for source, is_wet in enumerate(pores):
            moments[:, row, source] = _trace_grains(wet, axes, is_wet, absorption, orders, rays, run)
    without, weak = moments[..., 0, :], moments[..., 1:, :]
    x = absorption[1:, np.newaxis]
    slopes = (without[..., np.newaxis, :] - weak) * (1.0 + x) / x
    stderr = np.zeros((axes.contrast.nodes.size, q.size))
    return GrainTable(axes.contrast, axes.saturation, axes.absorption, without, slopes, stderr)


def _trace_grains(
    snow: Snow, axes: TableAxes, is_wet: float, absorption: np.ndarray, orders: int, rays: int,
    run: RunOptions,
) -> np.ndarray:  # fmt: skip
    """Return the moments for light from one pore, shape (contrasts, pores, absorptions, orders)."""
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
    mean = tally.combine_nodes(tally.sums[0] / tally.count_rays())
    by_row = mean.T.reshape(len(index), absorption.size, -1)
    every, wet = by_row[..., :orders], by_row[..., orders + len(WEIGHTED_MEANS) - 1 :]
    if not snow.saturation:
        return every[:, np.newaxis]
    return np.stack([every, wet / snow.saturation], axis=1)
