"""Forward models of a measurement: a table, and a model that is linear near a state.

Every model has a state vector, and for coordinates of it `evaluate` (many states at once),
`jacobian` and `error_covariance`.  The model of a medium is in
`splits.retrieval.medium_model`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np

from splits.core.validation import check_choice, check_relations, invalid, key_prefix
from splits.illumination.bands import SpectralOperator
from splits.kernels.interpolation import interpolate, interpolate_states
from splits.retrieval.measurement import Measurement, correlate_errors
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


class ForwardModel(Protocol):
    """Modelled measurements of states, which are coordinates of a state vector."""

    state_vector: StateVector

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return modelled measurements, shape (states, n)."""

    def jacobian(self, state: np.ndarray) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""

    def error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the errors of the model, shape (n, n)."""


class TableModel:
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
    independent_errors : bool
        Whether errors of nodes are independent between the wavelengths of the table.
    """

    def __init__(
        self,
        table: Table,
        measurement: Measurement,
        state_vector: StateVector,
        fixed: Mapping[str, Any] | None,
        quantity: str = "reflectance",
        operator: SpectralOperator | None = None,
        independent_errors: bool = False,
    ) -> None:
        self.state_vector, self.table, self.quantity = state_vector, table, quantity
        self.independent_errors = independent_errors
        self.fixed = check_axis_values(
            fixed, table.axes[:-1], "fixed.", free_axes=state_vector.names
        )
        known = {*state_vector.names, *self.fixed}
        check_relations(
            *(
                (
                    name in known or table.dataset[name].size == 1, f"fixed.{name}", None, "given",
                    "an axis of the table that is not free",
                )
                for name in table.axes[:-1]
            )
        )  # fmt: skip
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

    def jacobian(self, state: np.ndarray) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""
        n_values = self.node_values.shape[1]
        values, axis_jacobian = np.empty(n_values), np.empty((n_values, len(self.axes)))
        axis_state = np.ascontiguousarray(state[self._axis_indices])
        interpolate(
            self.node_values, self.axis_nodes, self.n_nodes, axis_state, values, axis_jacobian
        )
        jacobian = np.zeros((n_values, len(self.state_vector.names)))
        jacobian[:, self._axis_indices] = float(self._compute_scale(state)) * axis_jacobian
        if self._scale_index is not None:
            jacobian[:, self._scale_index] = (
                values * (self.state_vector.high - self.state_vector.low)[self._scale_index]
            )
        return jacobian

    def error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the errors of the table, shape (n, n).

        Errors of nodes are correlated between wavelengths that share rays: by the batch deviations
        of the table if it has them, else over `ERROR_CORRELATION_NM`, unless they are independent.
        The interpolation error along an axis may resemble the effect of a parameter, so it is taken
        as fully correlated between wavelengths.
        """
        physical, q = self.state_vector.to_physical(state), self.quantity
        point = {name: value for name, value in self.fixed.items() if name in self.table.axes}
        for index, name in zip(self._axis_indices, self.axes, strict=True):
            point[name] = float(physical[index])
        interpolated = self.table.interp(**point)
        weights = self.operator.weights
        node_stderr = np.sqrt(
            np.maximum(
                interpolated[f"{q}_stderr"].values ** 2
                - interpolated[f"{q}_interpolation_error"].values ** 2,
                0.0,
            )
        )
        stderr = np.abs(weights) @ node_stderr
        if self.independent_errors:
            scaled = weights * node_stderr
            nodes = scaled @ scaled.T
        elif f"{q}_batches" in self.table.dataset:
            batches = self.table.deviations(q, **point) @ weights.T
            nodes = batches.T @ batches
            # Standard errors include the interpolation between refractive indices, batches do not.
            nodes = nodes + np.diag(np.maximum(stderr**2 - np.diag(nodes), 0.0))
        else:
            nodes = correlate_errors(stderr, self.measurement.wavelength_nm, ERROR_CORRELATION_NM)
        axis_errors = scale_axis_errors(self.table.interpolation_errors(q, **point))
        axis_error = np.vstack([axis_errors, self._resampling_errors]) @ weights.T
        wavelength_error = self.operator.error_weights @ interpolated[q].values
        covariance = nodes + axis_error.T @ axis_error + np.diag((wavelength_error**2).sum(axis=0))
        return float(self._compute_scale(state)) ** 2 * covariance

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


class LinearModel:
    """Forward model that is linear about one state, with an interpolated deviation from that.

    The deviation is interpolated by radial functions between the states where it is known.

    Parameters
    ----------
    state_vector : StateVector
    state : float, shape (parameters,)
        Coordinates.
    modelled : float, shape (n,)
        Modelled measurement.
    slopes : float, shape (n, parameters)
        Jacobian at the state.
    covariance : float, shape (n, n)
        Covariance of the errors of the model.
    """

    def __init__(
        self, state_vector: StateVector, state: np.ndarray, modelled: np.ndarray,
        slopes: np.ndarray, covariance: np.ndarray,
    ) -> None:  # fmt: skip
        self.state_vector, self.state, self.modelled = state_vector, state, modelled
        self.slopes, self.covariance = slopes, covariance
        self._deviation: Callable[[np.ndarray], np.ndarray] | None = None
        self._states, self._values = state[np.newaxis], modelled[np.newaxis]

    def with_deviation(self, states: np.ndarray, values: np.ndarray) -> LinearModel:
        """Return a model with the given values, shape (states, n), at some states."""
        from scipy.interpolate import RBFInterpolator

        changed, whiten = copy.copy(self), standardize(states)
        deviation = values - (self.modelled + (states - self.state) @ self.slopes.T)
        interpolate_deviation = RBFInterpolator(
            states @ whiten, deviation, kernel="quintic", degree=2
        )
        changed._deviation = lambda new: interpolate_deviation(new @ whiten)
        changed._states, changed._values = states, values
        return changed

    def evaluate(self, states: np.ndarray) -> np.ndarray:
        """Return modelled measurements, shape (states, n)."""
        linear = self.modelled + (states - self.state) @ self.slopes.T
        return linear if self._deviation is None else linear + self._deviation(states)

    def jacobian(self, state: np.ndarray) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""
        if self._deviation is None:
            return self.slopes
        steps = GRADIENT_STEP * np.eye(len(state))
        high, low = np.split(self.evaluate(state + np.concatenate([steps, -steps])), 2)
        return (high - low).T / (2.0 * GRADIENT_STEP)

    def error_covariance(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the errors of the model, shape (n, n)."""
        return self.covariance

    def evaluate_first_guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the states with known values, and these values."""
        return self._states, self._values


def standardize(states: np.ndarray) -> np.ndarray:
    """Return the matrix that makes the coordinates of states independent, with variances of 1."""
    covariance = np.cov(states, rowvar=False).reshape(states.shape[1], -1)
    floor = MIN_SPREAD**2 * np.eye(len(covariance))
    return np.linalg.inv(np.linalg.cholesky(covariance + floor)).T


Model = TypeVar("Model", bound=ForwardModel)


def drop_priors(model: Model) -> Model:
    """Return a forward model whose state vector has no priors; it shares all else."""
    changed = copy.copy(model)
    changed.state_vector = changed.state_vector.without_priors()
    return changed


def select_quantity(
    key: str, table: Table, quantity: str | None, fixed: Mapping[str, Any] | None
) -> tuple[Table, str, Mapping[str, Any] | None]:
    """Return a table in the direction of a measurement, the measured quantity, and other values.

    The quantity must be given for a table of several in a direction.  The key is that of the table
    in messages.
    """
    has_variables = hasattr(table, "data_vars")
    hint = f"splits.Table({'dataset' if has_variables else 'path'}), or splits.build_table(…)"
    check_relations((isinstance(table, Table), key, type(table).__name__, "a Table", hint))
    spectra = "a table of spectra", "see retrieve_return"
    check_relations((not table.has_delays, key, "a table of returns", *spectra))
    if quantity is None and table.has_direction:
        names = [name for name in table.quantities if not name.startswith(DIFFUSE_PREFIX)]
        allowed = f"given: {' or '.join(names)}"
        raise invalid("quantity", None, allowed, "the table has directions")
    if table.has_views:
        table, fixed = table.fix_view(fixed or {}, "fixed.")
    return table, check_choice("quantity", quantity or "reflectance", table.quantities), fixed


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
