"""Spectra of the snowpacks of `splits.SnowPacks` by discrete ordinates, in parallel."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.progress import Progress, open_progress
from splits.core.uncertainty import Variable
from splits.core.validation import check_choice, invalid
from splits.discrete_ordinates.snow_packs import (
    MAX_ROWS,
    PackMaterials,
    SpectraSolution,
    find_spectral_obstacle,
    find_unsupported,
    make_snowpacks,
    solve_spectra,
)
from splits.instruments.solver import DISCRETE_ORDINATES, MONTE_CARLO, SOLVERS
from splits.io.netcdf import ANCILLARY_ATTRIBUTE
from splits.media.snow_pack_input import FLAG_NAME, LAYER_DIM, ZENITH_KEY
from splits.media.snow_pack_quality import FLAGS, HORIZON_DEG
from splits.media.snow_packs import SnowPacks
from splits.simulation.run_options import RunOptions, check_incidence
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads

UNSUPPORTED = "unsupported"
RESULT_FLAGS = {**FLAGS, UNSUPPORTED: 5}
"""Flags of results: those of snowpacks, and one for those outside the tables of grains."""
SUN, DIFFUSE = "sun", "diffuse"
MAX_INCIDENCE_DEG = 89.9999
MIN_TASKS = 8
"""Smallest number of tasks for each thread, so that all of them end at about the same time."""


@dataclass(frozen=True)
class PackProgress(Progress):
    """State of a run over snowpacks.

    Attributes
    ----------
    done, total : int
        Numbers of snowpacks.
    """

    done: int = 0
    total: int = 0

    def __str__(self) -> str:
        return f"{self.done} of {self.total} snowpacks, {self.seconds_left:.0f} s left"


class PackSpectra(NamedTuple):
    """Spectra of all snowpacks; NaN for those without result.

    Attributes
    ----------
    reflectance, transmittance : float, shape (snowpacks, wavelengths, beams + 1)
        Under beams, and under diffuse light (last).
    error : float, shape (snowpacks, wavelengths)
    flags : int, shape (snowpacks,)
        One of `RESULT_FLAGS`.
    attributes : dict
        Solver, number of streams and largest errors.
    """

    reflectance: np.ndarray
    transmittance: np.ndarray
    error: np.ndarray
    flags: np.ndarray
    attributes: dict[str, Any]

    def bound_error(self, values: np.ndarray) -> np.ndarray:
        """Return the error of a quantity from 0 to 1, which is at most the quantity itself."""
        return np.minimum(self.error, np.maximum(values, np.finfo(float).eps))


def check_pack_solver(solver: Any) -> None:
    """Check the solver for snowpacks, which are discrete ordinates."""
    if check_choice("solver", solver, SOLVERS) != MONTE_CARLO:
        return
    hint = "paths are for one snowpack: packs.make_stack(label)"
    raise invalid("solver", solver, f"'{DISCRETE_ORDINATES}' or 'auto' for SnowPacks", hint)


def set_incidence(packs: SnowPacks, incidence_deg: Any) -> tuple[SnowPacks, float | str]:
    """Return the snowpacks and the incidence: an angle, "diffuse" or "sun".

    Angles for each snowpack become the zenith angles of the sun, so that those at the horizon or
    below get the flag night, and missing ones the flag missing_value.
    """
    if isinstance(incidence_deg, str) and incidence_deg == SUN:
        if ZENITH_KEY not in packs.dataset:
            hint = "packs.with_sun_zenith(angles) adds it"
            raise invalid("incidence_deg", SUN, f"for snowpacks with {ZENITH_KEY}", hint)
        return packs, SUN
    if not isinstance(incidence_deg, str) and np.ndim(incidence_deg):
        return packs.with_sun_zenith(incidence_deg), SUN
    return packs, check_incidence(incidence_deg)


def compute_beam_cosines(packs: SnowPacks, incidence: float | str) -> np.ndarray:
    """Return the cosines of the beams of the good snowpacks, shape (good, beams)."""
    n_good = int(packs.is_good.sum())
    if incidence == DIFFUSE:
        return np.empty((n_good, 0))
    angle: Any = incidence
    if incidence == SUN:
        zenith = packs.dataset[ZENITH_KEY].values[packs.is_good]
        angle = np.minimum(zenith, min(MAX_INCIDENCE_DEG, HORIZON_DEG))
    return np.cos(np.radians(np.broadcast_to(angle, (n_good,))))[:, np.newaxis]


def check_pack_wavelengths(wavelength_nm: np.ndarray, is_wet: np.ndarray) -> None:
    """Check that discrete ordinates apply at wavelengths (nm) to dry or to wet snow, or to both."""
    for wet in np.unique(is_wet).tolist():
        obstacle = find_spectral_obstacle(wavelength_nm, wet=wet)
        if obstacle:
            hint = f"for discrete ordinates, snow {obstacle.removeprefix('it ')}"
            raise invalid("wavelength_nm", wavelength_nm.tolist(), "within the tables", hint)


def solve_packs(
    packs: SnowPacks, wavelength_nm: np.ndarray, cosines: np.ndarray, max_error: float,
    run: RunOptions,
) -> PackSpectra:  # fmt: skip
    """Return the spectra of all good snowpacks.

    Parameters
    ----------
    packs : SnowPacks
    wavelength_nm : float, shape (wavelengths,)
    cosines : float, shape (good, beams)
    max_error : float
        Determines the number of streams of each snowpack.
    run : RunOptions

    Raises
    ------
    ValueError
        For wavelengths at which discrete ordinates apply to no snow.
    """
    arrays = packs.to_arrays()
    is_wet = np.any(arrays.liquid_water_content > 0.0, axis=1)
    check_pack_wavelengths(wavelength_nm, is_wet)
    materials = PackMaterials.from_wavelengths(wavelength_nm, packs.impurities)
    ground = packs.compute_ground_albedo(wavelength_nm)
    unsupported = find_unsupported(arrays, materials)
    flags = packs.dataset[FLAG_NAME].values.copy()
    flags[arrays.positions[unsupported]] = RESULT_FLAGS[UNSUPPORTED]
    parts = list(_divide(is_wet, arrays.n_layers, ~unsupported, wavelength_nm.size, run.threads))

    def solve(rows: np.ndarray) -> SpectraSolution:
        snowpacks = make_snowpacks(arrays, rows, ground[rows], materials)
        return solve_spectra(snowpacks, cosines[rows], max_error)

    shape = (len(packs), wavelength_nm.size)
    reflectance, transmittance = (np.full((*shape, cosines.shape[1] + 1), np.nan) for _ in range(2))
    error = np.full(shape, np.nan)
    largest = {"streams": 0, "truncation_error": 0.0, "optics_error": 0.0}
    for rows, solution in _iterate_solutions(solve, parts, max_error, run):
        where = arrays.positions[rows]
        reflectance[where] = np.clip(solution.reflectance, 0.0, 1.0)
        transmittance[where] = np.clip(solution.transmittance, 0.0, 1.0)
        error[where] = solution.error
        found = (solution.n_streams, solution.truncation, solution.optics_error)
        for name, values in zip(largest, found, strict=True):
            largest[name] = max(largest[name], values.max().item())
    attributes = {"solver": DISCRETE_ORDINATES, **largest}
    return PackSpectra(reflectance, transmittance, error, flags, attributes)


def _divide(
    is_wet: np.ndarray, n_layers: np.ndarray, chosen: np.ndarray, n_wavelengths: int, threads: int
) -> Iterator[np.ndarray]:
    """Iterate over parts of the chosen snowpacks, all dry or all wet, of one number of layers."""
    per_part = max(1, min(MAX_ROWS // n_wavelengths, chosen.sum() // (MIN_TASKS * threads)))
    for wet in (True, False):
        for number in np.unique(n_layers)[::-1]:
            group = np.flatnonzero(chosen & (is_wet == wet) & (n_layers == number))
            for start in range(0, group.size, per_part):
                yield group[start : start + per_part]


def _iterate_solutions(
    solve: Any, parts: list[np.ndarray], max_error: float, run: RunOptions
) -> Iterator[tuple[np.ndarray, SpectraSolution]]:
    """Iterate over the solutions of parts, computed in threads, and report the progress."""
    total, done = sum(part.size for part in parts), 0
    n_ahead = 2 * run.threads
    with ExitStack() as stack:
        report = stack.enter_context(open_progress("snowpacks", run.progress))
        stack.enter_context(limit_blas_threads())
        pool = stack.enter_context(DaemonThreadPool(run.threads))
        # Only a few parts are submitted in advance, so that few solutions wait in memory.
        jobs = [pool.submit(partial(solve, part)) for part in parts[:n_ahead]]
        for number, part in enumerate(parts):
            solution = jobs[number].result()
            jobs[number] = None  # type: ignore[call-overload]
            if number + n_ahead < len(parts):
                jobs.append(pool.submit(partial(solve, parts[number + n_ahead])))
            yield part, solution
            done += part.size
            if report is not None:
                seconds = time.perf_counter() - run.start_time
                left = seconds * (total - done) / done
                report(PackProgress(0, np.inf, max_error, seconds, left, done, total))


def make_pack_dataset(
    packs: SnowPacks, flags: np.ndarray, variables: dict[str, Variable], axes: dict[str, Any]
) -> xr.Dataset:
    """Return a dataset over snowpacks, with their flags and zenith angles of the sun.

    Parameters
    ----------
    packs : SnowPacks
    flags : int, shape (snowpacks,)
        One of `RESULT_FLAGS`.
    variables : dict of Variable
        Over the label and other dimensions.
    axes : dict
        Coordinates of the other dimensions.
    """
    keep = [FLAG_NAME] + [ZENITH_KEY] * (ZENITH_KEY in packs.dataset)
    dataset = packs.dataset[keep].drop_vars(LAYER_DIM, errors="ignore")
    for name in map(str, {*dataset.coords} & {*variables, *axes}):
        hint = f"packs.dataset.rename({{{name!r}: 'site'}})"
        raise invalid("snowpacks", f"with the coordinate {name}", "without names of results", hint)
    attributes = {
        **dataset[FLAG_NAME].attrs,
        "flag_values": np.array(list(RESULT_FLAGS.values()), dtype=np.int8),
        "flag_meanings": " ".join(RESULT_FLAGS),
    }
    dataset[FLAG_NAME] = (packs.label, flags, attributes)
    dataset.attrs = {}
    for _, _, attributes in variables.values():
        # NaN is allowed where the flag is not 0.
        own = attributes.get(ANCILLARY_ATTRIBUTE, "")
        attributes[ANCILLARY_ATTRIBUTE] = f"{own} {FLAG_NAME}".strip()
    return dataset.assign_coords(axes).assign(variables)
