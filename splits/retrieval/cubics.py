"""Values and slopes between the nodes of a table, at many places at once.

The cubic through the four nearest nodes along every axis, as `splits.lookup.interpolation` has it.
"""

from __future__ import annotations

import numpy as np

from splits.transport.compiling.jit import entry

DRAWN = 4


@entry
def cubic(nodes, count, x, share, slope):
    """Write the weights of the nodes around a place and their derivatives; return the first node.

    Parameters
    ----------
    nodes : float64[most]
        Increasing; only so many count.
    count : int
    x : float
    share, slope : float64[4]
        Set; 0 beyond the nodes that are drawn from.
    """
    drawn = min(DRAWN, count)
    right = np.searchsorted(nodes[:count], x)
    first = min(max(right - drawn // 2, 0), count - drawn)
    share[:] = 0.0
    slope[:] = 0.0
    for i in range(drawn):
        value, rise = 1.0, 0.0
        for j in range(drawn):
            if j != i:
                scale = 1.0 / (nodes[first + i] - nodes[first + j])
                rise = rise * (x - nodes[first + j]) * scale + value * scale
                value *= (x - nodes[first + j]) * scale
        share[i] = value
        slope[i] = rise
    return first


@entry
def read(table, nodes, counts, x, values, slopes):
    """Read a table at a place: values, and slopes along all axes.

    Parameters
    ----------
    table : float64[cells, columns]
        The last axis runs fastest.
    nodes : float64[axes, most]
    counts : int64[axes]
    x : float64[axes]
    values : float64[columns]
        Set.
    slopes : float64[columns, axes]
        Set, unless it has no columns.
    """
    axes = len(counts)
    share, slope = np.empty((axes, DRAWN)), np.empty((axes, DRAWN))
    first = np.empty(axes, dtype=np.int64)
    cells = 1
    for a in range(axes):
        first[a] = cubic(nodes[a], counts[a], x[a], share[a], slope[a])
        cells *= min(DRAWN, counts[a])
    values[:] = 0.0
    slopes[:] = 0.0
    wanted = len(slopes) > 0
    part = np.empty(axes)
    for cell in range(cells):
        rest, place, stride, weight = cell, 0, 1, 1.0
        part[:] = 1.0
        for a in range(axes - 1, -1, -1):
            drawn = min(DRAWN, counts[a])
            i = rest % drawn
            rest //= drawn
            place += (first[a] + i) * stride
            stride *= counts[a]
            weight *= share[a, i]
            for b in range(axes):
                part[b] *= slope[a, i] if a == b else share[a, i]
        for column in range(len(values)):
            value = table[place, column]
            values[column] += weight * value
            if wanted:
                for b in range(axes):
                    slopes[column, b] += part[b] * value


@entry
def read_all(table, nodes, counts, places, values):
    """Read a table at many places.

    Parameters
    ----------
    table, nodes, counts
        As for `read`.
    places : float64[places, axes]
    values : float64[places, columns]
        Set.
    """
    none = np.empty((0, len(counts)))
    for row in range(len(places)):
        read(table, nodes, counts, places[row], values[row], none)
