"""Execution of an experiment: all points of its grid as one labelled dataset."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Sequence
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.atomic import check_writable
from splits.core.inputs import MAX_DATASET_VALUES
from splits.core.keywords import REACHED_ATTRIBUTES, log_missed_error, nest_runs
from splits.core.progress import LogCallback, Progress
from splits.core.provenance import hash_physics_sources
from splits.core.validation import invalid
from splits.experiments.config.instruments import (
    FUNCTIONS,
    Instrument,
    list_section_inputs,
    refractive_index,
)
from splits.experiments.config.media import (
    identify_by_content,
    make_grid_coordinates,
    replace_table_paths,
)
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import Point, SimulationConfig
from splits.experiments.run_table import MAX_RAYS, run_table, write_table
from splits.instruments.solver import DISCRETE_ORDINATES
from splits.instruments.spectrophotometer import SpectralRequest, simulate_spectra
from splits.io.cache import NO_CACHE, Cache
from splits.io.netcdf import make_provenance, save, to_netcdf_attributes
from splits.media.kinds import check_medium
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import check_stokes
from splits.simulation.shared_paths import MediaGroup, group_by_shared_paths
from splits.simulation.strata import STOP_REASONS
from splits.tables.build import RETURN_TITLE

N_BEAM_RAYS = 200_000
"""Number of rays of a beam at a relative standard error of 0.02."""


POINT_VARIABLES = {
    "rays": ("rays", "number of rays traced", "1"),
    "max_stderr_reached": ("max_stderr_reached", "largest standard error reached", "1"),
    "relative_stderr_reached": (
        "relative_stderr_reached", "largest relative standard error reached", "1",
    ),
    "mean_grain_distance": (
        "{medium}_mean_grain_distance_m", "mean distance between grains along a ray", "m",
    ),
    "specific_surface_area": (
        "{medium}_specific_surface_area_m2_kg", "surface area of the grains per mass", "m2 kg-1",
    ),
}  # fmt: skip
"""Variables over the grid: attribute of the points, long name and units."""


def run(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int = 1,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
    cache: Cache = NO_CACHE,
) -> xr.Dataset:
    """Run all points of an experiment's grid.

    Parameters
    ----------
    experiment : SimulationConfig
    accuracy : Accuracy
        Target errors and limit of rays; ``stderr_scale`` of the instrument multiplies the error.
    seed : int
        Default if the instrument section gives none.  All points of a grid use the same seed, so
        that differences along the grid are smooth.
    threads : int, optional
    log : callable
        Receives lines of progress.
    cache : Cache
        Points of earlier runs, which are not simulated again; not for tables.

    Returns
    -------
    xarray.Dataset
        The instrument's variables over the grid's parameters and wavelength.
    """
    if experiment.is_in_parts:
        return run_table(experiment, accuracy, seed, None, threads, log)
    if experiment.instrument.kind == "refractive_index":
        return compute_refractive_indices(experiment)
    start_time = time.perf_counter()
    results, rays = simulate_points(experiment, accuracy, seed, threads, log, cache)
    dataset = _stack_points(experiment, results, rays, time.perf_counter() - start_time)
    log_missed_error(log, experiment.name, dataset)
    return dataset


def write_run(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    path: Path,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> None:
    """Write the result of `run`; an interrupted run resumes from its cache.

    Parameters
    ----------
    experiment, accuracy, seed, threads, log
        As for `run`.
    folder : path
        Cache of results: points until the file is written, blocks of a table permanently.
    path : path
        The file is written atomically.
    """
    check_writable(path)
    if experiment.is_in_parts:
        write_table(experiment, accuracy, seed, folder, path, threads, log)
    else:
        cache = Cache(folder, "point")
        save(run(experiment, accuracy, seed, threads, log, cache), path)
        cache.delete()


def _stack_points(
    experiment: SimulationConfig, results: list[xr.Dataset], rays: int, seconds: float
) -> xr.Dataset:
    """Return the dataset of a grid from its points."""
    shape = tuple(len(values) for values in experiment.grid.values())
    dims = tuple(experiment.grid)
    first = results[0]
    variables: dict[str, Any] = {}
    common = [n for n in first.data_vars if all(n in r.data_vars for r in results)]
    for name, variable in first[common].data_vars.items():
        stacked = np.stack([r[name].values for r in results]).reshape(*shape, *variable.shape)
        variables[str(name)] = ((*dims, *variable.dims), stacked, variable.attrs)
    for name, (attribute, long_name, units) in POINT_VARIABLES.items():
        key = attribute.format(medium=first.attrs["medium"])
        if key in first.attrs:
            values = np.array([float(r.attrs[key]) for r in results]).reshape(shape)
            variables[name] = (dims, values, {"long_name": long_name, "units": units})
    coordinates: dict[str, Any] = {str(name): first[name] for name in first.coords}
    coordinates |= make_grid_coordinates(experiment.grid)
    varying = {f"{first.attrs['medium']}_{p}" for p in dims} | {"incidence_deg"} & set(dims)
    constant = {
        key: value
        for key, value in first.attrs.items()
        if key not in varying
        and all(key in r.attrs and np.array_equal(r.attrs[key], value) for r in results)
    }
    attributes = {
        **constant,
        "title": RETURN_TITLE
        if experiment.instrument.kind == "return_table"
        else f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "configuration": experiment.dump_configuration(),
        "rays": rays,
        **{
            key: max(float(r.attrs[key]) for r in results)
            for key in REACHED_ATTRIBUTES
            if key in first.attrs
        },
        "wall_time_s": round(seconds, 3),
        **make_provenance(f"experiment {experiment.name}"),
    }
    if "stop_reason" in first.attrs:
        reasons = [r.attrs["stop_reason"] for r in results]
        attributes["stop_reason"] = max(reasons, key=STOP_REASONS.index)
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(attributes))


def compute_refractive_indices(experiment: SimulationConfig) -> xr.Dataset:
    """Return the complex refractive indices of an experiment's medium over wavelength."""
    _, medium, _ = next(experiment.iter_points())
    attributes = {
        "title": f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "configuration": experiment.dump_configuration(),
        "physics_sources_sha256": hash_physics_sources(),
        **make_provenance(f"experiment {experiment.name}"),
    }
    dataset = refractive_index(medium, experiment.instrument.get_wavelengths())
    return dataset.assign_attrs(to_netcdf_attributes({**attributes, **dataset.attrs}))


def simulate_points(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    threads: int | None,
    log: LogCallback,
    cache: Cache = NO_CACHE,
) -> tuple[list[xr.Dataset], int]:
    """Return the results of all points of an experiment in their order, and the number of rays.

    Points that the cache has are not simulated again.  Paths are reused between points that differ
    only in absorption, in the albedo of a ground, or in a common scale of all lengths.
    """
    instrument, points = experiment.instrument, list(experiment.iter_points())
    seed = instrument.get_seed(seed)
    results: dict[int, xr.Dataset] = {}
    rays = 0
    groups = _group_by_shared_paths(experiment, points, accuracy)
    if len(groups) < len(points):
        log(f"{experiment.name}: {len(groups)} sets of paths for {len(points)} points")
    common_key, point_keys = list_point_keys(experiment, accuracy, seed)

    @functools.lru_cache(maxsize=1)
    def simulate(number: int) -> list[xr.Dataset]:
        indices, group = groups[number]
        prefix = _format_prefix(experiment.name, points, indices)
        progress = functools.partial(_log_progress, prefix, log)
        run = RunOptions.start(seed, threads, progress=progress)
        members = [points[index] for index in indices]
        with nest_runs(), experiment.locate_errors(members[0][0]):
            if group is None or instrument.kind != "spectrophotometer":
                one = instrument.select_point(indices[0])
                return [simulate_point(one, members[0], accuracy, run)]
            instruments = [instrument.select_point(index) for index in indices]
            error = min(one.scale_stderr(accuracy.max_stderr) for one in instruments)
            return _simulate_group(instrument, members, group, error, accuracy, run)

    def get_point(number: int, position: int) -> xr.Dataset:
        # Points that share paths depend on each other.
        shared_keys = [point_keys[index] for index in groups[number][0]]
        key = [*common_key, shared_keys, position]
        return cache.get(key, lambda: simulate(number)[position])

    for number, (indices, _) in enumerate(groups):
        prefix = _format_prefix(experiment.name, points, indices)
        n_simulated = simulate.cache_info().misses
        datasets = [get_point(number, position) for position in range(len(indices))]
        results |= dict(zip(indices, datasets, strict=True))
        rays += int(datasets[0].attrs["rays"])
        if simulate.cache_info().misses == n_simulated:
            log(f"{prefix}: kept from an earlier run")
        else:
            _log_result(prefix, datasets, log)
        quantities = [v for v in datasets[0].data_vars.values() if "batch" not in v.dims]
        size = len(points) * max(one.size for one in quantities)
        if size > MAX_DATASET_VALUES:
            given, allowed = f"{size} values", f"at most {MAX_DATASET_VALUES} values in all"
            raise invalid("grid", given, allowed, "split it into several experiments")
    return [results[index] for index in range(len(points))], rays


def list_point_keys(
    experiment: SimulationConfig, accuracy: Accuracy, seed: int
) -> tuple[list[Any], list[Any]]:
    """Return all that determines the results of all points, and that of each point."""
    instrument = experiment.instrument.to_content()
    kind = experiment.medium.get("kind", "snow")
    common = [hash_physics_sources(), instrument, accuracy.model_dump(), seed, kind]
    return common, [
        [replace_table_paths(settings, identify_by_content), incidence]
        for _, settings, incidence in experiment.iter_settings()
    ]


def _group_by_shared_paths(
    experiment: SimulationConfig, points: Sequence[Point], accuracy: Accuracy
) -> list[tuple[list[int], MediaGroup | None]]:
    """Return the indices of points that share paths, with their group (None for single points)."""
    instrument = experiment.instrument
    if instrument.kind != "spectrophotometer" or instrument.get("estimator") == "analog":
        return [([index], None) for index in range(len(points))]
    wavelengths = np.asarray(instrument.get_wavelengths(), dtype=float)
    solved = []
    for index, (labels, medium, _) in enumerate(points):
        max_stderr = instrument.select_point(index).scale_stderr(accuracy.max_stderr)
        with experiment.locate_errors(labels):
            check_medium(medium, allow_semi_infinite=True)
            if instrument.choose_solver([medium], max_stderr) == DISCRETE_ORDINATES:
                solved.append(index)
    groups: list[tuple[list[int], MediaGroup | None]] = [([index], None) for index in solved]
    traced = [index for index in range(len(points)) if index not in set(solved)]
    for beam in dict.fromkeys(incidence for *_, incidence in points):
        same_beam = [index for index in traced if points[index][-1] == beam]
        media = [points[index][1] for index in same_beam]
        with experiment.locate_errors(points[0][0]):
            shared = group_by_shared_paths(media, wavelengths)
        for members in shared:
            indices = [same_beam[index] for index in members.positions]
            groups.append((indices, members if len(indices) > 1 else None))
    return sorted(groups, key=lambda group: min(group[0]))


def _simulate_group(
    instrument: Instrument,
    points: Sequence[Point],
    group: MediaGroup,
    error: float,
    accuracy: Accuracy,
    run: RunOptions,
) -> list[xr.Dataset]:
    """Simulate points that share paths to the smallest of their target errors.

    The points are in the order of the group's media.
    """
    rays = accuracy.max_rays or MAX_RAYS
    wavelengths, (_, medium, beam) = instrument.get_wavelengths(), points[0]
    request = SpectralRequest(wavelengths, beam, error, rays, run)
    inputs = list_section_inputs(instrument.kind)
    stokes = inputs["stokes"].check("stokes", instrument.get("stokes"))
    request = request._replace(polarization=check_stokes(stokes, medium, beam))
    spectra = simulate_spectra(group.path_sharing, request)
    relabelled = []
    for index, (_, medium, _) in zip(group.media_indices, points, strict=True):
        # The spectrum may be that of an optically equivalent medium.
        spectrum, prefix = spectra[index], f"{medium.kind}_"
        attributes = {key: v for key, v in spectrum.attrs.items() if not key.startswith(prefix)}
        attributes |= {f"{prefix}{key}": value for key, value in medium.describe().items()}
        relabelled.append(
            xr.Dataset(spectrum.data_vars, spectrum.coords, to_netcdf_attributes(attributes))
        )
    return relabelled


def _format_prefix(name: str, points: Sequence[Point], indices: Sequence[int]) -> str:
    """Return the prefix of log lines on some points."""
    if len(indices) > 1:
        return f"{name} {len(indices)} of {len(points)} together, from {min(indices) + 1}"
    (index,) = indices
    point_labels = " ".join(f"{p}={label}" for p, label in points[index][0].items())
    return f"{name} {index + 1}/{len(points)} {point_labels}".rstrip()


def _log_progress(prefix: str, log: LogCallback, progress: Progress) -> None:
    """Log the progress of a simulation."""
    if math.isinf(progress.stderr):
        log(f"{prefix}: first round, {progress.rays} rays")
    else:
        log(
            f"{prefix}: {progress.rays} rays this round, error {progress.stderr:.4f} so far "
            f"(target {progress.target:g}), about {progress.seconds_left:.0f} s left here"
        )


def _log_result(prefix: str, datasets: Sequence[xr.Dataset], log: LogCallback) -> None:
    """Log the result of some points."""
    attributes = datasets[0].attrs
    reached = [
        f", error {max(dataset.attrs[key] for dataset in datasets):.4f}"
        for key in REACHED_ATTRIBUTES
        if key in attributes
    ]
    is_solved = attributes.get("solver") == DISCRETE_ORDINATES
    effort = "discrete ordinates" if is_solved else f"{attributes['rays']} rays"
    log(f"{prefix}: done, {effort}{''.join(reached)}, {attributes['wall_time_s']:.1f} s")


def simulate_point(
    instrument: Instrument, point: Point, accuracy: Accuracy, run: RunOptions
) -> xr.Dataset:
    """Simulate one point of a grid, see `run`."""
    _, medium, incidence = point
    measure = FUNCTIONS[instrument.kind]
    settings: dict[str, Any] = instrument.list_arguments() | {
        "incidence_deg": incidence,
        "max_stderr": instrument.scale_stderr(accuracy.max_stderr),
        "relative_stderr": instrument.scale_stderr(accuracy.relative_stderr),
        "max_rays": accuracy.max_rays,
        "seed": run.seed,
        "threads": run.threads,
        "progress": run.progress,
    }
    takes = list(signature(measure).parameters)
    scale = instrument.get("stderr_scale")
    if scale is not None and {"max_stderr", "relative_stderr"}.isdisjoint(takes):
        # The error of a beam follows from the number of its rays.
        effort = (0.02 / (scale * accuracy.relative_stderr)) ** 2
        settings.setdefault("rays", int(np.ceil(N_BEAM_RAYS * effort)))
    given = {key: value for key, value in settings.items() if key in takes and value is not None}
    return measure(medium, **given)
