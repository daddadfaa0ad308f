"""What single grains of a scene do to light: rays that meet one grain each, and means over them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.core.uncertainty import compute_leave_one_out_means
from splits.kernels.grains.scene import DRY_PORE, WET_PORE, Optics, Scene, make_bounding_optics
from splits.kernels.grains.single_grain import (
    N_SCATTERING_BATCHES,
    IsolatedGrain,
    tally_single_scattering,
)
from splits.media.medium import GranularMedium, compute_absorption
from splits.simulation import random_streams
from splits.simulation.scene import OpticalConstants, build_scene
from splits.simulation.spectral_nodes import IndexNodes, choose_nodes, make_nodes
from splits.simulation.threads import DaemonThreadPool

GRAIN_RAYS_PER_CHUNK = 2048
"""Rays per batch: the grain of parallel work."""

INTERPOLATION_TOLERANCE = 0.0005
"""Interpolation error allowed, as for a reflectance (see `splits.simulation.spectral_nodes`)."""

MOMENT_SLOPE_RATIO = 2.0
"""How much steeper a Legendre moment may be in the contrast than a reflectance: a forward lobe as
wide as the contrast c has χ_l ~ exp(−c² l²/2), and |dχ/d(ln c)| up to 2/e."""


WET_PORE_MODELS = ("saturation", "equilibrium")
WEIGHTED_MEANS = (
    "displacement_along_incident",
    "displacement_along_exit",
    "mean_square_displacement",
    "wet_fraction",
)
"""What else is a mean by weight of scattered light, in the order of `tally_single_scattering`."""


class GrainOpticsRequest(NamedTuple):
    """What is asked of grains, see `splits.instruments.single_scattering`.

    Rays are a multiple of `GRAIN_RAYS_PER_CHUNK`, or of `N_SCATTERING_BATCHES` and fewer.
    """

    max_moment: int
    n_rays: int
    seed: int
    threads: int
    wet_pores: str


@dataclass(frozen=True)
class _NodeTally:
    """Tallies of one node, per ray, for the wavelengths that draw on it.

    Attributes
    ----------
    wavelength_mask : bool, shape (wavelengths,)
    weight : float, shape (served,)
        Weight of this node in the wavelengths' means.
    sums : float, shape (3, orders + 4, served)
    batch_sums : float, shape (parts, orders + 4, served)
        See `splits.kernels.grains.single_grain.tally_single_scattering`.
    """

    wavelength_mask: np.ndarray
    weight: np.ndarray
    sums: np.ndarray
    batch_sums: np.ndarray


def compute_material_constants(medium: GranularMedium, wavelengths: np.ndarray) -> OpticalConstants:
    """Return what a medium's materials are to light at wavelengths (nm), without a ground."""
    index = medium.compute_refractive_indices(wavelengths)
    return OpticalConstants(index, compute_absorption(medium, index, wavelengths))


def compute_grain_optics(
    medium: GranularMedium,
    scene: Scene,
    constants: OpticalConstants,
    request: GrainOpticsRequest,
    nodes: IndexNodes,
) -> dict[str, np.ndarray]:
    """Return what a scene's grains do to light, by the names of `single_scattering`.

    Parameters
    ----------
    medium : GranularMedium
    scene : LayerScene
        Of the medium, perhaps of some of its grains only.
    constants : OpticalConstants
        Of its materials, at every wavelength.
    request : Plan
    nodes : IndexNodes
        Of the medium at these wavelengths.
    """
    index, absorption = constants
    wet = _compute_wet_fraction(medium.wet_fraction, index, request.wet_pores)
    at_nodes = _compute_wet_fraction(medium.wet_fraction, nodes.index, request.wet_pores)
    traced = _trace_nodes(scene, nodes, at_nodes, absorption, request)
    values = _estimate_means(
        traced, nodes.interpolation_bound, request.max_moment + 1, request.n_rays
    )
    pore = (1.0 - wet) * absorption[:, DRY_PORE] + wet * absorption[:, WET_PORE]
    grains = medium.make_grain_population().attenuation
    values["extinction"] = grains + pore
    for name in list(values):
        if name.startswith("single_scattering_albedo"):
            values[name] *= grains / values["extinction"]
    return values


def estimate_pilot_optics(
    medium: GranularMedium, constants: OpticalConstants, request: GrainOpticsRequest
) -> xr.Dataset:
    """Return about what `pool_optics_by_type` does, for a part of its time.

    All grains together, and everything but absorption as at one row: that of the least, at which
    light gets farthest.
    """
    clearest = int(constants.absorption.max(axis=1).argmin())
    nodes = make_nodes(constants.indices, medium.list_interfaces(), [clearest])
    scene = build_scene(medium, 0.0, False)
    values = compute_grain_optics(medium, scene, constants, request, nodes)
    names = ("single_scattering_albedo", "asymmetry_parameter", "extinction", *WEIGHTED_MEANS)
    rows = len(constants.indices)
    found = {name: ("row", np.broadcast_to(values[name], rows)) for name in names}
    return xr.Dataset(found)


def pool_optics_by_type(
    medium: GranularMedium, constants: OpticalConstants, request: GrainOpticsRequest
) -> xr.Dataset:
    """Return means over grains of which each type was met by so many rays, however rare it is.

    A few rays among all types would miss rare ones, and all that these absorb.

    Parameters
    ----------
    medium : GranularMedium
    constants : OpticalConstants
        Of its materials, at as many rows as are wanted.
    request : Plan

    Returns
    -------
    xarray.Dataset
        Over ``row``, without errors: ``single_scattering_albedo``, ``asymmetry_parameter``,
        `WEIGHTED_MEANS`, ``extinction``.
    """
    scene = build_scene(medium, 0.0, False)
    shares = np.diff(scene.layers.type_cdf[0], prepend=0.0)
    names = ("asymmetry_parameter", *WEIGHTED_MEANS)
    rows = len(constants.indices)
    nodes = choose_nodes(constants.indices, medium.list_interfaces(), INTERPOLATION_TOLERANCE)
    scattered, lost, extinction = np.zeros((3, rows))
    sums = {name: np.zeros(rows) for name in names}
    for kind in np.flatnonzero(shares > 0.0):
        only = (np.arange(shares.size) >= kind).astype(float)[np.newaxis]
        alone = scene._replace(layers=scene.layers._replace(type_cdf=only))
        values = compute_grain_optics(medium, alone, constants, request, nodes)
        weight = shares[kind] * values["single_scattering_albedo"]
        scattered, extinction = scattered + weight, values["extinction"]
        # Nothing lost is exactly that, whatever shares add up to.
        lost += shares[kind] * (1.0 - values["single_scattering_albedo"])
        for name in names:
            sums[name] += weight * values[name]
    least = np.maximum(scattered, np.finfo(float).tiny)
    means = {name: ("row", total / least) for name, total in sums.items()}
    means["single_scattering_albedo"] = ("row", 1.0 - lost)
    means["extinction"] = ("row", extinction)
    return xr.Dataset(means)


def _compute_wet_fraction(saturation: float, index: np.ndarray, wet_pores: str) -> np.ndarray:
    """Return the share of light in pore space that is in wet pores, one for each row of indices."""
    wet, dry = saturation, 1.0 - saturation
    if wet_pores == "saturation":
        return np.full(len(index), float(wet))
    square = index[:, [DRY_PORE, WET_PORE]].real ** 2
    return wet * square[:, 1] / (wet * square[:, 1] + dry * square[:, 0])


def _trace_nodes(
    scene: Scene,
    nodes: IndexNodes,
    wet_fractions: np.ndarray,
    absorption: np.ndarray,
    request: GrainOpticsRequest,
) -> list[_NodeTally]:
    """Trace so many rays at every node."""
    orders, rays, seed = request.max_moment + 1, request.n_rays, request.seed

    def run(job: tuple[int, int, Optics, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        node, first, optics, part = job
        work = np.array(
            [
                random_streams.SINGLE_SCATTERING + node,
                first,
                min(rays - first, GRAIN_RAYS_PER_CHUNK),
            ]
        )
        return tally_single_scattering(
            seed, work, orders, IsolatedGrain(wet_fractions[node], scene, optics), part
        )

    served = nodes.weights > 0.0
    rows = [absorption[some] for some in served]
    optics = [make_bounding_optics(m, part) for m, part in zip(nodes.index, rows, strict=True)]
    firsts = range(0, rays, GRAIN_RAYS_PER_CHUNK)
    jobs = [(i, first, optics[i], part) for i, part in enumerate(rows) for first in firsts]
    traced = []
    with DaemonThreadPool(request.threads) as pool:
        found = pool.map(run, jobs)
        for some, weight, part in zip(served, nodes.weights, rows, strict=True):
            sums = np.zeros((3, orders + len(WEIGHTED_MEANS), len(part)))
            parts = np.zeros((N_SCATTERING_BATCHES, *sums.shape[1:]))
            # In a fixed order, so that rounding does not depend on the threads.
            for one, other in itertools.islice(found, len(firsts)):
                sums += one
                parts += other
            # Parts per ray of theirs: their mean is that of all rays.
            traced.append(
                _NodeTally(some, weight[some], sums / rays, parts * (N_SCATTERING_BATCHES / rays))
            )
    return traced


def _estimate_means(
    node_tallies: list[_NodeTally], interpolation_bound: np.ndarray, n_orders: int, n_rays: int
) -> dict[str, np.ndarray]:
    """Return means over grains and their standard errors, by name.

    All but the albedo are ratios of means, <w x>/<w>; the error is that of w (x − <w x>/<w>), to
    first order.
    """
    mean = np.zeros((n_orders + len(WEIGHTED_MEANS), len(interpolation_bound)))
    parts = np.zeros((N_SCATTERING_BATCHES, *mean.shape))
    for node in node_tallies:
        mean[:, node.wavelength_mask] += node.weight * node.sums[0]
        parts[:, :, node.wavelength_mask] += node.weight * node.batch_sums
    albedo = mean[0]
    # Where nothing at all is scattered, the phase function has no meaning: 0, and no NaN.
    share = np.maximum(albedo, np.finfo(float).tiny)
    ratio = mean / share
    variance = np.zeros(len(interpolation_bound))
    spread = np.zeros(mean.shape)
    for node in node_tallies:
        first, mixed, square = node.sums
        chi = ratio[:, node.wavelength_mask]
        variance[node.wavelength_mask] += node.weight**2 * np.maximum(
            square[0] - first[0] ** 2, 0.0
        )
        residual = square - 2.0 * chi * mixed + chi**2 * square[0]
        residual -= (first - chi * first[0]) ** 2
        spread[:, node.wavelength_mask] += node.weight**2 * np.maximum(residual, 0.0)
    missed = MOMENT_SLOPE_RATIO * interpolation_bound * np.abs(ratio)
    missed[:n_orders] = (
        MOMENT_SLOPE_RATIO
        * interpolation_bound
        * np.clip(8.0 * np.abs(_bernoulli_variance(ratio[:n_orders])), 0.0, 1.0)
    )
    error = np.sqrt(spread / (n_rays * share**2) + missed**2)
    left_out = compute_leave_one_out_means(parts)
    ratios = left_out / np.maximum(left_out[:, :1], np.finfo(float).tiny)
    albedo_missed = interpolation_bound * np.clip(8.0 * _bernoulli_variance(albedo), 0.0, 1.0)
    found = {
        "single_scattering_albedo": albedo,
        "single_scattering_albedo_stderr": np.sqrt(variance / n_rays + albedo_missed**2),
        "single_scattering_albedo_jackknife": left_out[:, 0],
        "single_scattering_albedo_interpolation_bound": albedo_missed,
    }
    rows = {"legendre_moment": slice(n_orders), "asymmetry_parameter": 1}
    rows |= {name: n_orders + row for row, name in enumerate(WEIGHTED_MEANS)}
    for name, row in rows.items():
        for end, table in (("", ratio), ("_stderr", error), ("_interpolation_bound", missed)):
            found[f"{name}{end}"] = table[row].T
        found[f"{name}_jackknife"] = np.moveaxis(ratios[:, row], 1, -1)
    return found


def _bernoulli_variance(probability: np.ndarray) -> np.ndarray:
    """Return x (1 − x), which is 0 where a share cannot depend on the refractive index."""
    return probability * (1.0 - probability)
