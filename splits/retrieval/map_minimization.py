"""Compiled maximum-a-posteriori estimates of many measurements, by interpolation of a table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point
from splits.kernels.math.interpolation import interpolate

MAX_ITERATIONS = 60
"""Largest number of steps of a descent."""
SECOND_START_MARGIN = 0.1
"""Distance from the bounds at which the second descent starts."""
STEP_TOLERANCE = 1e-4
"""Step of the coordinates below which a descent has converged."""


class TableGrid(NamedTuple):
    """Table over coordinates from 0 to 1.

    Attributes
    ----------
    node_values : float64[nodes, columns]
        The last axis runs fastest.  The noise of every column has variance 1.
    axis_nodes : float64[axes, max_nodes]
        Coordinates.
    n_nodes : int64[axes]
    steps : int64[axes]
        Every step along an axis is a node of the table; the others are interpolated.
    """

    node_values: np.ndarray
    axis_nodes: np.ndarray
    n_nodes: np.ndarray
    steps: np.ndarray


@entry_point
def project_spectra(spectra, mean_spectrum, projection, whitening, components, residual_chi2):
    """Set the components of spectra, and the residual sums of squares, in units of noise.

    Parameters
    ----------
    spectra : float64[measurements, wavelengths]
    mean_spectrum : float64[wavelengths]
    projection : float64[components, wavelengths]
    whitening : float64[wavelengths, wavelengths]
        Lower triangular matrix that whitens the noise.
    components : float64[measurements, components]
    residual_chi2 : float64[measurements]
    """
    n_wavelengths = len(mean_spectrum)
    deviation = np.empty(n_wavelengths)
    for row in range(len(spectra)):
        residual = 0.0
        for i in range(n_wavelengths):
            deviation[i] = spectra[row, i] - mean_spectrum[i]
            total = 0.0
            for j in range(i + 1):
                total += whitening[i, j] * deviation[j]
            residual += total * total
        for component in range(len(projection)):
            total = 0.0
            for i in range(n_wavelengths):
                total += projection[component, i] * deviation[i]
            components[row, component] = total
            residual -= total * total
        residual_chi2[row] = max(residual, 0.0)


@entry_point
def find_nearest_node(grid, measurement, prior_mean, prior_precision, state):
    """Set the state to the node of the table in the ranges with the smallest cost."""
    node_values, axis_nodes, n_nodes, steps = grid
    axes = len(n_nodes)
    min_cost = np.inf
    coordinates = np.empty(axes)
    n_table_nodes = 1
    for a in range(axes):
        n_table_nodes *= (n_nodes[a] - 1) // steps[a] + 1
    for table_node in range(n_table_nodes):
        rest, inside, cost = table_node, True, 0.0
        node, stride = 0, 1
        for a in range(axes - 1, -1, -1):
            n_axis_nodes = (n_nodes[a] - 1) // steps[a] + 1
            index = rest % n_axis_nodes * steps[a]
            rest //= n_axis_nodes
            node += index * stride
            stride *= n_nodes[a]
            coordinates[a] = axis_nodes[a, index]
            inside = inside and -1e-9 <= coordinates[a] <= 1.0 + 1e-9
            cost += prior_precision[a] * (coordinates[a] - prior_mean[a]) ** 2
        if not inside:
            continue
        for column in range(len(measurement)):
            cost += (node_values[node, column] - measurement[column]) ** 2
        if cost < min_cost:
            min_cost = cost
            for a in range(axes):
                state[a] = min(max(coordinates[a], 0.0), 1.0)
    if min_cost == np.inf:
        state[:] = 0.5


@entry_point
def evaluate_cost(grid, measurement, prior, state, modelled, jacobian, gradient, hessian):
    """Return the sum of squares at a state; set half its gradient and half its Hessian."""
    mean, precision = prior
    interpolate(grid.node_values, grid.axis_nodes, grid.n_nodes, state, modelled, jacobian)
    axes = len(state)
    cost = 0.0
    gradient[:] = 0.0
    hessian[:] = 0.0
    for a in range(axes):
        residual = state[a] - mean[a]
        cost += precision[a] * residual * residual
        gradient[a] = precision[a] * residual
        hessian[a, a] = precision[a]
    for column in range(len(measurement)):
        residual = modelled[column] - measurement[column]
        cost += residual * residual
        for a in range(axes):
            gradient[a] += jacobian[column, a] * residual
            for b in range(a + 1):
                hessian[a, b] += jacobian[column, a] * jacobian[column, b]
    for a in range(axes):
        for b in range(a):
            hessian[b, a] = hessian[a, b]
    return cost


@entry_point
def compute_damped_step(state, gradient, hessian, damping, new_state):
    """Set the new state of a damped step within the bounds; coordinates at active bounds stay."""
    axes = len(state)
    is_fixed = np.zeros(axes, dtype=np.bool_)
    # The damping is common to all: at 0 of a root transform the own slope would vanish.
    mean_damping = 0.0
    for a in range(axes):
        mean_damping += damping * hessian[a, a] / axes
    for _ in range(axes):
        matrix = np.empty((axes, axes))
        rhs = np.empty(axes)
        for a in range(axes):
            at_low, at_high = state[a] <= 0.0, state[a] >= 1.0
            points_out = (at_low and gradient[a] > 0.0) or (at_high and gradient[a] < 0.0)
            is_fixed[a] = is_fixed[a] or points_out
            rhs[a] = 0.0 if is_fixed[a] else -gradient[a]
        for a in range(axes):
            for b in range(axes):
                matrix[a, b] = 0.0 if is_fixed[a] or is_fixed[b] else hessian[a, b]
            matrix[a, a] = 1.0 if is_fixed[a] else hessian[a, a] + mean_damping + 1e-12
        step = np.linalg.solve(matrix, rhs)
        blocked = False
        for a in range(axes):
            new_state[a] = state[a] + step[a]
            crosses = (state[a] <= 0.0 and new_state[a] < 0.0) or (
                state[a] >= 1.0 and new_state[a] > 1.0
            )
            if crosses and not is_fixed[a]:
                is_fixed[a] = True
                blocked = True
        if not blocked:
            break
    for a in range(axes):
        new_state[a] = min(max(new_state[a], 0.0), 1.0)


@entry_point
def minimize_levenberg_marquardt(grid, measurement, prior_mean, prior_precision, state, hessian):
    """Minimize the sum of squares from a state by Levenberg and Marquardt; set half the Hessian.

    Returns
    -------
    float, bool
        The sum of squares, and whether the descent has converged.
    """
    axes, columns = len(state), len(measurement)
    values, jacobian = np.empty(columns), np.empty((columns, axes))
    gradient, target = np.empty(axes), np.empty(axes)
    cost = evaluate_cost(
        grid, measurement, (prior_mean, prior_precision), state, values, jacobian, gradient, hessian
    )
    damping = 1e-3
    new_gradient, new_hessian = np.empty(axes), np.empty((axes, axes))
    for _ in range(MAX_ITERATIONS):
        compute_damped_step(state, gradient, hessian, damping, target)
        step_size = np.abs(target - state).max()
        if step_size < STEP_TOLERANCE:
            return cost, True
        new_cost = evaluate_cost(
            grid,
            measurement,
            (prior_mean, prior_precision),
            target,
            values,
            jacobian,
            new_gradient,
            new_hessian,
        )
        if new_cost <= cost:
            cost = new_cost
            state[:] = target
            gradient[:] = new_gradient
            hessian[:] = new_hessian
            damping = max(0.1 * damping, 1e-9)
        else:
            damping = min(10.0 * damping, 1e6)
    return cost, False


@entry_point
def retrieve_spectra(
    grid, measurements, prior_mean, prior_precision, prior_variance, states, variances, misfits
):
    """Retrieve the state of every measurement; set states, variances of coordinates, and misfits.

    Parameters
    ----------
    grid : TableGrid
    measurements : float64[measurements, columns]
    prior_mean, prior_precision : float64[axes]
        Of the priors; precision 0 for parameters without a prior.
    prior_variance : float64[axes]
        Variance of the prior or the range.
    states, variances : float64[measurements, axes]
    misfits : float64[measurements, 2]
        Sum of squares, and 1 if the descent has converged, else 0.
    """
    axes = len(prior_mean)
    hessian, second_hessian = np.empty((axes, axes)), np.empty((axes, axes))
    second_state = np.empty(axes)
    for row in range(len(measurements)):
        state = states[row]
        find_nearest_node(grid, measurements[row], prior_mean, prior_precision, state)
        # Derivatives may vanish at bounds, so a second descent starts away from them.
        for a in range(axes):
            second_state[a] = min(max(state[a], SECOND_START_MARGIN), 1.0 - SECOND_START_MARGIN)
        cost, converged = minimize_levenberg_marquardt(
            grid, measurements[row], prior_mean, prior_precision, state, hessian
        )
        second_cost, second_converged = minimize_levenberg_marquardt(
            grid, measurements[row], prior_mean, prior_precision, second_state, second_hessian
        )
        if second_cost < cost:
            cost, converged = second_cost, second_converged
            state[:] = second_state
            hessian[:] = second_hessian
        for a in range(axes):
            cost -= prior_precision[a] * (state[a] - prior_mean[a]) ** 2
            # Without a prior, the range provides the prior variance.
            hessian[a, a] += 1.0 / prior_variance[a] - prior_precision[a]
        inverse = np.linalg.inv(hessian)
        for a in range(axes):
            variances[row, a] = inverse[a, a]
        misfits[row, 0] = cost
        misfits[row, 1] = 1.0 if converged else 0.0
