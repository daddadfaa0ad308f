"""Spectra, errors and derivatives at a point between the nodes of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array
from splits.core.validation import invalid
from splits.illumination.bands import BandMatrix, check_bands
from splits.io.netcdf import to_netcdf_attributes
from splits.tables.axes import check_axis_values
from splits.tables.axis_order import list_axes, list_quantities, load_selection
from splits.tables.derivatives import (
    DerivativeEstimate,
    check_derivative_axes,
    compute_derivative_weights,
    differentiate,
    make_derivative_dataset,
)
from splits.tables.interpolated_spectra import (
    InterpolatedSpectra,
    compute_axis_weights,
    interpolate_first_axis,
    interpolate_wavelengths,
    make_interpolated_variables,
)
from splits.tables.interpolation import InterpolationWeights, check_within_axis
from splits.tables.views import VIEW_QUANTITIES


def interpolate_table(dataset: xr.Dataset, at: Mapping[str, Any]) -> xr.Dataset:
    """Return the spectra of `splits.Table.interp` from a table without directions.

    Parameters
    ----------
    dataset : xarray.Dataset
        Table with sorted axes, see `splits.tables.axis_order.sort_axes`.
    at : mapping
        Position on each axis, optionally with wavelengths.
    """
    at, quantities = check_axis_values(at, list_axes(dataset)), list_quantities(dataset)
    wavelengths = dataset.wavelength.values
    targets = wavelengths
    if "wavelength" in at:
        requested = as_1d_array("wavelength", at.pop("wavelength"), "numbers in nanometres")
        targets = np.array(
            [check_within_axis("wavelength", wavelengths, value) for value in requested]
        )
    subset, weights = _select_stencil(dataset, at, _list_variables(quantities))
    spectra = [
        InterpolatedSpectra(*(subset[n].values.astype(float) for n in (q, f"{q}_stderr")))
        for q in quantities
    ]
    for axis_weights in weights:
        spectra = [interpolate_first_axis(spectrum, axis_weights) for spectrum in spectra]
    if not np.array_equal(targets, wavelengths):
        spectra = [interpolate_wavelengths(spectrum, wavelengths, targets) for spectrum in spectra]
    labels = [str(dataset[q].attrs.get("long_name", q)) for q in quantities]
    wavelength = ("wavelength", targets, dataset.wavelength.attrs)
    variables = make_interpolated_variables(quantities, labels, spectra)
    return xr.Dataset(variables, {"wavelength": wavelength}, to_netcdf_attributes(at))


def average_bands(dataset: xr.Dataset, at: Mapping[str, Any], bands: Any) -> xr.Dataset:
    """Return the means over bands of `splits.Table.interp`, from a table without directions.

    Errors of nodes are fully correlated within a band.  The interpolation error along an axis is
    fully correlated between all wavelengths, with its relative signs.
    """
    named = check_bands(bands)
    matrix, error_weights = BandMatrix.from_bands(named, dataset.wavelength.values)
    point = {name: value for name, value in at.items() if name != "wavelength"}
    spectra = interpolate_table(dataset, point)
    variables: dict[str, Any] = {}
    for quantity in list_quantities(dataset):
        value, stderr, error = (
            spectra[f"{quantity}{suffix}"].values
            for suffix in ("", "_stderr", "_interpolation_error")
        )
        node_error = np.sqrt(np.maximum(stderr**2 - error**2, 0.0))
        axis_errors = estimate_interpolation_errors(dataset, quantity, point) @ matrix.T
        errors = np.vstack([axis_errors, error_weights @ value])
        means = InterpolatedSpectra(
            matrix @ value, matrix @ node_error, np.sqrt((errors**2).sum(axis=0))
        )
        label = f"{dataset[quantity].attrs.get('long_name', quantity)} over a band"
        variables |= make_interpolated_variables([f"band_{quantity}"], [label], [means], "band")
    return xr.Dataset(variables, {"band": list(named)})


def estimate_interpolation_errors(
    dataset: xr.Dataset, quantity: str, at: Mapping[str, Any]
) -> np.ndarray:
    """Return the errors of `splits.Table.interpolation_errors` from a table without directions."""
    subset, weights = _select_stencil(dataset, at, _list_variables([quantity]))
    values = subset[quantity].values.astype(float)
    errors: list[list[np.ndarray]] = []
    for w in weights:
        errors = [[np.tensordot(w.weights, row[w.nodes], 1) for row in rows] for rows in errors]
        errors.append([np.tensordot(row, values, 1) for row in w.error_weights])
        values = np.tensordot(w.weights, values[w.nodes], 1)
    # The largest of the estimates from different validation nodes.
    zero = np.zeros_like(values)
    largest = [max(rows, key=lambda r: float((r**2).sum()), default=zero) for rows in errors]
    return np.array(largest).reshape(-1, values.size)


def interpolate_deviations(dataset: xr.Dataset, quantity: str, at: Mapping[str, Any]) -> np.ndarray:
    """Return the deviations of `splits.Table.deviations`."""
    name, axes = f"{quantity}_batches", list_axes(dataset)[:-1]
    if name not in dataset:
        raise invalid("table", quantity, "a table made with covariance=True")
    subset, weights = _select_stencil(dataset, at, [name])
    values = subset[name].transpose(*axes, "batch", "wavelength").values.astype(float)
    for w in weights:
        values = np.tensordot(w.weights, values[w.nodes], 1)
    return values


def differentiate_table(
    dataset: xr.Dataset, names: Sequence[str], at: Mapping[str, Any]
) -> xr.Dataset:
    """Return the derivatives of `splits.Table.derivatives` from a table without directions."""
    axes, quantities = list_axes(dataset)[:-1], list_quantities(dataset)
    at = check_axis_values(at, axes)
    numeric_axes = [n for n in axes if dataset[n].dtype.kind == "f"]
    selected = check_derivative_axes(names, numeric_axes)
    batch_variables = [f"{q}_batches" for q in quantities if f"{q}_batches" in dataset]
    subset, weights = _select_stencil(dataset, at, _list_variables(quantities) + batch_variables)
    estimates: dict[str, list[DerivativeEstimate]] = {q: [] for q in quantities}
    for name in selected:
        axis, nodes = axes.index(name), dataset[name].values
        stencil = np.searchsorted(nodes, subset[name].values[weights[axis].nodes])
        derivative_weights = compute_derivative_weights(
            name, nodes, stencil, check_within_axis(name, nodes, at.get(name, nodes[0])),
            has_direction=has_directional_quantity(dataset),
        )  # fmt: skip
        for quantity, rows in estimates.items():
            rows.append(differentiate(subset, quantity, weights, axis, derivative_weights))
    wavelength = ("wavelength", dataset.wavelength.values, dataset.wavelength.attrs)
    return make_derivative_dataset(estimates, selected, wavelength, to_netcdf_attributes(dict(at)))


def has_directional_quantity(dataset: xr.Dataset) -> bool:
    """Return whether a table holds distributions over directions, or their values in one."""
    return any(name in VIEW_QUANTITIES for name in list_quantities(dataset))


def _select_stencil(
    dataset: xr.Dataset, at: Mapping[str, Any], variables: list[str]
) -> tuple[xr.Dataset, list[InterpolationWeights]]:
    """Return the nodes around a point and the interpolation weights of every axis."""
    axes = list_axes(dataset)[:-1]
    at = check_axis_values(at, axes)
    subset, weights = dataset[variables], []
    for name in axes:
        values = dataset[name].values
        if name not in at and values.size > 1:
            raise invalid(name, None, "given", "an axis of the table")
        axis_weights = compute_axis_weights(
            name,
            values,
            at.get(name, values[0]),
            has_direction=has_directional_quantity(dataset),
        )
        # Only nodes with weights are read from a table on disk.
        needed = np.union1d(
            axis_weights.nodes, np.flatnonzero(axis_weights.error_weights.any(axis=0))
        )
        weights.append(axis_weights.restrict_to(needed))
        subset = subset.isel({name: needed})
    return load_selection(subset), weights


def _list_variables(quantities: Sequence[str]) -> list[str]:
    """Return the names of quantities and of their standard errors."""
    return [f"{quantity}{suffix}" for quantity in quantities for suffix in ("", "_stderr")]
