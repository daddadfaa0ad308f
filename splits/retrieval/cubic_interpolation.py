"""Values and slopes between the nodes of a table, at many places at once.

The cubic through the four nearest nodes along every axis, as `splits.tables.interpolation` has it.
"""

from __future__ import annotations

import numpy as np

from splits.kernels.compiler.jit import entry_point

STENCIL_SIZE = 4


@entry_point
def compute_cubic_weights(nodes, n_nodes, x, weights, derivative_weights):
    """Write the weights of the nodes around a place and their derivatives; return the first node.

    Parameters
    ----------
    nodes : float64[most]
        Increasing; only so many count.
    n_nodes : int
    x : float
    weights, derivative_weights : float64[4]
        Set; 0 beyond the nodes that are drawn from.
    """
    drawn = min(STENCIL_SIZE, n_nodes)
    right = np.searchsorted(nodes[:n_nodes], x)
    first = min(max(right - drawn // 2, 0), n_nodes - drawn)
    weights[:] = 0.0
    derivative_weights[:] = 0.0
    for i in range(drawn):
        value, rise = 1.0, 0.0
        for j in range(drawn):
            if j != i:
                scale = 1.0 / (nodes[first + i] - nodes[first + j])
                rise = rise * (x - nodes[first + j]) * scale + value * scale
                value *= (x - nodes[first + j]) * scale
        weights[i] = value
        derivative_weights[i] = rise
    return first


@entry_point
def interpolate(node_values, axis_nodes, n_nodes, state, values, jacobian):
    """Read a table at a place: values, and slopes along all axes.

    Parameters
    ----------
    node_values : float64[cells, columns]
        The last axis runs fastest.
    axis_nodes : float64[axes, most]
    n_nodes : int64[axes]
    state : float64[axes]
    values : float64[columns]
        Set.
    jacobian : float64[columns, axes]
        Set, unless it has no columns.
    """
    axes = len(n_nodes)
    share, slope = np.empty((axes, STENCIL_SIZE)), np.empty((axes, STENCIL_SIZE))
    first = np.empty(axes, dtype=np.int64)
    cells = 1
    for a in range(axes):
        first[a] = compute_cubic_weights(axis_nodes[a], n_nodes[a], state[a], share[a], slope[a])
        cells *= min(STENCIL_SIZE, n_nodes[a])
    values[:] = 0.0
    jacobian[:] = 0.0
    wanted = len(jacobian) > 0
    part = np.empty(axes)
    for cell in range(cells):
        rest, place, stride, weight = cell, 0, 1, 1.0
        part[:] = 1.0
        for a in range(axes - 1, -1, -1):
            drawn = min(STENCIL_SIZE, n_nodes[a])
            i = rest % drawn
            rest //= drawn
            place += (first[a] + i) * stride
            stride *= n_nodes[a]
            weight *= share[a, i]
            for b in range(axes):
                part[b] *= slope[a, i] if a == b else share[a, i]
        for column in range(len(values)):
            value = node_values[place, column]
            values[column] += weight * value
            if wanted:
                for b in range(axes):
                    jacobian[column, b] += part[b] * value


@entry_point
def interpolate_states(node_values, axis_nodes, n_nodes, states, values):
    """Read a table at many places.

    Parameters
    ----------
    table, nodes, counts
        As for `interpolate`.
    states : float64[places, axes]
    values : float64[places, columns]
        Set.
    """
    none = np.empty((0, len(n_nodes)))
    for row in range(len(states)):
        interpolate(node_values, axis_nodes, n_nodes, states[row], values[row], none)
