"""Fits as experiments: every sample of a measured table, at every point of the grid."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import check_choice, check_range, invalid, key_prefix
from splits.experiments.config.grid import make_grid_coordinates
from splits.experiments.config.settings import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.residual_covariance import MIN_RESIDUAL_DOF
from splits.retrieval.sand_fit import Effort, FitResult, fit
from splits.retrieval.sand_parameters import UnitCube
from splits.simulation.arguments import check_wavelengths
from splits.simulation.attributes import make_wavelength_coordinate
from splits.simulation.threads import DaemonThreadPool, count_cpus


def run_fit(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    measured: pd.DataFrame,
    seed: int = 1,
    threads: int | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> xr.Dataset:
    """Fit a sand to every sample of a measured table, for every point of an experiment's grid.

    Parameters
    ----------
    experiment : SimulationConfig
        With a ``fit`` section.
    accuracy : Accuracy
        ``max_stderr`` is that of the last spectrum; a fit's effort shrinks when it is coarse.
    measured : pandas.DataFrame
        Column ``wavelength_nm`` and one of reflectances per sample.
    seed, threads, say
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
        For a sample that the table does not have.
    """
    begun = time.perf_counter()
    samples = check_fit(experiment, measured)
    ranges = experiment.fit.ranges if experiment.fit else {}
    wavelength = measured.wavelength_nm.to_numpy(dtype=float)
    max_stderr = min(experiment.instrument.stderr_scale * accuracy.max_stderr, 0.5)
    cases = list(itertools.product(experiment.iter_settings(), samples))
    workers = threads or count_cpus()

    def one(number: int) -> FitResult:
        (labels, settings, incidence), sample = cases[number]
        where = " ".join([*(f"{p}={label}" for p, label in labels.items()), sample])
        head = f"{experiment.name} {number + 1}/{len(cases)} {where}"
        return fit(
            settings,
            wavelength,
            measured[sample].to_numpy(dtype=float),
            incidence,
            ranges,
            seed if experiment.instrument.seed is None else experiment.instrument.seed,
            max(1, workers // len(cases)),
            lambda line: log(f"{head}: {line}"),
            effort=choose_effort(max_stderr),
        )

    # Simulations of a fit are short: whole fits side by side keep more threads busy than theirs.
    with DaemonThreadPool(min(workers, len(cases))) as pool:
        results = list(pool.map(one, range(len(cases))))
    return _make_fit_dataset(experiment, results, samples, wavelength, max_stderr, begun)


def check_fit(experiment: SimulationConfig, measured: pd.DataFrame) -> list[str]:
    """Return the samples to fit, or refuse what cannot be fitted.

    Raises
    ------
    ValueError
        For a table without wavelengths or with too few, a sample that it does not have,
        reflectances outside [0, 1], wavelengths without refractive indices, or keywords that the
        fit varies itself.
    """
    section = experiment.fit
    if section is None:
        raise invalid("fit", None, "a section that names a measured table")
    if "wavelength_nm" not in measured:
        raise invalid(
            "fit.measured", list(measured.columns), "a table, by commas, with column wavelength_nm"
        )
    known = [str(c) for c in measured.columns if c != "wavelength_nm"]
    samples = [check_choice("fit.samples", s, known) for s in section.samples] or known
    with key_prefix("fit.measured"):
        wavelength = check_wavelengths(measured.wavelength_nm.tolist())
    for sample in samples:
        for x, value in zip(wavelength, measured[sample], strict=True):
            key = f"fit.measured ({sample} at {x:g} nm)"
            check_range(key, value, 0.0, 1.0, hint="a share, not per cent, without gaps")
    for labels, settings, _ in experiment.iter_settings():
        with experiment.locate_errors(labels):
            cube = UnitCube(settings, section.ranges)
        with key_prefix("fit.measured"):
            cube.to_sand(np.full(len(cube.names), 0.5)).compute_refractive_indices(wavelength)
        least = len(cube.names) + MIN_RESIDUAL_DOF
        if wavelength.size < least:
            raise invalid("fit.measured", f"{wavelength.size} wavelengths", f"{least} at least")
    return samples


def choose_effort(max_stderr: float) -> Effort:
    """Return the effort that suits an accuracy: a coarse one asks for a quick look only."""
    if max_stderr <= 0.005:
        return Effort(max_stderr=max_stderr)
    return Effort(
        points=32, starts=(2, 1), evaluations=(20, 20), rays=(512, 512, 512), max_stderr=max_stderr
    )


def _make_batch_variables(
    dims: tuple[str, ...], deviations: list[xr.DataArray], shape: tuple[int, ...]
) -> dict[str, Variable]:
    """Return how errors of modelled reflectance go together, see `splits.core.uncertainty`."""
    values = np.stack([one.values for one in deviations]).reshape(*shape, *deviations[0].shape)
    tail = (str(d) for d in deviations[0].dims)
    return {"reflectance_batches": ((*dims, *tail), values, dict(deviations[0].attrs))}


def _make_fit_coordinates(
    experiment: SimulationConfig, result: FitResult, samples: list[str], wavelength: np.ndarray
) -> dict[str, Any]:
    """Return the coordinates of a dataset of fits like this one."""
    names = list(result.names)
    return {
        "wavelength": make_wavelength_coordinate(wavelength),
        "sample": ("sample", samples, {"long_name": "sample measured"}),
        "parameter": ("parameter", list(result.parameters), {"long_name": "parameter of the sand"}),
        **{
            axis: (axis, names, {"long_name": "coordinate of the fit"})
            for axis in ("coordinate", "other_coordinate")
        },
        **make_grid_coordinates(experiment.grid),
    }


def _make_fit_dataset(
    experiment: SimulationConfig,
    results: list[FitResult],
    samples: list[str],
    wavelength: np.ndarray,
    max_stderr: float,
    start_time: float,
) -> xr.Dataset:
    """Return all fits as one dataset."""
    shape = (*(len(values) for values in experiment.grid.values()), len(samples))
    dims = (*experiment.grid, "sample")
    first = results[0]
    parameters = list(first.parameters)

    def stacked(values: list[Any], *tail: int) -> np.ndarray:
        return np.array(values, dtype=float).reshape(*shape, *tail)

    def per_parameter(what: str) -> np.ndarray:
        values = [[float(getattr(r.parameters[p], what)) for p in parameters] for r in results]
        return stacked(values, len(parameters))

    spectrum, count = (*dims, "wavelength"), len(wavelength)
    over = (*dims, "parameter")
    square = (*dims, "coordinate", "other_coordinate")
    modelled = stacked([r.modelled for r in results], count)
    error = stacked([r.modelled_stderr for r in results], count)
    measured = stacked([r.measured for r in results], count)
    value, value_error, told = map(per_parameter, ("value", "stderr", "constrained"))
    related = stacked([r.correlation for r in results], len(first.names), len(first.names))
    rmse, rmse_error, tried = (
        stacked([getattr(r, name) for r in results])
        for name in ("rmse", "rmse_stderr", "evaluations")
    )
    narrowed = "1 where the spectrum narrows the parameter to below half of its range"
    variables: dict[str, Variable] = {
        **make_variable("reflectance", spectrum, modelled, error, "modelled reflectance"),
        **_make_batch_variables(dims, [r.spectrum.reflectance_batches for r in results], shape),
        **make_variable("measured", spectrum, measured, None, "measured reflectance"),
        **make_variable("value", over, value, value_error, "fitted parameter"),
        **make_variable("constrained", over, told, None, narrowed),
        **make_variable(
            "correlation", square, related, None, "correlation of the fit's coordinates"
        ),
        **make_variable("rmse", dims, rmse, rmse_error, "root mean square misfit"),
        **make_variable("evaluations", dims, tried, None, "number of sands simulated"),
    }
    coordinates = _make_fit_coordinates(experiment, first, samples, wavelength)
    facts = {
        "title": f"Experiment {experiment.name}",
        "experiment": experiment.name,
        "medium": "sand",
        "configuration": experiment.dump_configuration(),
        "max_stderr": max_stderr,
        "wall_time_s": round(time.perf_counter() - start_time, 3),
        "physics_sources_sha256": hash_physics_sources(fit=True),
        **make_provenance(f"experiment {experiment.name}"),
    }
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(facts))
