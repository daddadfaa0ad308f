"""Execution of an experiment: all points of its grid as one labelled dataset."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.atomic import check_writable
from splits.core.convergence import REACHED_ATTRIBUTES, log_missed_error
from splits.core.progress import LogCallback
from splits.core.provenance import hash_physics_sources
from splits.core.validation import invalid
from splits.experiments.config.accuracy import Accuracy
from splits.experiments.config.beam_instruments import ReturnTable
from splits.experiments.config.grid import make_grid_coordinates
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run_points import SimulatedPoints, simulate_points
from splits.experiments.run_table import run_table, write_table
from splits.io.cache import NO_CACHE, Cache
from splits.io.netcdf import make_provenance, save, to_netcdf_attributes
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.stopping_rule import STOP_REASONS
from splits.tables.return_table import TITLE

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
    if experiment.fit:
        hint = "use splits.experiments.run_fit.run_fit"
        raise invalid("fit", experiment.fit.measured, "left out", hint)
    if experiment.is_in_parts:
        return run_table(experiment, accuracy, seed, None, threads, log)
    if experiment.instrument.kind == "refractive_index":
        return compute_refractive_indices(experiment)
    start_time = time.perf_counter()
    results = simulate_points(experiment, accuracy, seed, threads, log, cache)
    dataset = _stack_points(experiment, results, time.perf_counter() - start_time)
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
        return
    cache = Cache(folder, "point")
    save(run(experiment, accuracy, seed, threads, log, cache), path)
    cache.delete()


def _stack_points(
    experiment: SimulationConfig, points: SimulatedPoints, seconds: float
) -> xr.Dataset:
    """Return the dataset of a grid from its points."""
    results = points.datasets
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
    is_return_table = isinstance(experiment.instrument, ReturnTable)
    attributes = {
        **constant,
        "title": TITLE if is_return_table else f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "configuration": experiment.dump_configuration(),
        "rays": points.rays,
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
    wavelength = experiment.instrument.get_wavelengths()
    index = medium.compute_refractive_indices(wavelength)
    variables = {
        "n": (("wavelength", "material"), index.real, {"long_name": "refractive index"}),
        "k": (("wavelength", "material"), index.imag, {"long_name": "extinction coefficient"}),
    }
    for _, _, variable_attributes in variables.values():
        variable_attributes["units"] = "1"
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelength),
        "material": ("material", list(medium.list_materials()), {"long_name": "material"}),
    }
    attributes = {
        "title": f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "configuration": experiment.dump_configuration(),
        **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
        "physics_sources_sha256": hash_physics_sources(),
        **make_provenance(f"experiment {experiment.name}"),
    }
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(attributes))
