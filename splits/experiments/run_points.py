"""Simulation of the points of an experiment's grid, with path reuse between points."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.convergence import REACHED_ATTRIBUTES, nest_runs
from splits.core.progress import LogCallback, Progress
from splits.core.provenance import hash_physics_sources
from splits.experiments.config.accuracy import Accuracy
from splits.experiments.config.beam_instruments import BeamSpread, DelayInstrument, ReturnTable
from splits.experiments.config.instrument import Instrument, OpticalInstrument
from splits.experiments.config.instrument_kinds import Goniophotometer, Spectrophotometer
from splits.experiments.config.medium import identify_by_content, replace_table_paths
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.config.surface_instruments import Lens
from splits.instruments import (
    beam_spread,
    goniophotometer,
    lens,
    spectrophotometer,
    surface_map,
    time_of_flight,
)
from splits.instruments.solver import DISCRETE_ORDINATES
from splits.instruments.spectral_run import SpectralRequest, simulate_spectra
from splits.io.cache import NO_CACHE, Cache
from splits.io.netcdf import to_netcdf_attributes
from splits.media.medium import Medium
from splits.simulation.path_reuse import MediaGroup, group_by_shared_paths
from splits.simulation.run_options import RunOptions
from splits.tables.return_table import build_return_table

N_BEAM_RAYS = 200_000
"""Number of rays of a beam at a relative standard error of 0.02."""
MAX_RAYS = 20_000_000

GridPoint = tuple[dict[str, str], Medium, float | str]


class SimulatedPoints(NamedTuple):
    """Results of all points of a grid in their order, and number of rays; points may share rays."""

    datasets: list[xr.Dataset]
    rays: int


def simulate_points(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    threads: int | None,
    log: LogCallback,
    cache: Cache = NO_CACHE,
) -> SimulatedPoints:
    """Simulate all points of an experiment that the cache lacks, see `splits.experiments.run.run`.

    Paths are reused between points that differ only in absorption, in the albedo of a ground, or in
    a common scale of all lengths.
    """
    instrument, points = experiment.instrument, list(experiment.iter_points())
    seed = instrument.get_seed(seed)
    results: dict[int, xr.Dataset] = {}
    rays = 0
    groups = _group_by_shared_paths(instrument, points, accuracy)
    if len(groups) < len(points):
        log(f"{experiment.name}: {len(groups)} sets of paths for {len(points)} points")
    common_key, point_keys = list_point_keys(experiment, accuracy, seed)

    @functools.lru_cache(maxsize=1)
    def simulate(number: int) -> list[xr.Dataset]:
        indices, group = groups[number]
        progress = _make_progress_callback(_format_prefix(experiment.name, points, indices), log)
        run = RunOptions.from_arguments(seed, threads, progress=progress)
        members = [points[index] for index in indices]
        with nest_runs():
            if group is None:
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
    return SimulatedPoints([results[index] for index in range(len(points))], rays)


def list_point_keys(
    experiment: SimulationConfig, accuracy: Accuracy, seed: int
) -> tuple[list[Any], list[Any]]:
    """Return all that determines the results of all points, and that of each point."""
    instrument = experiment.instrument.model_dump(mode="json")
    kind = experiment.medium.get("kind", "snow")
    common = [hash_physics_sources(), instrument, accuracy.model_dump(), seed, kind]
    return common, [
        [replace_table_paths(settings, identify_by_content), incidence]
        for _, settings, incidence in experiment.iter_settings()
    ]


def _group_by_shared_paths(
    instrument: Instrument, points: Sequence[GridPoint], accuracy: Accuracy
) -> list[tuple[list[int], MediaGroup | None]]:
    """Return the indices of points that share paths, with their group (None for single points)."""
    if not isinstance(instrument, Spectrophotometer) or instrument.estimator == "analog":
        return [([index], None) for index in range(len(points))]
    wavelengths = np.asarray(instrument.get_wavelengths(), dtype=float)
    solved = []
    for index, (_, medium, _) in enumerate(points):
        max_stderr = instrument.select_point(index).scale_stderr(accuracy.max_stderr)
        if instrument.choose_solver(medium, max_stderr) == DISCRETE_ORDINATES:
            solved.append(index)
    groups: list[tuple[list[int], MediaGroup | None]] = [([index], None) for index in solved]
    traced = [index for index in range(len(points)) if index not in set(solved)]
    for beam in dict.fromkeys(incidence for *_, incidence in points):
        same_beam = [index for index in traced if points[index][-1] == beam]
        media = [points[index][1] for index in same_beam]
        for members in group_by_shared_paths(media, wavelengths):
            indices = [same_beam[index] for index in members.positions]
            groups.append((indices, members if len(indices) > 1 else None))
    return sorted(groups, key=lambda group: min(group[0]))


def _simulate_group(
    instrument: Instrument,
    points: Sequence[GridPoint],
    group: MediaGroup,
    error: float,
    accuracy: Accuracy,
    run: RunOptions,
) -> list[xr.Dataset]:
    """Simulate points that share paths to the smallest of their target errors.

    The points are in the order of the group's media.
    """
    rays = accuracy.max_rays or MAX_RAYS
    wavelengths, (_, _, beam) = instrument.get_wavelengths(), points[0]
    request = SpectralRequest.from_arguments(wavelengths, beam, error, rays, run)
    spectra = simulate_spectra(group.path_sharing, request)
    pairs = zip(group.media_indices, points, strict=True)
    return [_relabel_spectrum(spectra[index], medium) for index, (_, medium, _) in pairs]


def _relabel_spectrum(spectrum: xr.Dataset, medium: Medium) -> xr.Dataset:
    """Return a spectrum with the attributes of an optically equivalent medium."""
    prefix = f"{medium.kind}_"
    attributes = {f"{prefix}{key}": value for key, value in medium.describe().items()}
    others = {key: value for key, value in spectrum.attrs.items() if not key.startswith(prefix)}
    return xr.Dataset(
        spectrum.data_vars, spectrum.coords, to_netcdf_attributes(others | attributes)
    )


def _format_prefix(name: str, points: Sequence[GridPoint], indices: Sequence[int]) -> str:
    """Return the prefix of log lines on some points."""
    if len(indices) > 1:
        return f"{name} {len(indices)} of {len(points)} together, from {min(indices) + 1}"
    (index,) = indices
    point_labels = " ".join(f"{p}={label}" for p, label in points[index][0].items())
    return f"{name} {index + 1}/{len(points)} {point_labels}".rstrip()


def _make_progress_callback(prefix: str, log: LogCallback) -> Callable[[Progress], None]:
    """Return a callback that logs progress."""

    def show(progress: Progress) -> None:
        if math.isinf(progress.stderr):
            log(f"{prefix}: first round, {progress.rays} rays")
            return
        log(
            f"{prefix}: {progress.rays} rays this round, error {progress.stderr:.4f} so far "
            f"(target {progress.target:g}), about {progress.seconds_left:.0f} s left here"
        )

    return show


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
    instrument: Instrument, point: GridPoint, accuracy: Accuracy, run: RunOptions
) -> xr.Dataset:
    """Simulate one point of a grid, see `splits.experiments.run.run`."""
    _, medium, incidence = point
    arguments = {"seed": run.seed, **instrument.list_arguments()}
    if not isinstance(instrument, OpticalInstrument):
        measure: Callable[..., xr.Dataset] = lens if isinstance(instrument, Lens) else surface_map
        return measure(medium, **arguments)
    arguments |= {"threads": run.threads, "progress": run.progress}
    scene: tuple[Any, ...] = (medium, instrument.get_wavelengths(), incidence)
    if isinstance(instrument, BeamSpread | DelayInstrument):
        effort = (0.02 / (instrument.stderr_scale * accuracy.relative_stderr)) ** 2
        arguments.setdefault("rays", int(np.ceil(N_BEAM_RAYS * effort)))
        if isinstance(instrument, ReturnTable):
            one_point = {"point": [0.0]}
            table = build_return_table(lambda point: medium, one_point, *scene[1:], **arguments)
            return table.isel(point=0, drop=True)
        measure = beam_spread if isinstance(instrument, BeamSpread) else time_of_flight
        return measure(*scene, **arguments)
    if accuracy.max_rays is not None:
        arguments["max_rays"] = accuracy.max_rays
    if isinstance(instrument, Goniophotometer):
        arguments["relative_stderr"] = instrument.scale_stderr(accuracy.relative_stderr)
        return goniophotometer(*scene, **arguments)
    arguments["max_stderr"] = instrument.scale_stderr(accuracy.max_stderr)
    return spectrophotometer(*scene, **arguments)
