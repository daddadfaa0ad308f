"""What a model says a measurement would be: from a table, or from runs of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
import xarray as xr

from splits.core.validation import check_choice, invalid
from splits.retrieval.cubic_interpolation import interpolate, interpolate_states
from splits.retrieval.map_minimization import TableGrid
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import SCALE, ParameterRange, StateVector
from splits.tables.axes import ParameterGrid, check_axis_values
from splits.tables.export import compute_response_weights
from splits.tables.interpolation import compute_interpolation_weights, transform_axis
from splits.tables.table import Table, load_selection

ERROR_CORRELATION_NM = 400.0
"""Over which errors of cells are taken to be alike."""
SCALE_RANGE = (0.2, 5.0)
"""Widest range of the factor of a measurement."""


class ForwardModel(Protocol):
    """What a retrieval asks of a model, at places given by coordinates."""

    state_vector: StateVector

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (places, n)."""
        ...

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and slopes, shape (n, parameters)."""
        ...

    def compute_error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of what the model itself is off by, shape (n, n)."""
        ...


class MeasurementOperator(NamedTuple):
    """How a measurement comes from the wavelengths of a table.

    Attributes
    ----------
    matrix : float, shape (n, wavelengths)
    interpolation_error : float, shape (n, wavelengths)
        What reading between wavelengths misses.
    """

    matrix: np.ndarray
    interpolation_error: np.ndarray

    @classmethod
    def from_measurement(
        cls, measurement: Measurement, wavelengths: np.ndarray
    ) -> MeasurementOperator:
        """Return it, or refuse wavelengths outside of the table."""
        if measurement.bands:
            rows = [
                compute_response_weights(n, band, wavelengths)
                for n, band in measurement.bands.items()
            ]
            return cls(np.stack(rows), np.zeros((len(rows), wavelengths.size)))
        matrix, missed = np.zeros((2, measurement.values.size, wavelengths.size))
        for row, off, one in zip(matrix, missed, measurement.wavelength_nm, strict=True):
            w = compute_interpolation_weights("wavelength", wavelengths, float(one))
            row[w.nodes] = w.weights
            if len(w.error_weights):
                off[:] = max(w.error_weights, key=lambda r: float((r**2).sum()))
        return cls(matrix, missed)


class TableForwardModel:
    """A measurement as a table has it.

    Parameters
    ----------
    table : MethodTable
    measurement : Measurement
    state_vector : StateVector
        Axes of the table, and perhaps the measurement's level.
    fixed : mapping, optional
        Values of the other axes; those of one node may be left out.
    quantity : str
    """

    def __init__(
        self,
        table: Table,
        measurement: Measurement,
        state_vector: StateVector,
        fixed: Mapping[str, Any] | None,
        quantity: str = "reflectance",
    ) -> None:
        self.state_vector, self.table, self.quantity = state_vector, table, quantity
        self.fixed = _check_fixed_axes(table, state_vector, fixed)
        self.measurement = measurement
        self.operator = MeasurementOperator.from_measurement(
            measurement, table.dataset.wavelength.values
        )
        self.axes = [name for name in state_vector.names if name != SCALE]
        if not self.axes:
            raise invalid("free", list(state_vector.names), "at least one axis of the table")
        self._scale_index = state_vector.names.index(SCALE) if SCALE in state_vector.names else None
        self._axis_indices = [state_vector.names.index(name) for name in self.axes]
        values, nodes = _slice_table(table, quantity, self.axes, self.fixed)
        self.node_values = np.ascontiguousarray(
            values.reshape(-1, values.shape[-1]) @ self.operator.matrix.T
        )
        most = max(len(row) for row in nodes)
        of_axes = [
            state_vector.to_coordinate(i, row)
            for i, row in zip(self._axis_indices, nodes, strict=True)
        ]
        self._axis_nodes = np.array([np.pad(row, (0, most - len(row))) for row in of_axes])
        self._n_nodes = np.array([len(row) for row in nodes], dtype=np.int64)

    def make_grid(self, node_values: np.ndarray) -> TableGrid:
        """Return the table over coordinates, with other columns."""
        return TableGrid(np.ascontiguousarray(node_values), self._axis_nodes, self._n_nodes)

    def _compute_scale(self, states: np.ndarray) -> np.ndarray:
        if self._scale_index is None:
            return np.ones(states.shape[:-1])
        scale: np.ndarray = self.state_vector.to_physical(states)[..., self._scale_index]
        return scale

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (places, n)."""
        found = np.empty((len(states), self.node_values.shape[1]))
        at = np.ascontiguousarray(states[:, self._axis_indices])
        interpolate_states(self.node_values, self._axis_nodes, self._n_nodes, at, found)
        return found * self._compute_scale(states)[:, np.newaxis]

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and slopes, shape (n, parameters)."""
        count = self.node_values.shape[1]
        values, along = np.empty(count), np.empty((count, len(self.axes)))
        at = np.ascontiguousarray(state[self._axis_indices])
        interpolate(self.node_values, self._axis_nodes, self._n_nodes, at, values, along)
        scale = float(self._compute_scale(state))
        slopes = np.zeros((count, len(self.state_vector.names)))
        slopes[:, self._axis_indices] = scale * along
        if self._scale_index is not None:
            slopes[:, self._scale_index] = (
                values * (self.state_vector.high - self.state_vector.low)[self._scale_index]
            )
        return scale * values, slopes

    def compute_error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of what the table is off by, shape (n, n).

        Errors of cells are alike at wavelengths that share rays: as the table says, where it keeps
        that, else over `ERROR_CORRELATION_NM`.  What interpolation along an axis misses has a
        spectrum of its own, which may look like that of a parameter, so it is taken for one error
        at all wavelengths.
        """
        natural = self.state_vector.to_physical(state)
        where = {name: float(natural[self.state_vector.names.index(name)]) for name in self.axes}
        given = {name: value for name, value in self.fixed.items() if name in self.table.axes}
        there, q = self.table.interp(**given, **where), self.quantity
        missed = there[f"{q}_interpolation_error"].values
        cells = np.sqrt(np.maximum(there[f"{q}_stderr"].values ** 2 - missed**2, 0.0))
        own = np.abs(self.operator.matrix) @ cells
        along = self.table.interpolation_errors(q, **given, **where) @ self.operator.matrix.T
        between = self.operator.interpolation_error @ there[q].values
        found = (
            self._compute_node_covariance(own, {**given, **where})
            + along.T @ along
            + np.diag(between**2)
        )
        return float(self._compute_scale(state)) ** 2 * found

    def _compute_node_covariance(
        self, stderr: np.ndarray, axis_values: dict[str, Any]
    ) -> np.ndarray:
        """Return the covariance of the errors of cells, whose standard errors are known."""
        if f"{self.quantity}_batches" not in self.table.dataset:
            w = self.measurement.wavelength_nm
            alike = np.exp(-np.abs(w[:, np.newaxis] - w) / ERROR_CORRELATION_NM)
            return alike * stderr[:, np.newaxis] * stderr
        groups = self.table.deviations(self.quantity, **axis_values) @ self.operator.matrix.T
        found: np.ndarray = groups.T @ groups
        # The standard errors hold what stands for interpolation between refractive indices, too.
        return found + np.diag(np.maximum(stderr**2 - np.diag(found), 0.0))

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the coordinates of all cells in the ranges, and what would be measured there."""
        grids = np.meshgrid(*(self.table.dataset[name].values for name in self.axes), indexing="ij")
        natural = np.zeros((grids[0].size, len(self.state_vector.names)))
        for i, grid in zip(self._axis_indices, grids, strict=True):
            natural[:, i] = grid.ravel()
        if self._scale_index is not None:
            natural[:, self._scale_index] = np.clip(
                1.0,
                self.state_vector.low[self._scale_index],
                self.state_vector.high[self._scale_index],
            )
        inside = ((natural >= self.state_vector.low) & (natural <= self.state_vector.high)).all(
            axis=1
        )
        if not inside.any():
            places = np.full((1, len(self.state_vector.names)), 0.5)
            return places, self.evaluate(places)
        scale = natural[inside, self._scale_index] if self._scale_index is not None else 1.0
        return self.state_vector.to_coordinates(natural[inside]), (
            self.node_values[inside].T * scale
        ).T


def get_table_ranges(table: Table) -> dict[str, ParameterRange]:
    """Return the ranges of all axes of a table that may be free, and that of a level."""
    names = table.axes[:-1]
    rows = tuple(tuple(table.dataset[name].values.tolist()) for name in names)
    return get_grid_ranges(ParameterGrid(tuple(names), rows))


def get_grid_ranges(grid: ParameterGrid) -> dict[str, ParameterRange]:
    """Return what `get_table_ranges` returns of a table over these axes."""
    found = {}
    for name, row in zip(*grid, strict=True):
        if len(row) > 1 and not isinstance(row[0], str):
            kind, _ = transform_axis(name, np.array(row, dtype=float))
            found[name] = ParameterRange(float(row[0]), float(row[-1]), kind)
    return found | {SCALE: ParameterRange(*SCALE_RANGE, "itself")}


def _check_fixed_axes(
    table: Table, state_vector: StateVector, at: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the values of the axes that are not free, or refuse them."""
    found = check_axis_values(at, table.axes[:-1], "fixed.", free_axes=state_vector.names)
    for name in table.axes[:-1]:
        if name not in state_vector.names and name not in found and table.dataset[name].size > 1:
            raise invalid(f"fixed.{name}", None, "given", "an axis of the table that is not free")
    return found


def _slice_table(
    table: Table, quantity: str, axes: list[str], fixed: Mapping[str, Any]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return values over some axes and wavelength, others held, and how nodes are spaced."""
    part, shares = table.dataset[quantity], {}
    for name in table.axes[:-1]:
        if name in axes:
            continue
        nodes = table.dataset[name].values
        given = fixed.get(name, nodes[0])
        if nodes.dtype.kind != "f":
            part = part.sel({name: check_choice(f"fixed.{name}", str(given), nodes.tolist())})
            continue
        w = compute_interpolation_weights(name, nodes, given)
        part, shares[name] = part.isel({name: w.nodes}), w.weights
    part = load_selection(part)
    for name, share in shares.items():
        part = part.dot(xr.DataArray(share, dims=name), name)
    values = part.transpose(*axes, "wavelength").values.astype(float)
    return values, [table.dataset[name].values for name in axes]
