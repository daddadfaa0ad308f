"""Most probable places of many measurements at once, in a table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.retrieval.cubics import read
from splits.transport.compiling.jit import entry

STEPS = 60
"""Steps of a descent at most."""
INNER = 0.1
"""Distance from the ends of ranges at which a second descent begins."""
NEAR = 1e-4
"""Step of the coordinates at which one ends."""


class Grid(NamedTuple):
    """A table over coordinates from 0 to 1.

    Attributes
    ----------
    cells : float64[cells, columns]
        The last axis runs fastest; noise of every column has variance 1.
    nodes : float64[axes, most]
        Coordinates.
    counts : int64[axes]
    """

    cells: np.ndarray
    nodes: np.ndarray
    counts: np.ndarray


@entry
def reduce_each(spectra, centre, project, white, y, rest):
    """Set components of spectra, and the squares of what they leave, in units of noise.

    Parameters
    ----------
    spectra : float64[measurements, wavelengths]
    centre : float64[wavelengths]
    project : float64[components, wavelengths]
    white : float64[wavelengths, wavelengths]
        Lower triangle that gives all of noise the variance 1.
    y : float64[measurements, components]
    rest : float64[measurements]
    """
    many = len(centre)
    off = np.empty(many)
    for row in range(len(spectra)):
        square = 0.0
        for i in range(many):
            off[i] = spectra[row, i] - centre[i]
            one = 0.0
            for j in range(i + 1):
                one += white[i, j] * off[j]
            square += one * one
        for component in range(len(project)):
            one = 0.0
            for i in range(many):
                one += project[component, i] * off[i]
            y[row, component] = one
            square -= one * one
        rest[row] = max(square, 0.0)


@entry
def nearest(cells, nodes, counts, y, mean, precision, place):
    """Set a place to the cell in the ranges that comes nearest to a measurement."""
    axes = len(counts)
    least = np.inf
    at = np.empty(axes)
    for cell in range(len(cells)):
        rest, inside, cost = cell, True, 0.0
        for a in range(axes - 1, -1, -1):
            at[a] = nodes[a, rest % counts[a]]
            rest //= counts[a]
            inside = inside and -1e-9 <= at[a] <= 1.0 + 1e-9
            cost += precision[a] * (at[a] - mean[a]) ** 2
        if not inside:
            continue
        for column in range(len(y)):
            cost += (cells[cell, column] - y[column]) ** 2
        if cost < least:
            least = cost
            for a in range(axes):
                place[a] = min(max(at[a], 0.0), 1.0)
    if least == np.inf:
        place[:] = 0.5


@entry
def around(grid, y, prior, place, values, slopes, gradient, curvature):
    """Return the sum of squares at a place; set half its gradient and half its curvature."""
    mean, precision = prior
    read(grid.cells, grid.nodes, grid.counts, place, values, slopes)
    axes = len(place)
    cost = 0.0
    gradient[:] = 0.0
    curvature[:] = 0.0
    for a in range(axes):
        off = place[a] - mean[a]
        cost += precision[a] * off * off
        gradient[a] = precision[a] * off
        curvature[a, a] = precision[a]
    for column in range(len(y)):
        off = values[column] - y[column]
        cost += off * off
        for a in range(axes):
            gradient[a] += slopes[column, a] * off
            for b in range(a + 1):
                curvature[a, b] += slopes[column, a] * slopes[column, b]
    for a in range(axes):
        for b in range(a):
            curvature[b, a] = curvature[a, b]
    return cost


@entry
def step_of(place, gradient, curvature, damping, target):
    """Set the target of a damped step within the ranges; coordinates held at an end stay."""
    axes = len(place)
    held = np.zeros(axes, dtype=np.bool_)
    # Of all together: where a root begins, light has no slope, and nothing of its own to be damped.
    least = 0.0
    for a in range(axes):
        least += damping * curvature[a, a] / axes
    for _ in range(axes):
        matrix = np.empty((axes, axes))
        right = np.empty(axes)
        for a in range(axes):
            at_low, at_high = place[a] <= 0.0, place[a] >= 1.0
            out = (at_low and gradient[a] > 0.0) or (at_high and gradient[a] < 0.0)
            held[a] = held[a] or out
            right[a] = 0.0 if held[a] else -gradient[a]
        for a in range(axes):
            for b in range(axes):
                matrix[a, b] = 0.0 if held[a] or held[b] else curvature[a, b]
            matrix[a, a] = 1.0 if held[a] else curvature[a, a] + least + 1e-12
        move = np.linalg.solve(matrix, right)
        blocked = False
        for a in range(axes):
            target[a] = place[a] + move[a]
            over = (place[a] <= 0.0 and target[a] < 0.0) or (place[a] >= 1.0 and target[a] > 1.0)
            if over and not held[a]:
                held[a] = True
                blocked = True
        if not blocked:
            break
    for a in range(axes):
        target[a] = min(max(target[a], 0.0), 1.0)


@entry
def descend(grid, y, mean, precision, place, curvature):
    """Move a place to where the sum of squares is least near it; set the curvature there.

    Returns
    -------
    float, bool
        The sum of squares, and whether the place has come to rest.
    """
    axes, columns = len(place), len(y)
    values, slopes = np.empty(columns), np.empty((columns, axes))
    gradient, target = np.empty(axes), np.empty(axes)
    cost = around(grid, y, (mean, precision), place, values, slopes, gradient, curvature)
    damping = 1e-3
    other_gradient, other = np.empty(axes), np.empty((axes, axes))
    for _ in range(STEPS):
        step_of(place, gradient, curvature, damping, target)
        moved = np.abs(target - place).max()
        if moved < NEAR:
            return cost, True
        found = around(grid, y, (mean, precision), target, values, slopes, other_gradient, other)
        if found <= cost:
            cost = found
            place[:] = target
            gradient[:] = other_gradient
            curvature[:] = other
            damping = max(0.1 * damping, 1e-9)
        else:
            damping = min(10.0 * damping, 1e6)
    return cost, False


@entry
def descend_each(grid, y, mean, precision, variance, places, variances, misfits):
    """Descend for every measurement; set places, variances of coordinates, and misfits.

    Parameters
    ----------
    grid : Grid
    y : float64[measurements, columns]
    mean, precision : float64[axes]
        Of the priors, precision 0 without one.
    variance : float64[axes]
        Of what was known before.
    places, variances : float64[measurements, axes]
    misfits : float64[measurements, 2]
        And whether places have come to rest, 1 or 0.
    """
    axes = len(mean)
    curvature, other_curvature = np.empty((axes, axes)), np.empty((axes, axes))
    other = np.empty(axes)
    for row in range(len(y)):
        place = places[row]
        nearest(grid.cells, grid.nodes, grid.counts, y[row], mean, precision, place)
        # Ends of ranges may be places of no slope: a second descent begins away from them.
        for a in range(axes):
            other[a] = min(max(place[a], INNER), 1.0 - INNER)
        cost, rests = descend(grid, y[row], mean, precision, place, curvature)
        second, other_rests = descend(grid, y[row], mean, precision, other, other_curvature)
        if second < cost:
            cost, rests = second, other_rests
            place[:] = other
            curvature[:] = other_curvature
        for a in range(axes):
            cost -= precision[a] * (place[a] - mean[a]) ** 2
            # The range counts as knowledge where there is no prior.
            curvature[a, a] += 1.0 / variance[a] - precision[a]
        inverse = np.linalg.inv(curvature)
        for a in range(axes):
            variances[row, a] = inverse[a, a]
        misfits[row, 0] = cost
        misfits[row, 1] = 1.0 if rests else 0.0
