"""Single-scattering properties of a granular medium, for radiative transfer by other means."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from splits.checks import one_of, refuse
from splits.instruments import streams
from splits.instruments.arguments import check_medium, check_threads, check_wavelengths, check_whole
from splits.instruments.labels import run_facts, wavelength_axis
from splits.instruments.nodes import Nodes, choose_nodes
from splits.instruments.scenes import granular_scene
from splits.instruments.threads import Threads
from splits.materials.refractive_index import absorption_coefficient
from splits.media.granular import GranularMedium
from splits.transport.scattering import PARTS, Solitary, scatter
from splits.transport.scene import DRY_PORE, WET_PORE, Optics, shared_optics
from splits.uncertainty import Variable, quantity, without_one

BATCH = 2048
"""Rays per batch: the grain of parallel work."""

INTERPOLATION = 0.0005
"""Interpolation error allowed, as for a reflectance (see `splits.instruments.nodes`)."""

MOMENT_SLOPE = 2.0
"""How much steeper a Legendre moment may be in the contrast than a reflectance: a forward lobe as
wide as the contrast c has χ_l ~ exp(−c² l²/2), and |dχ/d(ln c)| up to 2/e."""


WET_PORES = ("saturation", "equilibrium")
LABELS = {
    "single_scattering_albedo": ("single-scattering albedo", "1"),
    "asymmetry_parameter": ("asymmetry parameter", "1"),
    "legendre_moment": ("Legendre moment of the phase function", "1"),
    "displacement_before": ("mean way through a grain along the ray before it", "m"),
    "displacement_after": ("mean way through a grain along the ray after it", "m"),
    "displacement_square": ("mean square of the way through a grain", "m2"),
    "wet_share": ("share of the light scattered that leaves into a wet pore", "1"),
    "extinction": ("extinction coefficient", "m-1"),
    "optical_thickness": ("optical thickness of extinction", "1"),
}
RATIOS = ("displacement_before", "displacement_after", "displacement_square", "wet_share")
"""What else is a mean by weight of scattered light, in the order of `scatter`."""
FOR_THEORIES = {
    "_left_out": (("part",), "without one part of the rays:"),
    "_missed": ((), "bound on what interpolation misses of"),
}
"""What theories know errors of the optics by: how names end, dimensions before, and labels."""


@dataclass(frozen=True)
class _Node:
    """Tallies of one node, per ray, for the wavelengths that draw on it.

    Attributes
    ----------
    served : bool, shape (wavelengths,)
    weight : float, shape (served,)
        Weight of this node in the wavelengths' means.
    sums : float, shape (3, orders + 4, served)
    parts : float, shape (parts, orders + 4, served)
        See `splits.transport.scattering.scatter`.
    """

    served: np.ndarray
    weight: np.ndarray
    sums: np.ndarray
    parts: np.ndarray


def single_scattering(
    medium: GranularMedium,
    wavelength_nm: Any,
    moments: int = 64,
    rays: int = 200_000,
    seed: int = 1,
    threads: int | None = None,
    *,
    wet_pores: str = "saturation",
) -> xr.Dataset:
    """Measure what single grains of a medium do to light, as radiative transfer wants to know it.

    Rays meet one grain each in free pore space, which is wet with the medium's saturation, drawn
    and followed by the rules of the full model (SPLITS sections 4.3.3-4.3.4, SPLITSnow 3.2-3.3)
    except those that look at neighbours: no boundary and no last leg rejects a grain.

    As in the papers' model, diffraction is left out: the extinction is that of the geometric
    cross-section, half of what Mie theory has for large grains, and the phase function lacks the
    narrow forward peak.  With diffraction, ω' = (1 + ω)/2 and
    g' = (1 + ω g)/(1 + ω).

    Parameters
    ----------
    medium : GranularMedium
        For example `splits.Snow`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    moments : int
        Highest order l of the Legendre moments, 1 to 4096.
    rays : int
        Rays per refractive-index node, at least 2; rounded up to whole batches of `BATCH`.
    seed : int
        Non-negative; the same seed gives the same numbers on any number of threads.
    threads : int, optional
        Default: every CPU this process may use.
    wet_pores : {"saturation", "equilibrium"}
        Share of the light that meets grains, and is absorbed between them, in wet pores: the
        saturation S, as where light enters the sample; or S n²/(S n² + 1 − S), n the index of
        water over that of air, as deep in the sample, where radiance goes with n² (light leaves
        grains into water more easily).

    Returns
    -------
    xarray.Dataset
        Over ``wavelength``, all but ``extinction`` and ``optical_thickness``, which are exact,
        with standard error ``…_stderr``:
        ``single_scattering_albedo`` (0 to 1, absorption by the pores included),
        ``asymmetry_parameter``, ``legendre_moment`` over (wavelength, order), χ_l = <P_l(cosΘ)>
        by weight of the light that leaves the grain, χ_0 = 1; ``extinction`` (1/m), the grains
        met per metre plus absorption by the pores, and ``optical_thickness``.

        Besides, for `splits.analysis.radiative_transfer.packed`:
        ``displacement_before`` and ``displacement_after`` (m), the way from entry to exit along
        the direction before and after; ``displacement_square`` (m²); and ``wet_share``, the
        share of the scattered light that leaves into a wet pore.

        Theories need to know which errors go together: ``…_left_out`` over ``part`` holds each
        quantity without one of `PARTS` equal parts of the rays, ``…_missed`` the bound on what
        interpolation between refractive indices may add to it.

    Raises
    ------
    ValueError
        For a value outside its range.

    Notes
    -----
    Paths are traced with the refractive indices of a few nodes, as by the spectral estimator;
    standard errors contain the bound on what that misses.
    """
    begun = time.perf_counter()
    check_medium(medium, GranularMedium)
    if medium.pores:
        raise refuse("pores", dict(medium.pores), "empty: pores are dry or wet here")
    wavelengths = check_wavelengths(wavelength_nm)
    moments = check_whole("moments", moments, 1, 4096)
    rays = BATCH * -(-check_whole("rays", rays, 2) // BATCH)
    seed = check_whole("seed", seed, 0)
    threads = check_threads(threads)
    one_of("wet_pores", wet_pores, WET_PORES)
    index = medium.indices(wavelengths)
    absorption = absorption_coefficient(index, wavelengths[:, np.newaxis])
    nodes = choose_nodes(index, medium.interfaces(), INTERPOLATION)
    wet = _wet_share(medium.saturation, index, wet_pores)
    at_nodes = _wet_share(medium.saturation, nodes.index, wet_pores)
    traced = _trace(medium, nodes, at_nodes, absorption, moments + 1, rays, seed, threads)
    values = _estimate(traced, nodes.bias, moments + 1, rays)

    pore = (1.0 - wet) * absorption[:, DRY_PORE] + wet * absorption[:, WET_PORE]
    grains = medium.grains().attenuation
    values["extinction"] = grains + pore
    values["optical_thickness"] = values["extinction"] * medium.depth_m
    for end in ("", "_stderr", *FOR_THEORIES):
        values[f"single_scattering_albedo{end}"] *= grains / values["extinction"]
    facts = {
        **run_facts(
            "Single-scattering properties", "single_scattering", medium, begun, seed, threads
        ),
        "diffraction": "none",
        "interpolation_error_bound": float(nodes.bias.max()),
        "wet_pores": wet_pores,
        "rays": rays * len(traced),
        "ensembles": len(traced),
    }
    variables: dict[str, Variable] = {}
    for name, (long_name, units) in LABELS.items():
        dims = ("wavelength", "order")[: values[name].ndim]
        stderr = values.get(f"{name}_stderr")
        variables |= quantity(name, dims, values[name], stderr, long_name, units)
        if stderr is not None:
            for end, (also, about) in FOR_THEORIES.items():
                over, label = (*also, *dims), f"{about} {long_name}"
                variables |= quantity(f"{name}{end}", over, values[name + end], None, label, units)
    order = {"long_name": "order of the Legendre moment", "units": "1"}
    coordinates = {
        "wavelength": wavelength_axis(wavelengths),
        "order": ("order", np.arange(moments + 1), order),
    }
    return xr.Dataset(variables, coordinates, facts)


def _wet_share(saturation: float, index: np.ndarray, wet_pores: str) -> np.ndarray:
    """Return the share of light in pore space that is in wet pores, one for each row of indices."""
    wet, dry = saturation, 1.0 - saturation
    if wet_pores == "saturation":
        return np.full(len(index), float(wet))
    square = index[:, [DRY_PORE, WET_PORE]].real ** 2
    return wet * square[:, 1] / (wet * square[:, 1] + dry * square[:, 0])


def _trace(
    medium: GranularMedium,
    nodes: Nodes,
    wet: np.ndarray,
    absorption: np.ndarray,
    orders: int,
    rays: int,
    seed: int,
    threads: int,
) -> list[_Node]:
    """Trace so many rays, a multiple of `BATCH`, at every node."""
    scene = granular_scene(medium, 0.0, False)

    def run(job: tuple[int, int, Optics, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        node, first, optics, part = job
        work = np.array([streams.SINGLE_SCATTERING + node, first, BATCH])
        return scatter(seed, work, orders, Solitary(wet[node], scene, optics), part)

    traced = []
    with Threads(threads) as pool:
        for node, (m, weight) in enumerate(zip(nodes.index, nodes.weights, strict=True)):
            served = weight > 0.0
            part = absorption[served]
            optics = shared_optics(m, part)
            sums = np.zeros((3, orders + len(RATIOS), len(part)))
            parts = np.zeros((PARTS, *sums.shape[1:]))
            jobs = [(node, first, optics, part) for first in range(0, rays, BATCH)]
            # In a fixed order, so that rounding does not depend on the threads.
            for one, other in pool.map(run, jobs):
                sums += one
                parts += other
            # Parts per ray of theirs: their mean is that of all rays.
            traced.append(_Node(served, weight[served], sums / rays, parts * (PARTS / rays)))
    return traced


def _estimate(
    traced: list[_Node], bias: np.ndarray, orders: int, rays: int
) -> dict[str, np.ndarray]:
    """Return means over grains and their standard errors, by name.

    All but the albedo are ratios of means, <w x>/<w>; the error is that of w (x − <w x>/<w>), to
    first order.
    """
    mean = np.zeros((orders + len(RATIOS), len(bias)))
    parts = np.zeros((PARTS, *mean.shape))
    for node in traced:
        mean[:, node.served] += node.weight * node.sums[0]
        parts[:, :, node.served] += node.weight * node.parts
    albedo = mean[0]
    # Where nothing at all is scattered, the phase function has no meaning: 0, and no NaN.
    share = np.maximum(albedo, np.finfo(float).tiny)
    ratio = mean / share
    variance = np.zeros(len(bias))
    spread = np.zeros(mean.shape)
    for node in traced:
        first, mixed, square = node.sums
        chi = ratio[:, node.served]
        variance[node.served] += node.weight**2 * np.maximum(square[0] - first[0] ** 2, 0.0)
        residual = square - 2.0 * chi * mixed + chi**2 * square[0]
        residual -= (first - chi * first[0]) ** 2
        spread[:, node.served] += node.weight**2 * np.maximum(residual, 0.0)
    missed = MOMENT_SLOPE * bias * np.abs(ratio)
    missed[:orders] = MOMENT_SLOPE * bias * np.clip(8.0 * np.abs(_apart(ratio[:orders])), 0.0, 1.0)
    error = np.sqrt(spread / (rays * share**2) + missed**2)
    left_out = without_one(parts)
    ratios = left_out / np.maximum(left_out[:, :1], np.finfo(float).tiny)
    albedo_missed = bias * np.clip(8.0 * _apart(albedo), 0.0, 1.0)
    found = {
        "single_scattering_albedo": albedo,
        "single_scattering_albedo_stderr": np.sqrt(variance / rays + albedo_missed**2),
        "single_scattering_albedo_left_out": left_out[:, 0],
        "single_scattering_albedo_missed": albedo_missed,
    }
    rows = {"legendre_moment": slice(orders), "asymmetry_parameter": 1}
    rows |= {name: orders + row for row, name in enumerate(RATIOS)}
    for name, row in rows.items():
        for end, table in (("", ratio), ("_stderr", error), ("_missed", missed)):
            found[f"{name}{end}"] = table[row].T
        found[f"{name}_left_out"] = np.moveaxis(ratios[:, row], 1, -1)
    return found


def _apart(value: np.ndarray) -> np.ndarray:
    """Return x (1 − x), which is 0 where a share cannot depend on the refractive index."""
    return value * (1.0 - value)
