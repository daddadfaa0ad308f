"""Wavelengths that inform about the axes of a table: Sobol indices, and the best bands in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure
from scipy import stats

from splits.core.escaping import escape_mathtext
from splits.core.uncertainty import make_variable
from splits.core.validation import (
    check_choice,
    check_integer,
    check_range,
    invalid,
    key_prefix,
    unknown_key,
)
from splits.illumination.bands import SENSORS, as_bands
from splits.media.parameters import describe_parameter
from splits.plotting.grammar import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    annotate_figure,
    format_parameter,
    make_subplots,
    pick_colours,
    start_at_zero,
    use_style,
)
from splits.retrieval.forward_model import TableModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector
from splits.simulation.run_options import make_wavelength_coordinate
from splits.tables.table import Table

N_REPEATS = 16
"""Number of independent estimates of Sobol indices, whose scatter gives the errors."""
MIN_STANDARD_DEVIATION = 1e-6
"""Standard deviation of reflectance below which it counts as constant."""
N_STATES = 200
"""Number of states in the ranges over which the information of bands is averaged."""


def make_sobol_indices(*, seed: int, **tables: xr.Dataset) -> tuple[pd.DataFrame, Figure]:
    """Return the Sobol indices of the axes of tables, whose names are titles, and their figure."""
    indices = {
        title: compute_sobol_indices(table, _list_numeric_axes(table), seed=seed)
        for title, table in _open_tables(tables).items()
    }
    return _concatenate(indices), draw_sobol_indices(indices)


def make_band_selection(
    *,
    seed: int,
    bands: str | None = None,
    noise: float = 0.01,
    n_bands: int = 5,
    fixed: Mapping[str, Any] | None = None,
    **tables: xr.Dataset,
) -> tuple[pd.DataFrame, Figure]:
    """Return the most informative bands for the axes of tables, whose names are titles.

    Parameters
    ----------
    seed : int
    bands : str, optional
        Sensor whose bands are candidates; by default every wavelength.
    noise : float
        Standard error of a band.
    n_bands : int
        Number of bands to select.
    fixed : mapping, optional
        Known values of axes, for the tables that have these axes.
    **tables : xarray.Dataset
    """
    opened, fixed = _open_tables(tables), dict(fixed or {})
    if bands is not None:
        check_choice("options.bands", bands, SENSORS)
    check_range("options.noise", noise, 0.0, 1.0, open_low=True)
    check_integer("options.n_bands", n_bands, 1)
    known = dict.fromkeys(axis for table in opened.values() for axis in table.axes[:-1])
    for axis in fixed:
        if axis not in known:
            raise unknown_key(f"options.fixed.{axis}", known)
    selections = {}
    for title, table in opened.items():
        axes = table.axes[:-1]
        numeric = _list_numeric_axes(table)
        for axis in axes:
            if axis not in numeric and axis not in fixed and table.dataset.sizes[axis] > 1:
                labels = ", ".join(map(str, table.dataset[axis].values))
                raise invalid(f"options.fixed.{axis}", "nothing", f"one of {labels}")
        selections[title] = select_bands(
            table,
            bands or table.dataset.wavelength.values,
            [axis for axis in numeric if axis not in fixed],
            noise,
            n_bands,
            fixed={axis: value for axis, value in fixed.items() if axis in axes},
            seed=seed,
        )
    conditions = ", ".join(f"{axis} {value}" for axis, value in fixed.items())
    note = f"Noise {noise:g}" + (f", at {conditions}" if conditions else "")
    return _concatenate(selections), draw_band_selection(selections, note)


def _list_numeric_axes(table: Table) -> list[str]:
    """Return the numeric axes of a table with more than one node."""
    axes, dataset = table.axes[:-1], table.dataset
    return [n for n in axes if dataset[n].dtype.kind == "f" and dataset[n].size > 1]


def _open_tables(datasets: Mapping[str, xr.Dataset]) -> dict[str, Table]:
    """Return tables of reflectance over two numeric axes or more by title."""
    if not datasets:
        raise invalid("inputs", {}, "at least one table by name")
    if len({name.replace("_", " ") for name in datasets}) < len(datasets):
        hint = "underscores are shown as spaces"
        raise invalid("inputs", list(datasets), "names that differ", hint)
    tables = {}
    for name, dataset in datasets.items():
        with key_prefix(f"inputs.{name}"):
            table = Table(dataset)
        numeric = _list_numeric_axes(table)
        if "reflectance" not in table.quantities or len(numeric) < 2:
            allowed = "a table of reflectance over two parameters or more"
            raise invalid(f"inputs.{name}", dataset.attrs.get("experiment", ""), allowed)
        tables[name.replace("_", " ")] = table
    return tables


def _concatenate(results: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Return results by title as rows of one table."""
    rows = [ds.to_dataframe().reset_index().assign(table=name) for name, ds in results.items()]
    return pd.concat(rows, ignore_index=True)


def compute_sobol_indices(
    table: Table, free: Sequence[str], points: int = 1024, seed: int = 1
) -> xr.Dataset:
    """Return first-order and total Sobol indices of parameters at all wavelengths of a table.

    The first-order index is the fraction of the variance of reflectance due to one parameter alone;
    the total index is the fraction that remains if all other parameters are known.  Parameters are
    independent and uniform over their ranges, in the coordinate in which reflectance is closest to
    linear: the logarithm of a size, the square root of an amount from 0 on.

    Parameters
    ----------
    table : Table
    free : sequence of str
        Axes of the table that vary, at least two; others have a single value.
    points : int
        Points of each of the 16 independent estimates, a power of 2.
    seed : int

    Returns
    -------
    xarray.Dataset
        ``first_order`` and ``total`` over ``parameter`` and ``wavelength``, and
        ``first_order_sum`` over wavelength, with standard errors of sampling; 0 where reflectance
        does not vary; its ``standard_deviation``.

    References
    ----------
    Saltelli et al. (2010), Computer Physics Communications 181, 259-270; Sobol' (2001),
    Mathematics and Computers in Simulation 55, 271-280.
    """
    state_vector = StateVector.from_ranges(free, None, get_table_ranges(table))
    wavelength = table.dataset.wavelength.values
    measurement = Measurement.from_input((wavelength, np.full(wavelength.size, 0.5)), 0.01)
    model = TableModel(table, measurement, state_vector, None)
    is_varying = model.node_values.std(axis=0) > MIN_STANDARD_DEVIATION
    n_parameters = len(state_vector.names)
    first_order, total = np.zeros((2, N_REPEATS, n_parameters, wavelength.size))
    standard_deviation = np.zeros(wavelength.size)

    def evaluate(states: np.ndarray) -> np.ndarray:
        modelled: np.ndarray = model.evaluate(np.ascontiguousarray(states.T))[:, is_varying].T
        return modelled

    if is_varying.any():
        for number in range(N_REPEATS):
            random = np.random.default_rng([seed, number])
            found = stats.sobol_indices(
                func=evaluate, n=points, dists=[stats.uniform()] * n_parameters, rng=random
            )
            first_order[number][:, is_varying] = np.reshape(found.first_order, (-1, n_parameters)).T
            total[number][:, is_varying] = np.reshape(found.total_order, (-1, n_parameters)).T
        states = np.random.default_rng(seed).random((n_parameters, 4 * points))
        standard_deviation[is_varying] = evaluate(states).std(axis=1)
    variables: dict[str, Any] = {}
    for name, rows in (
        ("first_order", first_order),
        ("total", total),
        ("first_order_sum", first_order.sum(axis=1)),
    ):
        dims = ("parameter", "wavelength") if rows.ndim == 3 else ("wavelength",)
        error = rows.std(axis=0, ddof=1) / np.sqrt(N_REPEATS)
        variables |= make_variable(name, dims, rows.mean(axis=0), error, name.replace("_", " "))
    variables["standard_deviation"] = ("wavelength", standard_deviation)
    axes = {
        "parameter": list(state_vector.names),
        "low": ("parameter", state_vector.low),
        "high": ("parameter", state_vector.high),
        "wavelength": make_wavelength_coordinate(wavelength),
    }
    return xr.Dataset(variables, axes)


def select_bands(
    table: Table,
    bands: Any,
    free: Sequence[str],
    noise: float,
    n_bands: int = 5,
    *,
    fixed: Mapping[str, Any] | None = None,
    seed: int = 1,
) -> xr.Dataset:
    """Return the most informative bands, each adding the most information to those before it.

    The information content of a set of bands is the mean over the parameter ranges of the
    information that they add to the prior (Rodgers 1996, Proceedings of SPIE 2830, 136-148).

    Parameters
    ----------
    table : Table
    bands : mapping, str or array
        As for `splits.albedo`, or a row of wavelengths (nm).
    free : sequence of str
        Axes of the table that are unknown.
    noise : float
        Standard error of a band.
    n_bands : int
        Number of bands, at most all.
    fixed : mapping
        Values of the other axes.
    seed : int
        Seed of the states over which the mean is taken.

    Returns
    -------
    xarray.Dataset
        Over ``step``: the selected ``band``, ``information_bits`` of all bands up to it with the
        standard error of the mean, and ``spread`` over ``parameter``: the posterior standard
        deviation of its coordinate relative to the prior one.
    """
    if isinstance(bands, str | Mapping):
        names = list(as_bands(bands))
        measurement = Measurement.from_input(np.full(len(names), 0.5), noise, bands)
    else:
        measurement = Measurement.from_input((bands, np.full(len(bands), 0.5)), noise)
        names = [f"{wavelength:g} nm" for wavelength in measurement.wavelength_nm]
    state_vector = StateVector.from_ranges(free, None, get_table_ranges(table))
    model = TableModel(table, measurement, state_vector, fixed)
    random = np.random.default_rng(seed)
    jacobians, stderr = [], []
    for state in random.random((N_STATES, len(state_vector.names))):
        covariance = measurement.covariance + model.error_covariance(state)
        # The selection assumes independent errors of the bands.
        stderr.append(np.sqrt(np.diag(covariance)))
        jacobians.append(model.jacobian(state))
    whitened_jacobians = np.array(jacobians) / np.array(stderr)[:, :, np.newaxis]
    selected, information, relative_spread = _select_greedily(
        whitened_jacobians, state_vector.prior_variance, n_bands
    )
    variables = {
        "band": ("step", np.array(names)[selected]),
        "information_bits": ("step", information.mean(axis=1)),
        "information_bits_stderr": ("step", information.std(axis=1, ddof=1) / np.sqrt(N_STATES)),
        "spread": (("step", "parameter"), relative_spread),
    }
    labels = [describe_parameter(name)[0] for name in state_vector.names]
    axes = {
        "step": np.arange(1, n_bands + 1),
        "parameter": list(state_vector.names),
        "parameter_label": ("parameter", labels),
    }
    return xr.Dataset(variables, axes)


def _select_greedily(
    jacobians: np.ndarray, prior_variance: np.ndarray, n_bands: int
) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return the bands, information by step and state, and relative spread by step and parameter.

    Parameters
    ----------
    jacobians : float, shape (states, bands, parameters)
        Jacobians in units of noise.
    prior_variance : float, shape (parameters,)
        Variance of the prior.
    """
    posterior = np.tile(np.diag(prior_variance), (len(jacobians), 1, 1))
    total_information = np.zeros(len(jacobians))
    chosen: list[int] = []
    information, relative_spread = [], []
    for _ in range(n_bands):
        # Gain of another band: ln(1 + kᵀ S k)/2 (matrix determinant lemma), then the update of S.
        gain = np.log2(1.0 + np.einsum("pbi,pij,pbj->pb", jacobians, posterior, jacobians)) / 2.0
        mean = gain.mean(axis=0)
        mean[chosen] = -np.inf
        best = int(mean.argmax())
        chosen.append(best)
        row = np.einsum("pij,pj->pi", posterior, jacobians[:, best])
        scale = 1.0 + np.einsum("pi,pi->p", jacobians[:, best], row)
        posterior = posterior - row[:, :, np.newaxis] * row[:, np.newaxis] / scale[:, None, None]
        total_information = total_information + gain[:, best]
        information.append(total_information)
        relative_spread.append(
            np.sqrt(np.diagonal(posterior, axis1=1, axis2=2) / prior_variance).mean(axis=0)
        )
    return chosen, np.array(information), np.array(relative_spread)


_BANDS_HEIGHT_INCHES = 4.2


def draw_band_selection(selections: Mapping[str, xr.Dataset], conditions: str = "") -> Figure:
    """Draw information and relative spread by the number of bands, a column per table.

    Parameters
    ----------
    selections : mapping
        Outputs of `select_bands` by the title of their column.
    conditions : str
        Noise and fixed values, for the foot.
    """
    with use_style():
        figure, panels = make_subplots(
            2,
            len(selections),
            width=TWO_COLUMNS_INCHES if len(selections) > 1 else ONE_COLUMN_INCHES,
            height=_BANDS_HEIGHT_INCHES,
            sharex="col",
            squeeze=False,
        )
        for column, (title, dataset) in enumerate(selections.items()):
            top, bottom = panels[:, column]
            x, information = dataset.step.values, dataset.information_bits.values
            (blue,) = pick_colours(1)
            top.bar(x, information, color=blue, alpha=0.5)
            top.errorbar(
                x,
                information,
                BAND_SIGMA * dataset.information_bits_stderr.values,
                fmt="none",
                color="black",
                lw=0.8,
            )
            top.set_title(escape_mathtext(title))
            names = list(map(str, dataset.parameter.values))
            for name, colour in zip(names, pick_colours(len(names), "medium"), strict=True):
                relative_spread = dataset.spread.sel(parameter=name).values
                bottom.plot(
                    x,
                    relative_spread,
                    "o-",
                    color=colour,
                    ms=3,
                    lw=1.0,
                    label=format_parameter(name),
                )
            bottom.set_ylim(0.0, 1.05)
            bands = [f"+ {escape_mathtext(str(band))}" for band in dataset.band.values]
            bottom.set_xticks(x, bands, rotation=45)
            for label in bottom.get_xticklabels():
                label.set_horizontalalignment("right")
            bottom.legend(frameon=False, fontsize=SMALL_FONT_PT)
        panels[0, 0].set_ylabel("information (bits)")
        panels[1, 0].set_ylabel("posterior / prior\nstandard deviation")
        note = (
            "Bands from left to right, each adding most information to those before it, as a mean "
            "over the ranges of the table. Error bars: two standard errors of that mean."
        )
        note += f" {escape_mathtext(conditions.replace('_', ' '))}." if conditions else ""
        return annotate_figure(figure, panels[0], note)


_SOBOL_HEIGHT_INCHES = 3.4


def draw_sobol_indices(indices: Mapping[str, xr.Dataset]) -> Figure:
    """Draw first-order and total Sobol indices and the standard deviation, a column per table.

    Parameters
    ----------
    indices : mapping
        Outputs of `compute_sobol_indices` by the title of their column.
    """
    with use_style():
        figure, panels = make_subplots(
            2,
            len(indices),
            width=TWO_COLUMNS_INCHES if len(indices) > 1 else ONE_COLUMN_INCHES,
            height=_SOBOL_HEIGHT_INCHES,
            sharex="col",
            squeeze=False,
            gridspec_kw={"height_ratios": [2.4, 1.0]},
        )
        for column, (title, dataset) in enumerate(indices.items()):
            top, bottom = panels[:, column]
            x = dataset.wavelength.values
            names = list(map(str, dataset.parameter.values))
            for name, colour in zip(names, pick_colours(len(names), "medium"), strict=True):
                part = dataset.sel(parameter=name)
                for key, dash in (("first_order", "-"), ("total", "--")):
                    value, error = part[key].values, BAND_SIGMA * part[f"{key}_stderr"].values
                    label = format_parameter(name) if dash == "-" else None
                    top.plot(x, value, color=colour, ls=dash, lw=1.1, label=label)
                    low, high = value - error, value + error
                    top.fill_between(x, low, high, color=colour, alpha=0.25, lw=0)
            bottom.plot(x, dataset.standard_deviation.values, color="black", lw=1.0)
            top.set_title(escape_mathtext(title))
            top.set_ylim(-0.03, 1.19)
            top.set_yticks(np.linspace(0.0, 1.0, 6))
            top.legend(frameon=False, fontsize=SMALL_FONT_PT, ncols=2, loc="upper center")
            start_at_zero(bottom)
            bottom.set_xlabel("wavelength (nm)")
        panels[0, 0].set_ylabel("fraction of the variance")
        panels[1, 0].set_ylabel("standard deviation\nof reflectance")
        note = (
            "Solid: a parameter alone (first-order Sobol index). Dashed: with its interactions "
            "with others (total index). Bands: two standard errors of sampling."
        )
        return annotate_figure(figure, panels[0], note)
