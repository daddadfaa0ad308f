"""Running an experiment: every point of its grid, one labelled dataset."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.checks import refuse
from splits.dataset import attributes, provenance, save
from splits.experiments.coordinates import grid_coordinates
from splits.experiments.kept_points import KeptPoints
from splits.experiments.run_points import REACHED, Measured, Say, measured_points
from splits.experiments.run_table import run_table, write_table
from splits.experiments.settings import Accuracy
from splits.experiments.simulation import Simulation
from splits.files import check_writable
from splits.instruments.labels import wavelength_axis
from splits.sources import physics_digest

POINT_FACTS = {
    "rays": ("number of rays traced", "1"),
    "max_stderr_reached": ("largest standard error reached", "1"),
    "relative_stderr_reached": ("largest relative standard error reached", "1"),
    "mean_grain_distance": ("mean distance between grains along a ray", "m"),
    "specific_surface_area": ("surface area of the grains per mass", "m2 kg-1"),
}
_PER_MEDIUM = {
    "mean_grain_distance": "mean_grain_distance_m",
    "specific_surface_area": "specific_surface_area_m2_kg",
}


def run(
    experiment: Simulation,
    accuracy: Accuracy,
    seed: int = 1,
    threads: int | None = None,
    log: Say = lambda line: None,
) -> xr.Dataset:
    """Run all points of an experiment's grid.

    Parameters
    ----------
    experiment : Simulation
    accuracy : Accuracy
        Errors and limits; an instrument's ``error_factor`` multiplies the error.
    seed : int
        Used unless the experiment's instrument gives its own; every point of a grid uses the
        same, so that differences along the grid are smooth.
    threads : int, optional
    say : callable
        Receives lines of progress.

    Returns
    -------
    xarray.Dataset
        The instrument's variables over the grid's parameters and wavelength.
    """
    if experiment.fit:
        hint = "splits.experiments.run_fit.run_fit fits sands"
        raise refuse("fit", experiment.fit.measured, "left out", hint)
    if experiment.instrument.kind == "refractive_index":
        return refractive_indices(experiment)
    if experiment.instrument.kind == "table":
        return run_table(experiment, accuracy, seed, None, threads, log)
    return _points(experiment, accuracy, seed, threads, log)


def write_run(
    experiment: Simulation,
    accuracy: Accuracy,
    seed: int,
    folder: Path,
    path: Path,
    threads: int | None = None,
    log: Say = lambda line: None,
) -> None:
    """Write what `run` returns; a run that is interrupted goes on where it stopped.

    Parameters
    ----------
    experiment, accuracy, seed, threads, say
        As for `run`.
    folder : path
        Keeps what was measured: points until the file is written, blocks of a table for good.
    path : path
        The file appears whole or not at all.
    """
    check_writable(path)
    if experiment.instrument.kind == "table":
        write_table(experiment, accuracy, seed, folder, path, threads, log)
    elif experiment.instrument.kind == "refractive_index":
        save(refractive_indices(experiment), path)
    else:
        kept = KeptPoints(folder, experiment, accuracy, seed)
        save(_points(experiment, accuracy, seed, threads, log, kept), path)
        kept.delete()


def _points(
    experiment: Simulation,
    accuracy: Accuracy,
    seed: int,
    threads: int | None,
    log: Say,
    cache: KeptPoints | None = None,
) -> xr.Dataset:
    """Return the points of a grid, those not kept measured."""
    begun = time.perf_counter()
    results = measured_points(experiment, accuracy, seed, threads, log, cache)
    return _stack(experiment, results, time.perf_counter() - begun)


def _stack(experiment: Simulation, points: Measured, seconds: float) -> xr.Dataset:
    """Return the points of a grid as one dataset."""
    results = points.datasets
    shape = tuple(len(values) for values in experiment.grid.values())
    dims = tuple(experiment.grid)
    first = results[0]
    variables: dict[str, Any] = {}
    common = [n for n in first.data_vars if all(n in r.data_vars for r in results)]
    for name, variable in first[common].data_vars.items():
        stacked = np.stack([r[name].values for r in results]).reshape(*shape, *variable.shape)
        variables[str(name)] = ((*dims, *variable.dims), stacked, variable.attrs)
    for name, (long_name, units) in POINT_FACTS.items():
        key = f"{first.attrs['medium']}_{_PER_MEDIUM[name]}" if name in _PER_MEDIUM else name
        if key not in first.attrs:
            continue
        values = np.array([float(r.attrs[key]) for r in results]).reshape(shape)
        variables[name] = (dims, values, {"long_name": long_name, "units": units})
    coordinates: dict[str, Any] = {str(name): first[name] for name in first.coords}
    coordinates |= grid_coordinates(experiment.grid)
    varying = {f"{first.attrs['medium']}_{p}" for p in dims} | {"incidence_deg"} & set(dims)
    constant = {
        key: value
        for key, value in first.attrs.items()
        if key not in varying
        and all(key in r.attrs and np.array_equal(r.attrs[key], value) for r in results)
    }
    facts = {
        **constant,
        "title": f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "configuration": experiment.dump_configuration(),
        "rays": points.rays,
        **{key: max(float(r.attrs[key]) for r in results) for key in REACHED if key in first.attrs},
        "wall_time_s": round(seconds, 3),
        **provenance(f"experiment {experiment.name}"),
    }
    if "stopped_by" in first.attrs:
        reasons = {r.attrs["stopped_by"] for r in results}
        facts["stopped_by"] = next(r for r in ("degree", "rays", "detail", "error") if r in reasons)
    return xr.Dataset(variables, coordinates, attributes(facts))


def refractive_indices(experiment: Simulation) -> xr.Dataset:
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
        "wavelength": wavelength_axis(wavelength),
        "material": ("material", list(medium.list_materials()), {"long_name": "material"}),
    }
    facts = {
        "title": f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "configuration": experiment.dump_configuration(),
        **{f"{medium.kind}_{key}": value for key, value in medium.describe().items()},
        "physics_sources_sha256": physics_digest(),
        **provenance(f"experiment {experiment.name}"),
    }
    return xr.Dataset(variables, coordinates, attributes(facts))
