"""Compiled interpolation of a table and its derivatives at many states.

Along every axis, the cubic through the four nearest nodes is used, as in
`splits.tables.interpolation`.
"""

from __future__ import annotations

import numpy as np

from splits.kernels.compiler.jit import entry_point

STENCIL_SIZE = 4


@entry_point
def compute_cubic_weights(nodes, n_nodes, x, weights, derivative_weights):
    """Set the weights of the nearest nodes and their derivatives; return the first node.

    Parameters
    ----------
    nodes : float64[:]
        Increasing.
    n_nodes : int
        Number of nodes in use.
    x : float
    weights, derivative_weights : float64[4]
        Output; 0 for unused nodes of the stencil.
    """
    n_stencil = min(STENCIL_SIZE, n_nodes)
    right = np.searchsorted(nodes[:n_nodes], x)
    first = min(max(right - n_stencil // 2, 0), n_nodes - n_stencil)
    weights[:] = 0.0
    derivative_weights[:] = 0.0
    for i in range(n_stencil):
        weight, derivative = 1.0, 0.0
        for j in range(n_stencil):
            if j != i:
                scale = 1.0 / (nodes[first + i] - nodes[first + j])
                derivative = derivative * (x - nodes[first + j]) * scale + weight * scale
                weight *= (x - nodes[first + j]) * scale
        weights[i] = weight
        derivative_weights[i] = derivative
    return first


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
        first[a] = compute_cubic_weights(
            axis_nodes[a], n_nodes[a], state[a], axis_weights[a], axis_slopes[a]
        )
        n_stencil_nodes *= min(STENCIL_SIZE, n_nodes[a])
    values[:] = 0.0
    jacobian[:] = 0.0
    with_jacobian = len(jacobian) > 0
    gradient_weights = np.empty(axes)
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
