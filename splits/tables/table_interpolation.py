"""Spectra, errors and derivatives at a point between the nodes of a table.

Derivatives with respect to the parameters of the axes are those of the interpolating polynomials of
`splits.tables.interpolation`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array
from splits.core.validation import check_choice, invalid, unknown_key
from splits.illumination.bands import SpectralOperator, check_bands
from splits.io.netcdf import to_netcdf_attributes
from splits.media.parameters import get_derivative_unit
from splits.tables.axes import (
    MIXED_QUANTITIES,
    POLAR,
    VIEW_QUANTITIES,
    check_axis_values,
    list_axes,
    list_quantities,
    load_selection,
)
from splits.tables.axis_interpolation import AxisError, AxisInterpolation, AxisWeights
from splits.tables.comparison import extract_comparisons
from splits.tables.interpolation import (
    check_within_axis,
    compute_interpolation_weights,
    compute_lagrange_weights,
    compute_stencil,
    estimate_error_weights,
    transform_axis,
)

ERROR_STEP = 1e-3
"""Step of the derivative of an error, relative to the length of the axis."""


class TableInterpolation:
    """Interpolation of the quantities of a table, prepared once for many points.

    Parameters
    ----------
    dataset : xarray.Dataset
        Table with sorted axes, see `splits.tables.axes.sort_axes`.
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = dataset
        self.axes = list_axes(dataset)[:-1]
        quantities = list_quantities(dataset)
        self.has_direction = any(name in VIEW_QUANTITIES for name in quantities)
        # Of a table with directions, a point has the quantities under the beam.
        self.quantities = [
            name for name in quantities if name in MIXED_QUANTITIES or POLAR not in self.axes
        ]
        self._prepared: dict[str, dict[str, AxisInterpolation]] = {}

    @cached_property
    def comparisons(self) -> dict[str, xr.Dataset]:
        """Tables with positions between the nodes of an axis, by axis."""
        return extract_comparisons(self.dataset)

    def prepare(self, quantity: str) -> dict[str, AxisInterpolation]:
        """Return the interpolation of a quantity along each of its numeric axes."""
        if quantity not in self._prepared:
            variable = self.dataset[quantity]
            names = [n for n in self.axes if n in variable.dims]
            numeric = {
                n: self.dataset[n].values for n in names if self.dataset[n].dtype.kind == "f"
            }
            transforms = {name: transform_axis(name, nodes)[0] for name, nodes in numeric.items()}
            prepared = {}
            for name, nodes in numeric.items():
                comparison = self.comparisons.get(name, xr.Dataset()).get(quantity)
                if comparison is not None:
                    others = [other for other in names if other != name]
                    comparison = comparison.transpose(name, *others, "wavelength")
                prepared[name] = AxisInterpolation(
                    name, nodes, variable.sizes["wavelength"],
                    has_direction=self.has_direction, comparison=comparison,
                    other_transforms=transforms,
                )  # fmt: skip
            self._prepared[quantity] = prepared
        return self._prepared[quantity]

    def complete_point(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """Return the validated position on every axis; axes of one node may be left out."""
        at = check_axis_values(at, self.axes)
        point: dict[str, Any] = {}
        for name in self.axes:
            nodes = self.dataset[name].values
            if name not in at and nodes.size > 1:
                raise invalid(name, None, "given", "an axis of the table")
            value = at.get(name, nodes[0])
            if nodes.dtype.kind == "f":
                point[name] = check_within_axis(name, nodes, value)
            else:
                point[name] = check_choice(name, str(value), nodes.tolist())
        return point


class LocatedQuantity:
    """Quantity of a table at a point on some or all of its axes: the nodes around it, with weights.

    Parameters
    ----------
    interpolation : TableInterpolation
    quantity : str
    point : mapping
        Position on some axes; the others are kept.
    slopes_of : sequence of str
        Axes along which derivatives are needed.

    Attributes
    ----------
    names : list of str
        Axes with a position, in order.
    kept : list of str
        The other axes, in order.
    """

    def __init__(
        self,
        interpolation: TableInterpolation,
        quantity: str,
        point: Mapping[str, Any],
        slopes_of: Sequence[str] = (),
    ) -> None:
        dataset, prepared = interpolation.dataset, interpolation.prepare(quantity)
        dims = [name for name in interpolation.axes if name in dataset[quantity].dims]
        self.names = [name for name in dims if name in point]
        self.kept = [name for name in dims if name not in point]
        self.quantity, self.point, self._dataset = quantity, point, dataset
        self._axes = {name: prepared[name] for name in self.names if name in prepared}
        self.weights: dict[str, AxisWeights] = {}
        self._rows, self._estimates, self._needed = {}, {}, {}
        for name in self.names:
            nodes = dataset[name].values
            if name not in self._axes:
                row = (nodes == point[name]).astype(float)[:, np.newaxis]
                self._needed[name] = np.flatnonzero(row[:, 0])
                self._rows[name] = row[self._needed[name]]
                continue
            axis = self._axes[name]
            weights = axis.compute_weights(point[name], with_slopes=name in slopes_of)
            self.weights[name] = weights
            used = weights.values.any(axis=1)
            if name in slopes_of:
                used = used | weights.slopes.any(axis=1)
            if not axis.is_measured:
                self._estimates[name] = axis.estimate_error_weights(point[name])
                used = used | self._estimates[name].any(axis=0)
            # Only nodes with weights are read from a table on disk.
            self._needed[name] = np.flatnonzero(used)
            self._rows[name] = weights.values[used]

    def read(self, name: str) -> np.ndarray:
        """Return a variable at the needed nodes: axes with a position, others, and wavelength."""
        variable = self._dataset[name]
        extra = [d for d in variable.dims if d not in {*self.names, *self.kept, "wavelength"}]
        selected = load_selection(variable.isel(self._needed))
        return selected.transpose(*self.names, *self.kept, *extra, "wavelength").values.astype(
            float
        )

    def combine(
        self, values: np.ndarray, replaced: Mapping[str, np.ndarray] | None = None, power: int = 1
    ) -> np.ndarray:
        """Return sums over nodes with the interpolation weights, some of them replaced."""
        for name in self.names:
            row = self._rows[name]
            if replaced is not None and name in replaced:
                row = replaced[name][self._needed[name]]
            values = np.einsum("iw,i...w->...w", np.broadcast_to(
                row**power, (len(row), values.shape[-1])), values)  # fmt: skip
        return values

    def combine_errors(self, stderr: np.ndarray) -> np.ndarray:
        """Return the error of the nodes at the point.

        Nodes share paths or random numbers, so their correlation is between 0 and 1.
        """
        correlated = np.abs(self.combine(stderr))
        return np.maximum(correlated, np.sqrt(self.combine(stderr**2, power=2)))

    def estimate_errors(self, values: np.ndarray) -> list[AxisError]:
        """Return the interpolation error of each axis with a position."""
        errors = []
        for name, axis in self._axes.items():
            if axis.is_measured:
                weights, others = self.weights[name], self._list_others(axis)
                errors.append(axis.measure_error(self.point[name], weights, others))
                continue
            rows = self._estimates[name]
            if len(rows):
                found = np.array([
                    self.combine(values, {name: row[:, np.newaxis]}) for row in rows
                ])  # fmt: skip
                largest = np.argmax((found**2).reshape(len(found), -1).sum(axis=1))
                errors.append(AxisError(found[largest], np.abs(found).max(axis=0), False))
        return errors

    def differentiate(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative with respect to the parameter of an axis, and its standard error.

        The point needs slopes of this axis.
        """
        values, stderr = self.read(self.quantity), self.read(f"{self.quantity}_stderr")
        slopes = {name: self.weights[name].slopes}
        value = self.combine(values, slopes)
        batches = f"{self.quantity}_batches"
        if batches in self._dataset:
            variance = (self.combine(self.read(batches), slopes) ** 2).sum(axis=0)
        else:
            variance = self.combine(stderr**2, slopes, power=2)
        squared_error = np.zeros_like(value)
        for other, axis in self._axes.items():
            if other != name and not axis.is_measured:
                rows = [
                    self.combine(values, {**slopes, other: row[:, np.newaxis]})
                    for row in self._estimates[other]
                ]
                squared_error += np.max(np.square(rows), axis=0, initial=0.0)
            elif other != name:
                squared_error += self._differentiate_error(other, name) ** 2
            elif axis.is_measured:
                weights, others = self.weights[name], self._list_others(axis)
                squared_error += axis.measure_slope_error(self.point[name], weights, others) ** 2
            else:
                lower_order = self.combine(values, {name: self._compute_lower_order_slopes(name)})
                squared_error += (value - lower_order) ** 2
        return value, np.hypot(np.sqrt(variance), np.sqrt(squared_error))

    def _list_others(self, axis: AxisInterpolation) -> dict[str, Any]:
        """Return the positions on the other axes, or their nodes where these are kept."""
        return {
            other: self._dataset[other].values if other in self.kept else self.point[other]
            for other in axis.other_axes
        }

    def _differentiate_error(self, name: str, by: str) -> np.ndarray:
        """Return the derivative of the error along one axis by the parameter of another."""
        axis, nodes = self._axes[name], self._axes[by].nodes
        others = self._list_others(axis)
        step = ERROR_STEP * (nodes[-1] - nodes[0])
        ends = [
            float(np.clip(self.point[by] + sign * step, nodes[0], nodes[-1])) for sign in (-1, 1)
        ]
        low, high = (
            axis.measure_error(self.point[name], self.weights[name], {**others, by: end}).signed
            for end in ends
        )
        return (high - low) / (ends[1] - ends[0])

    def _compute_lower_order_slopes(self, name: str) -> np.ndarray:
        """Return the weights of the derivative without the farthest node."""
        axis = self._axes[name]
        coordinate, value = axis.coordinates[0], self.point[name]
        nodes, x = coordinate.apply(axis.nodes), float(coordinate.apply(np.array(value)))
        stencil = compute_stencil(nodes, x).nodes
        kept = np.delete(stencil, np.argmax(np.abs(nodes[stencil] - x)))
        row = np.zeros((len(nodes), 1))
        if len(kept) > 1:
            slopes = compute_lagrange_weights(nodes[kept], x)[1]
            row[kept, 0] = coordinate.compute_rate(value) * slopes
        else:
            row[:] = self.weights[name].slopes[:, :1]
        return row


def combine_axis_errors(errors: Sequence[AxisError], like: np.ndarray) -> np.ndarray:
    """Return the error of interpolation along several axes.

    Errors of axes may have the same sign, so the sum counts where it exceeds the root of the sum of
    squares.
    """
    signed, squared = np.zeros_like(like), np.zeros_like(like)
    for error in errors:
        signed += error.signed if error.is_measured else error.magnitude
        squared += error.magnitude**2
    return np.maximum(np.abs(signed), np.sqrt(squared))


def interpolate_table(interpolation: TableInterpolation, at: Mapping[str, Any]) -> xr.Dataset:
    """Return the spectra of `splits.Table.interp` from a table without directions.

    Parameters
    ----------
    interpolation : TableInterpolation
    at : mapping
        Position on each axis, optionally with wavelengths.
    """
    dataset = interpolation.dataset
    given = check_axis_values(at, list_axes(dataset))
    nodes = targets = dataset.wavelength.values
    if "wavelength" in given:
        requested = as_1d_array("wavelength", given.pop("wavelength"), "numbers in nanometres")
        targets = np.array([check_within_axis("wavelength", nodes, value) for value in requested])
    point = interpolation.complete_point(given)
    variables: dict[str, Any] = {}
    for quantity in interpolation.quantities:
        located = LocatedQuantity(interpolation, quantity, point)
        values, node_stderr = located.read(quantity), located.read(f"{quantity}_stderr")
        value, stderr = located.combine(values), located.combine_errors(node_stderr)
        error = combine_axis_errors(located.estimate_errors(values), value)
        if not np.array_equal(targets, nodes):
            value, stderr, error = interpolate_wavelengths(value, stderr, error, nodes, targets)
        label = str(dataset[quantity].attrs.get("long_name", quantity))
        variables |= _make_variables(quantity, "wavelength", value, stderr, error, label)
    wavelength = ("wavelength", targets, dataset.wavelength.attrs)
    return xr.Dataset(variables, {"wavelength": wavelength}, to_netcdf_attributes(given))


def interpolate_wavelengths(
    value: np.ndarray, stderr: np.ndarray, error: np.ndarray, nodes: np.ndarray, targets: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return values, errors of nodes and interpolation errors at other wavelengths."""
    found = np.empty((3, len(targets)))
    for column, x in zip(found.T, targets.tolist(), strict=True):
        stencil = compute_interpolation_weights("wavelength", nodes, x)
        w, near = stencil.weights, stencil.nodes
        rows = estimate_error_weights("wavelength", nodes, x)
        column[:] = (
            w @ value[near],
            max(abs(w @ stderr[near]), np.sqrt(w**2 @ stderr[near] ** 2)),
            np.hypot(np.abs(w) @ error[near], np.abs(rows @ value).max(initial=0.0)),
        )
    return found[0], found[1], found[2]


def average_bands(
    interpolation: TableInterpolation, at: Mapping[str, Any], bands: Any
) -> xr.Dataset:
    """Return the means over bands of `splits.Table.interp`.

    Errors of nodes are fully correlated within a band.  The interpolation error along an axis is
    fully correlated between all wavelengths, with its relative signs.
    """
    dataset, named = interpolation.dataset, check_bands(bands)
    matrix, error_weights = SpectralOperator.from_bands(named, dataset.wavelength.values)
    point = {name: value for name, value in at.items() if name != "wavelength"}
    spectra = interpolate_table(interpolation, point)
    variables: dict[str, Any] = {}
    for quantity in interpolation.quantities:
        value, stderr, error = (
            spectra[f"{quantity}{suffix}"].values
            for suffix in ("", "_stderr", "_interpolation_error")
        )
        node_error = matrix @ np.sqrt(np.maximum(stderr**2 - error**2, 0.0))
        rows = estimate_interpolation_errors(interpolation, quantity, point)
        errors = np.vstack([scale_axis_errors(rows) @ matrix.T, error_weights @ value])
        means = matrix @ value, node_error, np.sqrt((errors**2).sum(axis=0))
        label = f"{dataset[quantity].attrs.get('long_name', quantity)} over a band"
        variables |= _make_variables(f"band_{quantity}", "band", *means, label)
    return xr.Dataset(variables, {"band": list(named)})


def _make_variables(
    name: str, dim: str, value: np.ndarray, stderr: np.ndarray, error: np.ndarray, label: str
) -> dict[str, Any]:
    """Return the variables of an interpolated quantity and its errors."""
    rows = (
        ("", value, label),
        ("_stderr", np.hypot(stderr, error), f"standard error of {label}"),
        ("_interpolation_error", error, f"error of interpolation of {label}"),
    )
    return {
        name + suffix: (dim, row, {"long_name": long_name, "units": "1"})
        for suffix, row, long_name in rows
    }


def scale_axis_errors(errors: np.ndarray) -> np.ndarray:
    """Return errors of axes, shape (axes, wavelengths), whose squares add up to the whole error.

    It is that of `combine_axis_errors`, which counts the sum of errors where it is larger.
    """
    root = np.sqrt((errors**2).sum(axis=0))
    whole = np.maximum(np.abs(errors.sum(axis=0)), root)
    scale = np.divide(whole, root, out=np.ones_like(root), where=root > 0.0)
    return errors * scale


def estimate_interpolation_errors(
    interpolation: TableInterpolation, quantity: str, at: Mapping[str, Any]
) -> np.ndarray:
    """Return the errors of `splits.Table.interpolation_errors` from a table without directions."""
    located = LocatedQuantity(interpolation, quantity, interpolation.complete_point(at))
    values = located.read(quantity)
    errors = [
        np.copysign(error.magnitude, error.signed) if error.is_measured else error.signed
        for error in located.estimate_errors(values)
    ]
    return np.array(errors).reshape(-1, values.shape[-1])


def differentiate_table(
    interpolation: TableInterpolation, names: Sequence[str], at: Mapping[str, Any]
) -> xr.Dataset:
    """Return the derivatives of `splits.Table.derivatives` from a table without directions."""
    dataset = interpolation.dataset
    at = check_axis_values(at, interpolation.axes)
    axes = [n for n in interpolation.axes if dataset[n].dtype.kind == "f"]
    if isinstance(names, str) or not isinstance(names, Sequence) or not names:
        raise invalid("names", names, f"a list of {', '.join(axes)}")
    for name in names:
        if name not in axes:
            raise unknown_key(f"names.{name}", axes)
        if dataset[name].size < 2:
            allowed = "an axis of at least two nodes"
            raise invalid(f"derivatives ({name})", dataset[name].size, allowed)
    if len(set(names)) < len(names):
        raise invalid("names", list(names), "different names")
    point = interpolation.complete_point(at)
    variables: dict[str, Any] = {}
    for quantity in interpolation.quantities:
        located = LocatedQuantity(interpolation, quantity, point, names)
        values, errors = np.stack([located.differentiate(name) for name in names], axis=1)
        label = f"derivative of {quantity} with respect to the parameter, per unit of it"
        for name, rows, long_name in (
            (f"{quantity}_jacobian", values, label),
            (f"{quantity}_jacobian_stderr", errors, f"standard error of the {label}"),
        ):
            attributes = {"long_name": long_name, "units": "1"}
            variables[name] = (("parameter", "wavelength"), rows, attributes)
    units = [get_derivative_unit(name) for name in names]
    coordinates = {
        "parameter": ("parameter", list(names), {"long_name": "parameter"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of the derivative"}),
        "wavelength": ("wavelength", dataset.wavelength.values, dataset.wavelength.attrs),
    }
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(dict(at)))
