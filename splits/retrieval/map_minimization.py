"""Most probable places of many measurements at once, in a table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import entry_point
from splits.retrieval.cubic_interpolation import interpolate

MAX_ITERATIONS = 60
"""Steps of a descent at most."""
SECOND_START_MARGIN = 0.1
"""Distance from the ends of ranges at which a second descent begins."""
STEP_TOLERANCE = 1e-4
"""Step of the coordinates at which one ends."""


class TableGrid(NamedTuple):
    """A table over coordinates from 0 to 1.

    Attributes
    ----------
    node_values : float64[cells, columns]
        The last axis runs fastest; noise of every column has variance 1.
    axis_nodes : float64[axes, most]
        Coordinates.
    n_nodes : int64[axes]
    """

    node_values: np.ndarray
    axis_nodes: np.ndarray
    n_nodes: np.ndarray


@entry_point
def project_spectra(spectra, mean_spectrum, projection, whitening, components, residual_chi2):
    """Set components of spectra, and the squares of what they leave, in units of noise.

    Parameters
    ----------
    spectra : float64[measurements, wavelengths]
    mean_spectrum : float64[wavelengths]
    projection : float64[components, wavelengths]
    whitening : float64[wavelengths, wavelengths]
        Lower triangle that gives all of noise the variance 1.
    components : float64[measurements, components]
    residual_chi2 : float64[measurements]
    """
    many = len(mean_spectrum)
    off = np.empty(many)
    for row in range(len(spectra)):
        square = 0.0
        for i in range(many):
            off[i] = spectra[row, i] - mean_spectrum[i]
            one = 0.0
            for j in range(i + 1):
                one += whitening[i, j] * off[j]
            square += one * one
        for component in range(len(projection)):
            one = 0.0
            for i in range(many):
                one += projection[component, i] * off[i]
            components[row, component] = one
            square -= one * one
        residual_chi2[row] = max(square, 0.0)


@entry_point
def find_nearest_node(
    node_values, axis_nodes, n_nodes, measurement, prior_mean, prior_precision, state
):
    """Set a place to the cell in the ranges that comes nearest to a measurement."""
    axes = len(n_nodes)
    least = np.inf
    at = np.empty(axes)
    for cell in range(len(node_values)):
        rest, inside, cost = cell, True, 0.0
        for a in range(axes - 1, -1, -1):
            at[a] = axis_nodes[a, rest % n_nodes[a]]
            rest //= n_nodes[a]
            inside = inside and -1e-9 <= at[a] <= 1.0 + 1e-9
            cost += prior_precision[a] * (at[a] - prior_mean[a]) ** 2
        if not inside:
            continue
        for column in range(len(measurement)):
            cost += (node_values[cell, column] - measurement[column]) ** 2
        if cost < least:
            least = cost
            for a in range(axes):
                state[a] = min(max(at[a], 0.0), 1.0)
    if least == np.inf:
        state[:] = 0.5


@entry_point
def evaluate_cost(grid, measurement, prior, state, modelled, jacobian, gradient, hessian):
    """Return the sum of squares at a place; set half its gradient and half its curvature."""
    mean, precision = prior
    interpolate(grid.node_values, grid.axis_nodes, grid.n_nodes, state, modelled, jacobian)
    axes = len(state)
    cost = 0.0
    gradient[:] = 0.0
    hessian[:] = 0.0
    for a in range(axes):
        off = state[a] - mean[a]
        cost += precision[a] * off * off
        gradient[a] = precision[a] * off
        hessian[a, a] = precision[a]
    for column in range(len(measurement)):
        off = modelled[column] - measurement[column]
        cost += off * off
        for a in range(axes):
            gradient[a] += jacobian[column, a] * off
            for b in range(a + 1):
                hessian[a, b] += jacobian[column, a] * jacobian[column, b]
    for a in range(axes):
        for b in range(a):
            hessian[b, a] = hessian[a, b]
    return cost


@entry_point
def compute_damped_step(state, gradient, hessian, damping, new_state):
    """Set the target of a damped step within the ranges; coordinates held at an end stay."""
    axes = len(state)
    held = np.zeros(axes, dtype=np.bool_)
    # Of all together: where a root begins, light has no slope, and nothing of its own to be damped.
    least = 0.0
    for a in range(axes):
        least += damping * hessian[a, a] / axes
    for _ in range(axes):
        matrix = np.empty((axes, axes))
        right = np.empty(axes)
        for a in range(axes):
            at_low, at_high = state[a] <= 0.0, state[a] >= 1.0
            out = (at_low and gradient[a] > 0.0) or (at_high and gradient[a] < 0.0)
            held[a] = held[a] or out
            right[a] = 0.0 if held[a] else -gradient[a]
        for a in range(axes):
            for b in range(axes):
                matrix[a, b] = 0.0 if held[a] or held[b] else hessian[a, b]
            matrix[a, a] = 1.0 if held[a] else hessian[a, a] + least + 1e-12
        move = np.linalg.solve(matrix, right)
        blocked = False
        for a in range(axes):
            new_state[a] = state[a] + move[a]
            over = (state[a] <= 0.0 and new_state[a] < 0.0) or (
                state[a] >= 1.0 and new_state[a] > 1.0
            )
            if over and not held[a]:
                held[a] = True
                blocked = True
        if not blocked:
            break
    for a in range(axes):
        new_state[a] = min(max(new_state[a], 0.0), 1.0)


@entry_point
def minimize_levenberg_marquardt(grid, measurement, prior_mean, prior_precision, state, hessian):
    """Move a place to where the sum of squares is least near it; set the curvature there.

    Returns
    -------
    float, bool
        The sum of squares, and whether the place has come to rest.
    """
    axes, columns = len(state), len(measurement)
    values, slopes = np.empty(columns), np.empty((columns, axes))
    gradient, target = np.empty(axes), np.empty(axes)
    cost = evaluate_cost(
        grid, measurement, (prior_mean, prior_precision), state, values, slopes, gradient, hessian
    )
    damping = 1e-3
    other_gradient, other = np.empty(axes), np.empty((axes, axes))
    for _ in range(MAX_ITERATIONS):
        compute_damped_step(state, gradient, hessian, damping, target)
        moved = np.abs(target - state).max()
        if moved < STEP_TOLERANCE:
            return cost, True
        found = evaluate_cost(
            grid,
            measurement,
            (prior_mean, prior_precision),
            target,
            values,
            slopes,
            other_gradient,
            other,
        )
        if found <= cost:
            cost = found
            state[:] = target
            gradient[:] = other_gradient
            hessian[:] = other
            damping = max(0.1 * damping, 1e-9)
        else:
            damping = min(10.0 * damping, 1e6)
    return cost, False


@entry_point
def retrieve_spectra(
    grid, measurements, prior_mean, prior_precision, prior_variance, states, variances, misfits
):
    """Descend for every measurement; set places, variances of coordinates, and misfits.

    Parameters
    ----------
    grid : TableGrid
    measurements : float64[measurements, columns]
    prior_mean, prior_precision : float64[axes]
        Of the priors, precision 0 without one.
    prior_variance : float64[axes]
        Of what was known before.
    states, variances : float64[measurements, axes]
    misfits : float64[measurements, 2]
        And whether places have come to rest, 1 or 0.
    """
    axes = len(prior_mean)
    curvature, other_curvature = np.empty((axes, axes)), np.empty((axes, axes))
    other = np.empty(axes)
    for row in range(len(measurements)):
        place = states[row]
        find_nearest_node(
            grid.node_values,
            grid.axis_nodes,
            grid.n_nodes,
            measurements[row],
            prior_mean,
            prior_precision,
            place,
        )
        # Ends of ranges may be places of no slope: a second descent begins away from them.
        for a in range(axes):
            other[a] = min(max(place[a], SECOND_START_MARGIN), 1.0 - SECOND_START_MARGIN)
        cost, rests = minimize_levenberg_marquardt(
            grid, measurements[row], prior_mean, prior_precision, place, curvature
        )
        second, other_rests = minimize_levenberg_marquardt(
            grid, measurements[row], prior_mean, prior_precision, other, other_curvature
        )
        if second < cost:
            cost, rests = second, other_rests
            place[:] = other
            curvature[:] = other_curvature
        for a in range(axes):
            cost -= prior_precision[a] * (place[a] - prior_mean[a]) ** 2
            # The range counts as knowledge where there is no prior.
            curvature[a, a] += 1.0 / prior_variance[a] - prior_precision[a]
        inverse = np.linalg.inv(curvature)
        for a in range(axes):
            variances[row, a] = inverse[a, a]
        misfits[row, 0] = cost
        misfits[row, 1] = 1.0 if rests else 0.0
