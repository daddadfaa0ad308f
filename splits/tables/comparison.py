"""Spectra between the nodes of a table, which measure the error of its interpolation.

For each numeric axis, the solver of the table also solves positions between all neighbouring nodes,
with the other axes at a few of their nodes.  Both are solved together, with the same numbers of
streams or the same rays, so that their differences are more precise than their values.  Axes that
do not share paths are not compared: their differences would have the full noise of the rays.

In the dataset of a table, the values at the nodes and between those of the axis AXIS are the
variables QUANTITY_along_AXIS, over the dimensions NAME_along_AXIS for each axis NAME.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from splits.tables.axes import ALONG, ANGLES, POLAR, ParameterGrid, list_axes, list_quantities
from splits.tables.interpolation import COORDINATES, MIN_COMPARED, transform_axis

POSITIONS = {"few nodes": (0.15, 0.5, 0.85), "more nodes": (0.25, 0.75)}
"""Compared positions in an interval, as fractions of it in the default coordinate.  With few nodes,
one difference more makes up for the choice of the coordinate."""
MAX_FEW_NODES = 4
N_OTHER_NODES = {"by ordinates": (3, 5), "by paths": (3, 3)}
"""Smallest and largest number of compared nodes of every other axis, about every second one of the
table: an error may change its sign along it more than once, and be large between nodes where it is
small."""
MAX_OTHER_MEDIA = {"by ordinates": 48, "by paths": 6}
"""Largest number of combinations of nodes of the other axes, without angles, unless both ends of
all axes need more.  Paths have much larger errors, and may keep the middle of an axis only."""
N_OTHER_ANGLES = 13
"""Number of nodes of every other angle in a table with directions."""


def list_comparison_grids(
    grid: ParameterGrid, axes: Sequence[str], *, by_ordinates: bool = True
) -> dict[str, ParameterGrid]:
    """Return the grid of the comparison along each axis.

    Parameters
    ----------
    grid : ParameterGrid
        Grid of the table, with directions of observation.
    axes : sequence of str
        Axes to compare; those of text or of a single node are left out.
    by_ordinates : bool
        Whether discrete ordinates solve the table.
    """
    has_direction = POLAR in grid
    grids = {}
    for name in axes:
        if len(grid[name]) < 2 or isinstance(grid[name][0], str):
            continue
        nodes = np.array(grid[name], dtype=float)
        # As many positions between all neighbouring nodes.
        kind, t = transform_axis(name, nodes, has_direction=has_direction)
        fractions = POSITIONS["few nodes" if nodes.size <= MAX_FEW_NODES else "more nodes"]
        rows = [t[:-1] + fraction * np.diff(t) for fraction in fractions]
        between = COORDINATES[kind].invert(np.stack(rows, axis=1).ravel())
        positions = np.sort(np.concatenate([nodes, between]))
        thinned = _thin_axes(grid.drop(name), has_direction, by_ordinates)
        grids[name] = ParameterGrid(grid | thinned | {name: tuple(positions.tolist())})
    return grids


def _thin_axes(grid: ParameterGrid, has_direction: bool, by_ordinates: bool) -> ParameterGrid:
    """Return a grid of a few nodes of every axis, with both ends where possible; texts are kept."""
    counts, kind = {}, "by ordinates" if by_ordinates else "by paths"
    fewest, most = N_OTHER_NODES[kind]
    for name, values in grid.items():
        is_direction = has_direction and name in ANGLES
        limit = N_OTHER_ANGLES if is_direction else min(max(fewest, len(values) // 2 + 1), most)
        is_text = isinstance(values[0], str)
        counts[name] = len(values) if is_text else min(len(values), limit)
    media = [
        name for name, values in grid.items()
        if name not in ANGLES and not isinstance(values[0], str)
    ]  # fmt: skip
    max_media = MAX_OTHER_MEDIA[kind]
    while media and math.prod(counts[name] for name in media) > max_media:
        largest = max(reversed(media), key=lambda name: counts[name])
        # An error may vanish in the middle of an axis: both ends stay.
        if counts[largest] == 1 or (by_ordinates and counts[largest] == 2):
            break
        counts[largest] -= 1
    thinned = ParameterGrid()
    for name, values in grid.items():
        count, last = counts[name], len(values) - 1
        chosen = [last // 2] if count == 1 else np.linspace(0, last, count).round().astype(int)
        thinned[name] = tuple(values[i] for i in chosen)
    return thinned


def rename_comparison(part: xr.Dataset, name: str) -> xr.Dataset:
    """Return a comparison with the names of its variables in a table."""
    for variable in part.data_vars.values():
        variable.attrs = {
            "long_name": f"{variable.attrs['long_name']} at and between nodes of {name}",
            "units": "1",
        }
    names = [str(n) for n in (*part.data_vars, *part.dims) if n != "wavelength"]
    return part.drop_attrs(deep=False).rename({n: f"{n}{ALONG}{name}" for n in names})


def extract_comparisons(dataset: xr.Dataset) -> dict[str, xr.Dataset]:
    """Return the comparisons of a table by axis.

    Those that do not belong to the nodes are left out: the table may be a selection of other nodes,
    or several tables that were joined.
    """
    quantities, found = list_quantities(dataset), {}
    for name in list_axes(dataset)[:-1]:
        suffix = f"{ALONG}{name}"
        kept = [q for q in quantities if q + suffix in dataset and name in dataset[q].dims]
        if not kept:
            continue
        part = dataset[[q + suffix for q in kept]]
        expected = [
            {n if n == "wavelength" else f"{n}{suffix}" for n in dataset[q].dims} for q in kept
        ]
        if [set(part[q + suffix].dims) for q in kept] != expected:
            continue
        names = [*part.data_vars, *(d for d in part.dims if d != "wavelength")]
        part = part.rename({n: str(n).removesuffix(suffix) for n in names}).sortby(name)
        if _fits(part, name, dataset):
            found[name] = part.load()
    return found


def _fits(part: xr.Dataset, name: str, dataset: xr.Dataset) -> bool:
    """Return whether a comparison is that of the nodes of a table."""
    for other in map(str, part.dims):
        nodes, positions = dataset[other].values, part[other].values
        if other == name:
            step, rest = divmod(len(positions) - 1, max(len(nodes) - 1, 1))
            fits = step > MIN_COMPARED and not rest and np.array_equal(positions[::step], nodes)
        elif other == "wavelength":
            fits = True
        elif nodes.dtype.kind != "f":
            fits = set(nodes.tolist()) <= set(positions.tolist())
        else:
            is_within = positions.min() <= nodes[0] and nodes[-1] <= positions.max()
            fits = is_within or (len(positions) == 1 and positions[0] in nodes)
        if not fits:
            return False
    return not any(np.isnan(variable).any() for variable in part.data_vars.values())
