"""Forward models of a measurement: a table, a linear model, and one interpolated between states."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from splits.core.validation import invalid, key_prefix
from splits.illumination.bands import SpectralOperator
from splits.kernels.interpolation import interpolate, interpolate_states
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import SCALE, ParameterRange, StateVector
from splits.tables.axes import (
    DIFFUSE_PREFIX,
    INCIDENCE,
    VIEW_AXES,
    check_axis_values,
)
from splits.tables.interpolation import (
    COORDINATES,
    N_VALIDATION_NODES,
    estimate_error_weights,
    make_weight_matrix,
    transform_axis,
)
from splits.tables.located_quantity import scale_axis_errors
from splits.tables.table import Table

FIXED_ATTRIBUTES = (INCIDENCE, *VIEW_AXES, "field_of_view_deg", "diffuse_fraction")
"""Attributes of a table that are conditions of a measurement."""
ERROR_CORRELATION_NM = 400.0
"""Correlation length (nm) assumed for errors of table nodes."""
MAX_RESAMPLED_VALUES = 20_000_000
"""Largest number of values of a table with added nodes, if the table itself has
fewer."""
SCALE_RANGE = (0.2, 5.0)
"""Widest range of the scale factor."""


def make_measurement_operator(
    measurement: Measurement, wavelengths: np.ndarray
) -> SpectralOperator:
    """Return the operator of a measurement; reject values outside the wavelengths (nm)."""
    if measurement.bands:
        return SpectralOperator.from_bands(measurement.bands, wavelengths)
    rows = make_weight_matrix("wavelength", wavelengths, measurement.wavelength_nm)
    error_weights = np.zeros((N_VALIDATION_NODES, *rows.shape))
    for number, x in enumerate(measurement.wavelength_nm.tolist()):
        estimates = estimate_error_weights("wavelength", wavelengths, x)
        error_weights[: len(estimates), number] = estimates
    return SpectralOperator(rows, error_weights)


class TableForwardModel:
    """Forward model that interpolates a table.

    Parameters
    ----------
    table : Table
    measurement : Measurement
    state_vector : StateVector
        Axes of the table, and optionally the scale.
    fixed : mapping, optional
        Values of the other axes; axes with a single node may be left out.
    quantity : str
    operator : SpectralOperator, optional
        From the spectra of the table to the measurement, see `make_measurement_operator`.
    """

    def __init__(
        self,
        table: Table,
        measurement: Measurement,
        state_vector: StateVector,
        fixed: Mapping[str, Any] | None,
        quantity: str = "reflectance",
        operator: SpectralOperator | None = None,
    ) -> None:
        self.state_vector, self.table, self.quantity = state_vector, table, quantity
        self.fixed = check_axis_values(
            fixed, table.axes[:-1], "fixed.", free_axes=state_vector.names
        )
        for name in table.axes[:-1]:
            is_given = name in state_vector.names or name in self.fixed
            if not is_given and table.dataset[name].size > 1:
                hint = "an axis of the table that is not free"
                raise invalid(f"fixed.{name}", None, "given", hint)
        self.measurement = measurement
        self.operator = operator or make_measurement_operator(
            measurement, table.dataset.wavelength.values
        )
        self.axes = [name for name in state_vector.names if name != SCALE]
        if not self.axes:
            raise invalid("free", list(state_vector.names), "at least one axis of the table")
        self._scale_index = state_vector.names.index(SCALE) if SCALE in state_vector.names else None
        self._axis_indices = [state_vector.names.index(name) for name in self.axes]
        values, nodes, self.steps, self._resampling_errors = _resample_table(
            table, quantity, state_vector, self.axes, self.fixed
        )
        self.node_values = np.ascontiguousarray(
            values.reshape(-1, values.shape[-1]) @ self.operator.weights.T
        )
        coordinates = [
            state_vector.to_coordinate(i, row)
            for i, row in zip(self._axis_indices, nodes, strict=True)
        ]
        max_nodes = max(len(row) for row in nodes)
        self.axis_nodes = np.array([np.pad(row, (0, max_nodes - len(row))) for row in coordinates])
        self.n_nodes = np.array([len(row) for row in nodes], dtype=np.int64)

    @property
    def table_node_values(self) -> np.ndarray:
        """Values at the nodes of the table alone, shape (nodes, n)."""
        by_axis = self.node_values.reshape(*self.n_nodes, -1)
        at_nodes = by_axis[tuple(slice(None, None, step) for step in self.steps)]
        return at_nodes.reshape(-1, by_axis.shape[-1])

    def list_fixed_values(self) -> dict[str, Any]:
        """Return the incidence and the values of all axes that are not free."""
        attributes = self.table.dataset.attrs
        nodes = {name: self.table.dataset[name].values for name in self.table.axes[:-1]}
        return {name: attributes[name] for name in FIXED_ATTRIBUTES if name in attributes} | {
            name: self.fixed.get(name, row[0].item())
            for name, row in nodes.items()
            if name not in self.axes
        }

    def _compute_scale(self, states: np.ndarray) -> np.ndarray:
        if self._scale_index is None:
            return np.ones(states.shape[:-1])
        return self.state_vector.to_physical(states)[..., self._scale_index]

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return modelled measurements, shape (states, n)."""
        modelled = np.empty((len(states), self.node_values.shape[1]))
        axis_states = np.ascontiguousarray(states[:, self._axis_indices])
        interpolate_states(self.node_values, self.axis_nodes, self.n_nodes, axis_states, modelled)
        return modelled * self._compute_scale(states)[:, np.newaxis]

    def evaluate_state(self, state: np.ndarray) -> np.ndarray:
        """Return the modelled measurement of one state, shape (n,)."""
        return self.evaluate(state[np.newaxis])[0]

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and its Jacobian, shape (n, parameters)."""
        n_values = self.node_values.shape[1]
        values, axis_jacobian = np.empty(n_values), np.empty((n_values, len(self.axes)))
        axis_state = np.ascontiguousarray(state[self._axis_indices])
        interpolate(
            self.node_values, self.axis_nodes, self.n_nodes, axis_state, values, axis_jacobian
        )
        scale = float(self._compute_scale(state))
        jacobian = np.zeros((n_values, len(self.state_vector.names)))
        jacobian[:, self._axis_indices] = scale * axis_jacobian
        if self._scale_index is not None:
            jacobian[:, self._scale_index] = (
                values * (self.state_vector.high - self.state_vector.low)[self._scale_index]
            )
        return scale * values, jacobian

    def compute_error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the error of the table, shape (n, n).

        Errors of nodes are correlated between wavelengths that share rays: by the batch deviations
        of the table if it has them, else over `ERROR_CORRELATION_NM`.  The interpolation error
        along an axis may resemble the effect of a parameter, so it is taken as fully correlated
        between wavelengths.
        """
        physical = self.state_vector.to_physical(state)
        free_values = {
            name: float(physical[self.state_vector.names.index(name)]) for name in self.axes
        }
        fixed = {name: value for name, value in self.fixed.items() if name in self.table.axes}
        interpolated, q = self.table.interp(**{**fixed, **free_values}), self.quantity
        interpolation_error = interpolated[f"{q}_interpolation_error"].values
        node_stderr = np.sqrt(
            np.maximum(interpolated[f"{q}_stderr"].values ** 2 - interpolation_error**2, 0.0)
        )
        axis_errors = self.table.interpolation_errors(q, **fixed, **free_values)
        axis_error = (
            np.vstack([scale_axis_errors(axis_errors), self._resampling_errors])
            @ self.operator.weights.T
        )
        wavelength_error = self.operator.error_weights @ interpolated[q].values
        covariance = (
            self.compute_node_covariance(node_stderr, {**fixed, **free_values})
            + axis_error.T @ axis_error
            + np.diag((wavelength_error**2).sum(axis=0))
        )
        return float(self._compute_scale(state)) ** 2 * covariance

    def compute_node_covariance(
        self, node_stderr: np.ndarray, axis_values: dict[str, Any]
    ) -> np.ndarray:
        """Return the covariance, shape (n, n), of the errors of nodes from their standard errors.

        Parameters
        ----------
        node_stderr : float, shape (wavelengths,)
            Interpolated standard errors of nodes.
        axis_values : dict
            Values of all axes.
        """
        stderr = np.abs(self.operator.weights) @ node_stderr
        if f"{self.quantity}_batches" not in self.table.dataset:
            wavelength = self.measurement.wavelength_nm
            correlation = np.exp(
                -np.abs(wavelength[:, np.newaxis] - wavelength) / ERROR_CORRELATION_NM
            )
            return correlation * stderr[:, np.newaxis] * stderr
        batches = self.table.deviations(self.quantity, **axis_values) @ self.operator.weights.T
        covariance: np.ndarray = batches.T @ batches
        # Standard errors include the interpolation between refractive indices, batches do not.
        return covariance + np.diag(np.maximum(stderr**2 - np.diag(covariance), 0.0))

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the states of all nodes in the ranges, and their modelled measurements."""
        low, high = self.state_vector.low, self.state_vector.high
        grids = np.meshgrid(*(self.table.dataset[name].values for name in self.axes), indexing="ij")
        # The scale is 1, or its limit.
        physical = np.tile(np.clip(1.0, low, high), (grids[0].size, 1))
        physical[:, self._axis_indices] = np.stack([grid.ravel() for grid in grids], axis=-1)
        inside = ((physical >= low) & (physical <= high)).all(axis=1)
        middle = np.full((1, len(low)), 0.5)
        states = self.state_vector.to_coordinates(physical[inside]) if inside.any() else middle
        return states, self.evaluate(states)


MIN_SPREAD = 1e-5
"""Smallest standard deviation of coordinates."""
GRADIENT_STEP = 1e-4
"""Step of coordinates for derivatives."""


@dataclass
class LinearizedModel:
    """Forward model linearized about one state.

    Attributes
    ----------
    state_vector : StateVector
    state : float, shape (parameters,)
        Coordinates.
    modelled : float, shape (n,)
        Modelled measurement.
    jacobian : float, shape (n, parameters)
    error_covariance : float, shape (n, n)
        Covariance of the forward-model error.
    """

    state_vector: StateVector
    state: np.ndarray
    modelled: np.ndarray
    jacobian: np.ndarray
    error_covariance: np.ndarray

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return modelled measurements, shape (states, n)."""
        return self.modelled + (states - self.state) @ self.jacobian.T

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and its Jacobian, shape (n, parameters)."""
        return self.evaluate(state[np.newaxis])[0], self.jacobian

    def compute_error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the forward-model error, shape (n, n)."""
        return self.error_covariance

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the state of the linearization, and its modelled measurement."""
        return self.state[np.newaxis], self.modelled[np.newaxis]


class InterpolatedModel(LinearizedModel):
    """Forward model that interpolates between states.

    Parameters
    ----------
    linear_model : LinearizedModel
    states : float, shape (states, parameters)
    values : float, shape (states, n)
        Modelled measurements.
    """

    def __init__(
        self, linear_model: LinearizedModel, states: np.ndarray, values: np.ndarray
    ) -> None:
        from scipy.interpolate import RBFInterpolator

        super().__init__(**vars(linear_model))
        self._states, self._values, self._whiten = states, values, compute_whitening(states)
        deviation = values - linear_model.evaluate(states)
        self._deviation = RBFInterpolator(
            states @ self._whiten, deviation, kernel="quintic", degree=2
        )

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return modelled measurements, shape (states, n)."""
        deviation: np.ndarray = self._deviation(states @ self._whiten)
        return super().evaluate(states) + deviation

    def evaluate_with_jacobian(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and its Jacobian, shape (n, parameters)."""
        steps = GRADIENT_STEP * np.eye(len(state))
        values = self.evaluate(state + np.concatenate([0.0 * steps[:1], steps, -steps]))
        high, low = np.split(values[1:], 2)
        return values[0], (high - low).T / (2.0 * GRADIENT_STEP)

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the states, and their modelled measurements."""
        return self._states, self._values


def compute_whitening(states: np.ndarray) -> np.ndarray:
    """Return the matrix that makes the coordinates of states independent, with variances of 1."""
    covariance = np.cov(states, rowvar=False).reshape(states.shape[1], -1)
    floor = MIN_SPREAD**2 * np.eye(len(covariance))
    return np.linalg.inv(np.linalg.cholesky(covariance + floor)).T


ForwardModel = TableForwardModel | LinearizedModel
Model = TypeVar("Model")


def drop_priors(model: Model) -> Model:
    """Return a forward model whose state vector has no priors; it shares all else."""
    changed: Any = copy.copy(model)
    changed.state_vector = changed.state_vector.without_priors()
    return changed  # type: ignore[no-any-return]


def choose_quantity(table: Table, quantity: str | None) -> str:
    """Return the measured quantity; it must be given for a table of several in a direction."""
    if table.has_delays:
        raise invalid("model", "a table of returns", "a table of spectra", "see retrieve_return")
    if quantity is not None or not table.has_direction:
        return quantity or "reflectance"
    names = [name for name in table.quantities if not name.startswith(DIFFUSE_PREFIX)]
    raise invalid("quantity", None, f"given: {' or '.join(names)}", "the table has directions")


def get_table_ranges(table: Table) -> dict[str, ParameterRange]:
    """Return the ranges of all axes of a table that may be free, and of the scale."""
    ranges = {}
    for name in table.axes[:-1]:
        row = table.dataset[name].values
        if row.size > 1 and row.dtype.kind in "biuf" and name not in VIEW_AXES:
            nodes = row.astype(float)
            transform, _ = transform_axis(name, nodes, has_direction=table.has_direction)
            ranges[name] = ParameterRange(float(nodes[0]), float(nodes[-1]), transform)
    return ranges | {SCALE: ParameterRange(*SCALE_RANGE, "identity")}


def _resample_table(
    table: Table,
    quantity: str,
    state_vector: StateVector,
    axes: list[str],
    fixed: Mapping[str, Any],
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, np.ndarray]:
    """Return values over some axes and wavelength, the nodes of these axes, their steps and errors.

    A measurement may mix wavelengths for which the table has different coordinates.  Nodes are
    therefore added, as many as needed for cubics in the coordinates of the state vector to agree
    with the table, or as many as `MAX_RESAMPLED_VALUES` allows.  Every axis has its own nodes at
    each step.  Errors, of shape (axes, wavelengths), are the deviations that remain.
    """
    free = {name: table.dataset[name].values[0] for name in axes}
    with key_prefix("fixed"):
        complete = table.complete_point({**free, **fixed})
    point = {name: value for name, value in complete.items() if name not in free}
    located = table.locate(quantity, point)
    values = located.combine(located.read(quantity))
    prepared = table.prepare(quantity)
    coordinates = {
        name: COORDINATES[state_vector.transforms[state_vector.names.index(name)]]
        for name in located.kept
    }
    refined = {name: prepared[name].refine_nodes(one) for name, one in coordinates.items()}
    size = values.shape[-1]
    while size * math.prod(len(nodes) for _, nodes, _ in refined.values()) > MAX_RESAMPLED_VALUES:
        most = max(refined, key=lambda name: refined[name][0])
        steps = refined[most][0]
        if steps == 1:
            break
        refined[most] = prepared[most].refine_nodes(coordinates[most], steps // 2)
    for name in located.kept:
        # The axes move to the end in turn, and are in order afterwards.
        values = prepared[name].interpolate(np.moveaxis(values, 0, -2), refined[name][1])
    order = [located.kept.index(name) for name in axes]
    values = values.transpose(*order, len(order))
    steps, nodes, errors = zip(*(refined[name] for name in axes), strict=True)
    return values, list(nodes), np.array(steps), np.array(errors)
