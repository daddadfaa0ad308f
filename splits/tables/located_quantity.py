"""Quantity of a table at a point between its nodes: value, errors, and derivatives.

Derivatives with respect to the parameters of the axes are those of the interpolating polynomials of
`splits.tables.interpolation`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.tables.axes import DELAY, load_selection
from splits.tables.interpolation import (
    AxisError,
    AxisInterpolation,
    AxisWeights,
    compute_interpolation_weights,
    compute_lagrange_weights,
    compute_stencil,
    estimate_error_weights,
)

ERROR_STEP = 1e-3
"""Step of the derivative of an error, relative to the length of the axis."""


class LocatedQuantity:
    """Quantity of a table at a point on some or all of its axes: the nodes around it, with weights.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset of a table.
    axes : mapping of str to AxisInterpolation
        Interpolation of the quantity along numeric axes.
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
    trailing_dims : tuple of str
        Dimensions that are no axes, such as delays, and the wavelength.
    """

    def __init__(
        self,
        dataset: xr.Dataset,
        axes: Mapping[str, AxisInterpolation],
        quantity: str,
        point: Mapping[str, Any],
        slopes_of: Sequence[str] = (),
    ) -> None:
        trailing = ("wavelength", DELAY)
        own_dims = dataset.variables[quantity].dims
        dims = [str(name) for name in own_dims if name not in trailing]
        self.names = [name for name in dims if name in point]
        self.kept = [name for name in dims if name not in point]
        self.trailing_dims = tuple(name for name in (DELAY, "wavelength") if name in own_dims)
        self.quantity, self.point, self._dataset = quantity, point, dataset
        self._axes = {name: axes[name] for name in self.names if name in axes}
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


def stack_axis_errors(errors: Sequence[AxisError], shape: tuple[int, ...]) -> np.ndarray:
    """Return the errors of axes with their relative signs along a spectrum, as one array."""
    rows = [
        np.copysign(error.magnitude, error.signed) if error.is_measured else error.signed
        for error in errors
    ]
    return np.array(rows).reshape(-1, *shape)


def scale_axis_errors(errors: np.ndarray) -> np.ndarray:
    """Return errors of axes, shape (axes, wavelengths), whose squares add up to the whole error.

    It is that of `combine_axis_errors`, which counts the sum of errors where it is larger.
    """
    root = np.sqrt((errors**2).sum(axis=0))
    whole = np.maximum(np.abs(errors.sum(axis=0)), root)
    scale = np.divide(whole, root, out=np.ones_like(root), where=root > 0.0)
    return errors * scale


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
