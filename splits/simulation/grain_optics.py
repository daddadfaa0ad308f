"""Single-scattering properties of the grains of a scene, from rays that hit one grain each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.kernels.base.scene import DRY_PORE, WET_PORE, Scene
from splits.media.medium import GranularMedium
from splits.simulation.engine import simulate
from splits.simulation.incident_light import IncidentPolarization
from splits.simulation.run_options import RunOptions
from splits.simulation.scattering_matrix_tally import MatrixEstimate, ScatteringMatrixTally
from splits.simulation.scene import OpticalConstants, build_scene
from splits.simulation.single_scattering_tally import (
    WEIGHTED_MEANS,
    SingleScatteringTally,
)
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes, make_nodes
from splits.simulation.stopping_rule import StoppingRule

INTERPOLATION_TOLERANCE = 0.0005
"""Interpolation error allowed, as for a reflectance (see `splits.simulation.spectral_nodes`)."""
WET_PORE_MODELS = ("saturation", "equilibrium")


class GrainOpticsRequest(NamedTuple):
    """Request for single-scattering properties, see `splits.instruments.single_scattering`.

    The number of rays is a multiple of `single_scattering_tally.GRAIN_RAYS_PER_CHUNK`, or a smaller
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
) -> MatrixEstimate:
    """Return the scattering matrix of the grains of a medium, see `single_scattering`."""
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
