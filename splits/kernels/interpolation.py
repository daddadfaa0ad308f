"""Cubic interpolation between the nodes of a table, in Python and in kernels, with derivatives.

The polynomial of Lagrange through the four nearest nodes is used along every axis,

    f(x) = ∑_i f_i ∏_(j≠i) (x − x_j)/(x_i − x_j).
"""

from __future__ import annotations

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline_allocating, inline_only

STENCIL_SIZE = 4
"""Largest number of nodes in an interpolation stencil."""


@inline_allocating
def find_first_node(nodes, n_nodes, x):
    """Return the first node of the stencil around x, in whose middle x is where possible.

    Parameters
    ----------
    nodes : float64[:]
        Increasing.
    n_nodes : int
        Number of nodes in use.
    x : float
    """
    n_stencil = min(STENCIL_SIZE, n_nodes)
    right = np.searchsorted(nodes[:n_nodes], x)
    return min(max(right - n_stencil // 2, 0), n_nodes - n_stencil)


@inline_only
def set_lagrange_weights(nodes, first, count, x, weights, slopes):
    """Set the weights of the polynomial of Lagrange at x, and their derivatives.

    Parameters
    ----------
    nodes : float64[:] or list of float
    first, count : int
        First node and number of nodes of the polynomial.
    x : float
    weights, slopes : float64[:] or list of float
        Output, the first `count` items.
    """
    for i in range(count):
        weight, slope = 1.0, 0.0
        for j in range(count):
            if j != i:
                scale = 1.0 / (nodes[first + i] - nodes[first + j])
                # Derivative of the product of the factors so far and the next one.
                slope = slope * (x - nodes[first + j]) * scale + weight * scale
                weight *= (x - nodes[first + j]) * scale
        weights[i] = weight
        slopes[i] = slope


@entry_point
def interpolate(node_values, axis_nodes, n_nodes, state, values, jacobian):
    """Interpolate a table at a state: values and derivatives along all axes.

    Parameters
    ----------
    node_values : float64[nodes, columns]
        The last axis runs fastest.
    axis_nodes : float64[axes, max_nodes]
    n_nodes : int64[axes]
    state : float64[axes]
    values : float64[columns]
        Output.
    jacobian : float64[columns, axes]
        Output, not computed if it has no rows.
    """
    axes = len(n_nodes)
    axis_weights, axis_slopes = np.empty((axes, STENCIL_SIZE)), np.empty((axes, STENCIL_SIZE))
    first = np.empty(axes, dtype=np.int64)
    n_stencil_nodes = 1
    for a in range(axes):
        n_stencil = min(STENCIL_SIZE, n_nodes[a])
        first[a] = find_first_node(axis_nodes[a], n_nodes[a], state[a])
        set_lagrange_weights(
            axis_nodes[a], first[a], n_stencil, state[a], axis_weights[a], axis_slopes[a]
        )
        n_stencil_nodes *= n_stencil
    values[:] = 0.0
    jacobian[:] = 0.0
    with_jacobian = len(jacobian) > 0
    gradient_weights = np.empty(axes)
    # Weights of a node are the product of those along all axes.
    for node in range(n_stencil_nodes):
        rest, row, stride, weight = node, 0, 1, 1.0
        gradient_weights[:] = 1.0
        for a in range(axes - 1, -1, -1):
            n_stencil = min(STENCIL_SIZE, n_nodes[a])
            i = rest % n_stencil
            rest //= n_stencil
            row += (first[a] + i) * stride
            stride *= n_nodes[a]
            weight *= axis_weights[a, i]
            for b in range(axes):
                gradient_weights[b] *= axis_slopes[a, i] if a == b else axis_weights[a, i]
        for column in range(len(values)):
            value = node_values[row, column]
            values[column] += weight * value
            if with_jacobian:
                for b in range(axes):
                    jacobian[column, b] += gradient_weights[b] * value


@entry_point
def interpolate_states(node_values, axis_nodes, n_nodes, states, values):
    """Interpolate a table at many states.

    Parameters
    ----------
    node_values, axis_nodes, n_nodes
        As for `interpolate`.
    states : float64[states, axes]
    values : float64[states, columns]
        Output.
    """
    no_jacobian = np.empty((0, len(n_nodes)))
    for row in range(len(states)):
        interpolate(node_values, axis_nodes, n_nodes, states[row], values[row], no_jacobian)
