"""Execution of fits: every sample of a measured table at every point of the grid."""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.inputs import check_wavelengths
from splits.core.process import count_cpus
from splits.core.progress import LogCallback
from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import check_range, invalid, key_prefix
from splits.experiments.config.media import make_grid_coordinates
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run_retrieve import list_samples
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.least_squares import MIN_RESIDUAL_DOF
from splits.retrieval.sand_fit import Effort, FitResult, UnitCube, fit
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.threads import DaemonThreadPool

MAX_GOOD_RMSE = 0.03
"""Root-mean-square error below which SPLITS section 5.1.1 calls a reconstruction good."""
UNDETERMINED_VERDICT = "undetermined: the error exceeds half of the error from the range alone"
FIT_VARIABLES = {
    "reflectance": (("wavelength",), "modelled", "modelled_stderr", "modelled reflectance"),
    "measured": (("wavelength",), "measured", "", "measured reflectance"),
    "value": (("parameter",), "value", "stderr", "fitted parameter"),
    "constrained": (
        ("parameter",), "constrained", "",
        "1 where the spectrum narrows the parameter to below half of its range",
    ),
    "correlation": (
        ("coordinate", "other_coordinate"), "correlation", "",
        "correlation of the fit's coordinates",
    ),
    "rmse": ((), "rmse", "rmse_stderr", "root mean square misfit"),
    "evaluations": ((), "evaluations", "", "number of sands simulated"),
}  # fmt: skip
"""Variables over samples: other dimensions, attributes of a fit (value, error) and long name."""


def run_fit(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    measured: pd.DataFrame,
    seed: int = 1,
    threads: int | None = None,
    log: LogCallback = lambda line: None,
) -> xr.Dataset:
    """Fit a sand to every sample of a measured table, for every point of an experiment's grid.

    Parameters
    ----------
    experiment : SimulationConfig
        With a ``fit`` section.
    accuracy : Accuracy
        ``max_stderr`` is that of the final spectrum; a coarse one reduces the effort of the fit.
    measured : pandas.DataFrame
        Column ``wavelength_nm`` and one of reflectances per sample.
    seed, threads, log
        As for `splits.experiments.run.run`.

    Returns
    -------
    xarray.Dataset
        Over the grid's parameters and ``sample``: ``reflectance``, its error and ``measured`` over
        wavelength; ``rmse``; ``value``, ``value_stderr`` and ``constrained`` over ``parameter``;
        ``correlation`` over ``coordinate`` twice.

    Raises
    ------
    ValueError
        For a sample that is not in the table.
    """
    start_time = time.perf_counter()
    samples = check_fit(experiment, measured)
    ranges = experiment.fit.ranges if experiment.fit else {}
    wavelength = measured.wavelength_nm.to_numpy(dtype=float)
    max_stderr = experiment.instrument.scale_stderr(accuracy.max_stderr)
    cases = list(itertools.product(experiment.iter_settings(), samples))
    workers = threads or count_cpus()
    fit_seed, fit_threads = experiment.instrument.get_seed(seed), max(1, workers // len(cases))
    effort = choose_effort(max_stderr)

    def fit_case(number: int) -> FitResult:
        (labels, settings, incidence), sample = cases[number]
        point = " ".join([*(f"{p}={label}" for p, label in labels.items()), sample])
        prefix = f"{experiment.name} {number + 1}/{len(cases)} {point}"
        reflectance = measured[sample].to_numpy(dtype=float)
        return fit(
            settings, wavelength, reflectance, incidence, ranges=ranges, effort=effort,
            seed=fit_seed, threads=fit_threads, log=lambda line: log(f"{prefix}: {line}"),
        )  # fmt: skip

    # Simulations of a fit are short, so parallel fits use threads better than parallel rays.
    with DaemonThreadPool(min(workers, len(cases))) as pool:
        results = list(pool.map(fit_case, range(len(cases))))
    return _make_fit_dataset(experiment, results, samples, wavelength, max_stderr, start_time)


def check_fit(experiment: SimulationConfig, measured: pd.DataFrame) -> list[str]:
    """Return the samples to fit; reject data that cannot be fitted.

    Raises
    ------
    ValueError
        For a table without wavelengths or with too few, an unknown sample, reflectances outside
        [0, 1], wavelengths without refractive indices, or keywords that the fit varies.
    """
    section = experiment.fit
    if section is None:
        raise invalid("fit", None, "a section that names a measured table")
    samples = list_samples("fit", measured, section.samples)
    with key_prefix("fit.measured"):
        wavelength = check_wavelengths("wavelength_nm", measured.wavelength_nm.tolist())
    for sample in samples:
        for x, value in zip(wavelength, measured[sample], strict=True):
            key = f"fit.measured ({sample} at {x:g} nm)"
            check_range(key, value, 0.0, 1.0, hint="a fraction, not per cent, without gaps")
    for labels, settings, _ in experiment.iter_settings():
        with experiment.locate_errors(labels):
            cube = UnitCube(settings, section.ranges)
        with key_prefix("fit.measured"):
            cube.to_sand(np.full(len(cube.names), 0.5)).compute_refractive_indices(wavelength)
        min_wavelengths = len(cube.names) + MIN_RESIDUAL_DOF
        if wavelength.size < min_wavelengths:
            given, allowed = f"{wavelength.size} wavelengths", f"{min_wavelengths} at least"
            raise invalid("fit.measured", given, allowed)
    return samples


def choose_effort(max_stderr: float) -> Effort:
    """Return the effort of a fit for a target error; it is reduced for coarse ones."""
    if max_stderr <= 0.005:
        return Effort(max_stderr=max_stderr)
    return Effort(
        points=32, starts=(2, 1), evaluations=(20, 20), rays=(512, 512, 512), max_stderr=max_stderr
    )


def _make_fit_dataset(
    experiment: SimulationConfig,
    results: list[FitResult],
    samples: list[str],
    wavelength: np.ndarray,
    max_stderr: float,
    start_time: float,
) -> xr.Dataset:
    """Return the dataset of all fits."""
    dims, first = (*experiment.grid, "sample"), results[0]
    shape = (*(len(values) for values in experiment.grid.values()), len(samples))
    names, parameters = list(first.names), list(first.parameters)

    def stack(values: list[Any], dtype: Any = float) -> np.ndarray:
        stacked = np.array(values, dtype=dtype)
        return stacked.reshape(*shape, *stacked.shape[1:])

    def collect(attribute: str, inner_dims: tuple[str, ...]) -> np.ndarray:
        if inner_dims != ("parameter",):
            return stack([getattr(result, attribute) for result in results])
        return stack([[getattr(r.parameters[p], attribute) for p in parameters] for r in results])

    batches = [result.spectrum.reflectance_batches for result in results]
    deviations = stack([array.values for array in batches], batches[0].dtype)
    variables: dict[str, Variable] = {
        "reflectance_batches": ((*dims, *map(str, batches[0].dims)), deviations, batches[0].attrs)
    }
    for name, (inner_dims, attribute, error_attribute, long_name) in FIT_VARIABLES.items():
        values = collect(attribute, inner_dims)
        error = collect(error_attribute, inner_dims) if error_attribute else None
        variables |= make_variable(name, (*dims, *inner_dims), values, error, long_name)
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelength),
        "sample": ("sample", samples, {"long_name": "sample measured"}),
        "parameter": ("parameter", parameters, {"long_name": "parameter of the sand"}),
        "coordinate": ("coordinate", names, {"long_name": "coordinate of the fit"}),
        "other_coordinate": ("other_coordinate", names, {"long_name": "coordinate of the fit"}),
        **make_grid_coordinates(experiment.grid),
    }
    attributes = {
        "title": f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "medium": "sand",
        "configuration": experiment.dump_configuration(),
        "max_stderr": max_stderr,
        "wall_time_s": round(time.perf_counter() - start_time, 3),
        "physics_sources_sha256": hash_physics_sources(fit=True),
        **make_provenance(f"experiment {experiment.name}"),
    }
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(attributes))


def make_fit_table(dataset: xr.Dataset) -> pd.DataFrame:
    """Return a row per sample, point of the grid and parameter, with two verdicts.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `run_fit`.

    Returns
    -------
    pandas.DataFrame
        The labels, value, value_stderr; ``verdict``, whether the parameter is constrained;
        ``spectrum``, whether the fit reproduces it; rmse, rmse_stderr.
    """
    names = ["value", "value_stderr", "constrained", "rmse", "rmse_stderr"]
    table = dataset[names].to_dataframe().reset_index()
    verdict = np.where(table.pop("constrained") > 0.5, "constrained", UNDETERMINED_VERDICT)
    table.insert(table.columns.get_loc("rmse"), "verdict", verdict)
    spectrum = np.where(table.rmse < MAX_GOOD_RMSE, "reproduced", "not reproduced")
    table.insert(table.columns.get_loc("rmse"), "spectrum", spectrum)
    return table
