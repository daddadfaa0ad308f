"""Light inside a sample: irradiances at depths, and what is absorbed between them."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import xarray as xr

from splits.arrays import check_each, increasing, row_of
from splits.checks import ROUNDING, in_range, known_arguments, one_of, refuse
from splits.instruments.arguments import (
    check_incidence,
    check_medium,
    check_threads,
    check_wavelengths,
    check_whole,
)
from splits.instruments.ensemble import GROUPS
from splits.instruments.inside import Found, found_by, shares_of
from splits.instruments.inside_errors import (
    Doubt,
    Steps,
    errors_of,
    flux_missed,
    share_missed,
    steps_of,
)
from splits.instruments.labels import run_facts, wavelength_axis
from splits.instruments.nodes import choose_nodes
from splits.instruments.planes import Planes
from splits.instruments.progress import Report, shows_progress
from splits.instruments.runner import Runner
from splits.instruments.scenes import constants_of
from splits.instruments.tracers import KERNELS
from splits.media.granular import GranularMedium, LayeredMedium
from splits.media.particles import ParticleLayer
from splits.transport.sums.passages import DOWN, UP
from splits.uncertainty import Variable, deviations, quantity, stderr_of

MOST_DEPTHS = 200
MOST_SUMS = 100_000_000
"""Sums by group, layer, material and wavelength that are held: some three times their memory."""
_BIAS_SHARE = 0.4
"""Part of the error asked for that interpolation between indices may take."""


@known_arguments
@shows_progress
def profile(
    medium: GranularMedium | LayeredMedium,
    wavelength_nm: Any,
    depth_m: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: Report = None,
) -> xr.Dataset:
    """Return irradiances inside a medium of grains, and where its light is absorbed.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
        For example `splits.Snow` or `splits.Stack`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium, at most 200.  Its top and its bottom are
        added to them.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.9999 degrees, or equal radiance from everywhere.
    max_stderr : float
        Largest standard error wanted for any irradiance or absorbed share, 1e-6 to 0.5.
    seed : int
        Non-negative; the same seed gives the same numbers on any number of threads.
    max_rays, threads, kernel, progress
        As for `splits.spectrophotometer`.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength`` and ``depth``, in units of the irradiance from above:
        ``downward_irradiance`` and ``upward_irradiance``, the latter at the top the reflectance.
        Over ``wavelength`` and ``interval``, between successive depths: ``absorptance``, the share
        of the light that is absorbed there, and ``actinic_flux``, the mean path of the light in
        the interval over its thickness, grains and pores together.  ``absorptance_of_material``
        over ``material`` besides.  All with standard errors ``…_stderr``; irradiances and
        absorptances also with ``…_groups``, see `splits.analysis.errors`.  Reflectance,
        absorptances, and the net irradiance at the bottom add up to 1.

    Raises
    ------
    ValueError
        For a value outside its range.

    Notes
    -----
    Light inside a grain that lies across a plane counts as passing it where the ray leaves the
    grain on the other side, and what that grain absorbs belongs to the interval of its entry.  A
    plane at a face between layers of different saturation counts the light that passes; what the
    face reflects does not, on either side of it.

    Actinic flux and shares of materials take weights to fall evenly along the path between planes.
    Where single grains or pores absorb much of the light that crosses them, both are rough; their
    errors hold what that may be (`splits.instruments.inside_errors`).

    References
    ----------
    Paths and weights are those of SPLITSnow Eqs 5-6; actinic flux as path per volume, for example
    Mayer (2009), EPJ Web of Conferences 1, 75, section 4.
    """
    check_medium(medium, GranularMedium, LayeredMedium)
    wavelengths = check_wavelengths(wavelength_nm)
    if any(isinstance(part, ParticleLayer) for part in getattr(medium, "parts", ())):
        raise refuse("medium", medium.kind, "layers of grains", "particles absorb by their albedo")
    depths = _check_depths(depth_m, float(medium.depth_m))
    incidence = check_incidence(incidence_deg)
    max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    one_of("kernel", kernel, KERNELS)
    seed = check_whole("seed", seed, 0)
    max_rays = check_whole("max_rays", max_rays, 1)
    threads = check_threads(threads)
    begun = time.perf_counter()
    planes = depths.tolist()
    runner = Runner(medium, incidence, seed, threads, False, kernel, progress, planes_m=planes)
    index, absorption = constants_of(medium, wavelengths)
    nodes = choose_nodes(index, medium.interfaces(), _BIAS_SHARE * max_stderr)
    faces = runner.tracer.depths_m
    layers = len(faces) - 1
    _check_memory(layers, absorption.shape, len(nodes.index))
    ensembles = [
        Planes(number, m, absorption, w > 0.0, runner.tracer.manner, layers)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    runner.prepare(ensembles)
    planes = np.array([0.0, *depths, faces[-1]])
    at = np.searchsorted(faces, planes)
    found, least, reached = found_by(runner, ensembles, nodes, at, max_stderr, max_rays)
    facts = {
        **run_facts("Light inside", "profile", medium, begun, seed, threads),
        "incidence_deg": incidence,
        "max_stderr": max_stderr,
        "stopped_by": "error" if reached <= max_stderr else "rays",
        "max_stderr_reached": reached,
        "interpolation_error_bound": float(nodes.bias.max()),
        "max_rays": max_rays,
        "rays": sum(level.rays for e in ensembles for level in e.levels),
        "ensembles": len(ensembles),
        "kernel": runner.kernels(ensembles),
    }
    doubt, steps = Doubt(nodes.bias, least), steps_of(medium, absorption, planes)
    return _dataset(found, doubt, steps, wavelengths, planes, list(medium.materials()), facts)


def _check_depths(depth_m: Any, thickness: float) -> np.ndarray:
    """Return depths inside a sample of a thickness (m), or refuse them."""
    depths = increasing("depth_m", row_of("depth_m", depth_m, "numbers in metres"))
    if depths.size > MOST_DEPTHS:
        raise refuse("depth_m", f"{depths.size} depths", f"at most {MOST_DEPTHS}")
    hint = "top and bottom are there in any case"
    # Rounding leaves what is meant as the bottom on either side of it.
    bottom = np.isclose(depths, thickness, rtol=ROUNDING, atol=0.0)
    depths = np.where(bottom, thickness, depths)
    return check_each(
        "depth_m", depths, 0.0, thickness, "m", open_low=True, open_high=True, hint=hint
    )


def _check_memory(layers: int, shape: tuple[int, ...], nodes: int) -> None:
    """Refuse what would not fit into memory; `shape` is that of absorption."""
    wavelengths, columns = shape
    sums = GROUPS * layers * (columns + 3) * wavelengths * nodes
    if sums > MOST_SUMS:
        raise refuse(
            "wavelength_nm", f"{wavelengths} wavelengths",
            f"at most {max(1, wavelengths * MOST_SUMS // sums)} with so many depths and layers",
            "several calls hold more",
        )  # fmt: skip


def _dataset(
    found: Found,
    doubt: Doubt,
    steps: Steps,
    wavelengths: np.ndarray,
    planes: np.ndarray,
    materials: list[str],
    facts: dict[str, Any],
) -> xr.Dataset:
    """Return what was found as a labelled dataset."""
    thickness = np.diff(planes)[:, np.newaxis]
    by_depth, by_interval = ("wavelength", "depth"), ("wavelength", "interval")
    variables: dict[str, Variable] = {}

    def put(
        name: str, dims: tuple[str, ...], groups: np.ndarray, label: str, more: Any = None
    ) -> None:
        mean = groups.mean(axis=0)
        stderr = errors_of(groups, doubt.bias, doubt.least)
        stderr = stderr if more is None else np.hypot(stderr, more)
        values, error = np.moveaxis(mean, -1, 0), np.moveaxis(stderr, -1, 0)
        variables.update(quantity(name, dims, values, error, label))
        if more is None:
            off = np.moveaxis(groups - mean, -1, 1) / np.sqrt(len(groups) * (len(groups) - 1))
            variables.update(deviations(name, dims, off, label))

    put("downward_irradiance", by_depth, found.light[:, DOWN], "downward irradiance")
    put("upward_irradiance", by_depth, found.light[:, UP], "upward irradiance")
    put("absorptance", by_interval, found.absorbed, "absorptance of the interval")
    light, flux = found.light.mean(axis=0), found.way / thickness
    arriving = (light[DOWN, :-1] + light[UP, 1:]) / thickness
    whole = found.absorbed.mean(axis=0)
    error = flux_missed(steps, flux.mean(axis=0), whole / thickness, arriving)
    put("actinic_flux", by_interval, flux, "mean path over thickness", error)
    shared = shares_of(found, len(materials))
    told = found.absorbed - found.by_material.sum(axis=2)
    heard = found.by_material.sum(axis=2).mean(axis=0) > 0.0
    unheard = np.abs(told.mean(axis=0)) - np.where(heard, 2.0 * stderr_of(told), 0.0)
    unheard = np.maximum(unheard, 0.0)
    error = share_missed(steps, shared.mean(axis=0), whole, unheard)
    by_material = (*by_interval, "material")
    put("absorptance_of_material", by_material, shared, "absorptance of a material", error)
    depth = {"long_name": "depth", "units": "m", "positive": "down", "standard_name": "depth"}
    coordinates = {
        "wavelength": wavelength_axis(wavelengths),
        "depth": ("depth", planes, depth),
        "interval_top": ("interval", planes[:-1], {"long_name": "top", "units": "m"}),
        "interval_bottom": ("interval", planes[1:], {"long_name": "bottom", "units": "m"}),
        "material": ("material", np.array(materials), {"long_name": "material"}),
    }
    return xr.Dataset(variables, coordinates, facts)
