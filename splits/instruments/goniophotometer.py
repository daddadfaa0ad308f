"""Virtual goniophotometer: where reflected and transmitted light goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from splits.checks import in_range, one_of, refuse
from splits.dataset import attributes, provenance
from splits.instruments.angular import BIAS, Estimate, angles_of, estimate, rays_wanted, reference
from splits.instruments.cells import CELLS_OF_5_DEG, Cells, centres, estimate_cells
from splits.instruments.directional import ROUND, Directional
from splits.instruments.ensemble import Paths
from splits.instruments.fixed import check_whole
from splits.instruments.nodes import Nodes, choose_nodes
from splits.instruments.runner import KERNELS, Progress, Runner
from splits.instruments.single_scattering import WAVELENGTH
from splits.instruments.spectrophotometer import check_wavelengths
from splits.materials.refractive_index import absorption_coefficient
from splits.media.granular import GranularMedium
from splits.transport import sources_digest
from splits.transport.directions import basis_of

POLAR_DEG = tuple(np.arange(0.0, 90.0, 2.5).tolist())
AZIMUTH_DEG = tuple(np.arange(0.0, 360.0, 5.0).tolist())

DEGREE = 24
"""Largest degree of polynomials: details of about 180°/24."""

STEEPEST_DEG = 82.5
"""Polar angle up to which the error asked for is to be reached."""

ESTIMATORS = ("expansion", "cells")
SIDES = {"brdf": 0, "btdf": 1}

_GROWTH = 8.0
_NODES_SHARE = 0.05
"""Bound on what interpolation between refractive indices may miss of a reflectance, as a part of
the relative error asked for."""


def goniophotometer(
    medium: GranularMedium,
    wavelength_nm: Any,
    incidence_deg: float = 0.0,
    rays: int | None = None,
    seed: int = 1,
    *,
    relative_stderr: float = 0.02,
    target: str = "brdf",
    polar_deg: Any = POLAR_DEG,
    azimuth_deg: Any = AZIMUTH_DEG,
    estimator: str = "expansion",
    cells: tuple[int, int] = CELLS_OF_5_DEG,
    max_rays: int = 1_000_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: Callable[[Progress], None] | None = None,
) -> xr.Dataset:
    """Measure the BRDF and the BTDF of a medium under a beam.

    Parameters
    ----------
    medium : GranularMedium
        For example `splits.Snow`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float
        Polar angle of the beam, 0 to 89.9999 degrees; beyond 89.9 a run takes minutes, because few
        grains fit below the boundary there.
    rays : int, optional
        How many rays to trace, rounded up; by default as many as `relative_stderr` takes.
    seed : int
        Non-negative; the same seed gives the same numbers bit for bit on any number of threads.
    relative_stderr : float
        Largest standard error wanted as a part of the value, 1e-4 to 0.5, for polar angles up to
        `STEEPEST_DEG`.
    target : {"brdf", "btdf"}
        Which of both is to reach it; wavelengths without light there do not count.
    polar_deg : array_like
        Angles from the normal, 0 to below 90 degrees, strictly increasing.
    azimuth_deg : array_like
        Angles from the direction in which the beam travels, 0 to below 360 degrees, strictly
        increasing: the principal plane is 0 (forward) and 180 (back).
    estimator : {"expansion", "cells"}
        Orthonormal polynomials over the hemisphere, or the papers' collectors as a reference:
        cells of equal solid angle.  Cells take `rays`, a million by default.
    cells : (int, int)
        Cells between horizon and zenith and around; results stand at their middles, and
        `polar_deg` and `azimuth_deg` do not count.
    max_rays : int
        A run to an error stops once this many are traced; attribute ``stopped_by`` says what came
        first.
    threads : int, optional
        Default: every CPU this process may use.
    kernel : {"auto", "lanes", "scalar"}
        See `splits.spectrophotometer`.
    progress : callable, optional
        Called now and then with a `Progress`; errors are relative.

    Returns
    -------
    xarray.Dataset
        ``brdf`` and ``btdf`` (1/sr) over ``wavelength``, ``polar`` and ``azimuth``, of light that
        met a grain; the ``reflectance_factor`` π·BRDF; the ``anisotropy_factor`` π·BRDF over the
        reflectance of that light (its error is that of the BRDF alone), 0 where there is none.
        Over wavelength, ``reflectance`` and
        ``transmittance`` of all light, and the parts of them that met no grain, which leave as
        sharp beams: ``specular_reflectance`` and ``direct_transmittance``.  All with their
        standard errors ``…_stderr``.

    Raises
    ------
    ValueError
        For a value outside its range.

    References
    ----------
    SPLITSnow section 4.1, Eq 7; Nicodemus et al. (1977) for the terms.
    """
    wavelengths = check_wavelengths(wavelength_nm)
    incidence = check_beam(incidence_deg)
    relative_stderr = in_range("relative_stderr", relative_stderr, 1e-4, 0.5)
    side = SIDES[one_of("target", target, SIDES)]
    one_of("estimator", estimator, ESTIMATORS)
    one_of("kernel", kernel, KERNELS)
    check_whole("seed", seed, 0)
    check_whole("max_rays", max_rays, 1)
    for key, value in (("rays", rays), ("threads", threads)):
        if value is not None:
            check_whole(key, value, 1)
    begun = time.perf_counter()
    index = medium.indices(wavelengths)
    absorption = absorption_coefficient(index, wavelengths[:, np.newaxis])
    nodes = choose_nodes(index, medium.interfaces(), _NODES_SHARE * relative_stderr)
    paths: Sequence[Paths]
    runner = Runner(medium, incidence, int(seed), threads, False, kernel, progress, orders=True)
    if estimator == "cells":
        polar, azimuth = centres(check_cells(cells))
        paths, result, reached = _collect(runner, nodes, absorption, cells, rays or 1_000_000)
    else:
        polar = check_angles("polar_deg", polar_deg, 90.0)
        azimuth = check_angles("azimuth_deg", azimuth_deg, 360.0)
        goal = _Goal(side, relative_stderr, rays, int(max_rays))
        paths, result, reached = _expand(runner, nodes, absorption, polar, azimuth, goal)
    worst = _error(result, side, _counted(polar, azimuth))
    facts = {
        "title": f"Virtual goniophotometer: {medium.kind}",
        "instrument": "goniophotometer",
        "medium": medium.kind,
        **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
        "incidence_deg": incidence,
        "estimator": estimator,
        "target": target,
        "relative_stderr": relative_stderr,
        "relative_stderr_reached": worst,
        "stopped_by": reached,
        "interpolation_error_bound": float(nodes.bias.max()),
        "degree": result.degree[side],
        "max_rays": int(max_rays),
        "rays": sum(level.rays for e in paths for level in e.levels),
        "ensembles": len(nodes.index),
        "seed": int(seed),
        "threads": runner.threads,
        "kernel": runner.kernels(paths),
        "wall_time_s": round(time.perf_counter() - begun, 3),
        "physics_sources_sha256": sources_digest(),
        **provenance(),
    }
    return _dataset(result, wavelengths, polar, azimuth, facts)


@dataclass(frozen=True)
class _Goal:
    """How far a run goes: to a relative error on one side, or to a number of rays."""

    side: int
    relative_stderr: float
    rays: int | None
    max_rays: int


def _expand(
    runner: Runner,
    nodes: Nodes,
    absorption: np.ndarray,
    polar: np.ndarray,
    azimuth: np.ndarray,
    goal: _Goal,
) -> tuple[list[Directional], Estimate, str]:
    """Trace until the goal is reached; return the paths, the estimate and what stopped them."""
    symmetric = runner.slab.cos_incidence == 1.0
    angles = angles_of(polar, azimuth, basis_of(DEGREE))
    seen = _counted(polar, azimuth)
    ensembles = [
        Directional(number, m, absorption, w, angles.basis)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    levels = [(e, level) for e in ensembles for level in e.levels]
    limit = goal.rays or goal.max_rays
    runner.trace([(e, level, ROUND) for e, level in levels], 1.0, goal.relative_stderr)
    while True:
        result, variance = estimate(ensembles, nodes.bias, angles, symmetric, goal.side, seen)
        error = _error(result, goal.side, seen)
        have = np.array([level.rays for _, level in levels])
        if goal.rays is None and error <= goal.relative_stderr:
            return ensembles, result, "error"
        if have.sum() >= limit:
            return ensembles, result, "rays"
        missed = BIAS * nodes.bias[:, np.newaxis]
        scale = reference(result)[goal.side][:, seen]
        target = (goal.relative_stderr**2 - missed**2) * scale**2
        wanted = rays_wanted(ensembles, variance, target)
        step = _share_out(wanted, have, limit, goal.rays is not None)
        work = [(*who, int(n)) for who, n in zip(levels, step, strict=True) if n > 0]
        left = float((wanted - have - step).clip(0).sum())
        runner.trace(work, error, goal.relative_stderr, left)


def _counted(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Tell in which directions the error counts: all of them if only steeper ones are wanted."""
    low = polar <= STEEPEST_DEG
    return np.repeat(low if low.any() else ~low, len(azimuth))


def _error(result: Estimate, side: int, seen: np.ndarray) -> float:
    """Return the largest relative error of one side; wavelengths without light do not count."""
    scale, stderr = reference(result)[side][:, seen], result.stderr[side][:, seen]
    return float(np.divide(stderr, scale, out=np.zeros_like(scale), where=scale > 0.0).max())


def _share_out(wanted: np.ndarray, have: np.ndarray, limit: int, fixed: bool) -> np.ndarray:
    """Return how many rays to add to each level: those wanted, or as many in these proportions."""
    room = float(limit - have.sum())
    more = wanted - have
    if fixed:
        low, high = 0.0, (have.sum() + room) / wanted.min()
        for _ in range(60):
            middle = 0.5 * (low + high)
            enough = np.clip(middle * wanted - have, 0.0, None).sum() >= room
            low, high = (low, middle) if enough else (middle, high)
        more = high * wanted - have
    step = np.clip(more, 0.0, (_GROWTH - 1.0) * have)
    if not step.any():
        # All have what was foretold, but the error has grown: finer detail came into sight.
        step = 0.25 * have
    step *= min(1.0, room / step.sum())
    return np.ceil(step / ROUND).astype(np.int64) * ROUND


def _collect(
    runner: Runner, nodes: Nodes, absorption: np.ndarray, cells: tuple[int, int], rays: int
) -> tuple[list[Cells], Estimate, str]:
    """Trace so many rays and count them in cells; return what `_expand` returns."""
    paths = [
        Cells(number, m, absorption, w, cells)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    each = -(-rays // len(paths))
    runner.trace([(e, level, each) for e in paths for level in e.levels], 1.0, 0.0)
    return paths, estimate_cells(paths, nodes.bias), "rays"


def _dataset(
    result: Estimate,
    wavelengths: np.ndarray,
    polar: np.ndarray,
    azimuth: np.ndarray,
    facts: dict[str, Any],
) -> xr.Dataset:
    """Return an estimate as a labelled dataset."""
    grid = ("wavelength", "polar", "azimuth")
    shape = (len(wavelengths), len(polar), len(azimuth))
    scattered = result.scattered()[0][:, np.newaxis]
    share = np.divide(np.pi, scattered, out=np.zeros_like(scattered), where=scattered > 0.0)
    variables: dict[str, Any] = {}

    def put(name: str, dims: Any, long_name: str, units: str, pair: Any) -> None:
        about = {"long_name": long_name, "units": units, "ancillary_variables": f"{name}_stderr"}
        variables[name] = (dims, pair[0], about)
        error = {"long_name": f"standard error of {long_name}", "units": units}
        variables[f"{name}_stderr"] = (dims, pair[1], error)

    directional = {
        "brdf": ("bidirectional reflectance distribution function", "sr-1", 0, 1.0),
        "btdf": ("bidirectional transmittance distribution function", "sr-1", 1, 1.0),
        "reflectance_factor": ("bidirectional reflectance factor", "1", 0, np.pi),
        "anisotropy_factor": ("anisotropy factor", "1", 0, share),
    }
    for name, (long_name, units, side, factor) in directional.items():
        pair = (factor * result.mean[side], factor * result.stderr[side])
        put(name, grid, long_name, units, [values.reshape(shape) for values in pair])
    whole = {
        "reflectance": ("directional-hemispherical reflectance", 0, 0),
        "transmittance": ("directional-hemispherical transmittance", 0, 1),
        "specular_reflectance": ("reflectance without scattering", 2, 0),
        "direct_transmittance": ("transmittance without scattering", 2, 1),
    }
    for name, (long_name, row, side) in whole.items():
        put(name, "wavelength", long_name, "1", result.sums[row : row + 2, side])
    angle = {"units": "degree"}
    coordinates = {
        "wavelength": ("wavelength", wavelengths, WAVELENGTH),
        "polar": ("polar", polar, {**angle, "long_name": "angle from the normal"}),
        "azimuth": (
            "azimuth",
            azimuth,
            {**angle, "long_name": "angle from the direction in which the beam travels"},
        ),
    }
    return xr.Dataset(variables, coordinates, attributes(facts))


def check_beam(value: Any) -> float:
    """Return the polar angle of a beam, or refuse it."""
    if value == "diffuse":
        raise refuse(
            "incidence_deg", value, "an angle", "diffuse light is for the spectrophotometer"
        )
    return in_range("incidence_deg", value, 0.0, 89.9999, "degrees")


def check_angles(key: str, values: Any, end: float) -> np.ndarray:
    """Return increasing angles from 0 to below `end` degrees, or refuse them."""
    try:
        angles = np.atleast_1d(np.asarray(list(np.atleast_1d(values)), dtype=float))
    except (TypeError, ValueError):
        raise refuse(key, values, "numbers in degrees") from None
    if angles.size == 0:
        raise refuse(key, [], "at least one angle in degrees")
    for angle in angles:
        in_range(key, float(angle), 0.0, end, "degrees", open_high=True)
    if not (np.diff(angles) > 0.0).all():
        raise refuse(key, angles.tolist(), "strictly increasing")
    return angles


def check_cells(cells: Any) -> tuple[int, int]:
    """Return numbers of cells in polar and azimuth angle, 1 to 1000 each, or refuse them."""
    try:
        polar, azimuth = (check_whole("cells", n, 1) for n in cells)
    except (TypeError, ValueError):
        polar = azimuth = 0
    if not (1 <= polar <= 1000 and 1 <= azimuth <= 1000):
        raise refuse("cells", cells, "two whole numbers from 1 to 1000")
    return polar, azimuth
