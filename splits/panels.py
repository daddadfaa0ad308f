"""How much a figure can show: lines, rows and panels, counted from the sizes of a grid.

Configuration is held against these limits before anything runs, figures when they are drawn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from splits.checks import refuse

DEFAULT = "default"
"""Label of a value that the others are read against: its line is black and on top."""
MOST_LINES = 60
"""Lines that one panel can show, and series of points."""
MOST_PANELS = 24
"""Panels that a page can show."""
MOST_ROWS = 80
"""Rows of points, and of patches of colour, that one can look up."""
MOST_COLUMNS = 16
"""Patches of colour side by side."""
FEWEST_AZIMUTHS, FEWEST_POLAR, WIDEST_GAP_DEG = 8, 3, 60.0
"""Directions that a map of the hemisphere needs: so many, and no larger gap around."""
HOW = "the dataset holds all; figure: none draws nothing"


def too_many(what: str, count: int, limit: int, selection: object) -> ValueError:
    """Return the error that says that a figure would show too much, and how to show less."""
    allowed = f"with values of so many parameters that at most {limit} {what} are left of {count}"
    return refuse("figure.at", dict(selection) if isinstance(selection, Mapping) else selection, allowed, HOW)


def check_count(what: str, count: int, limit: int, selection: Mapping[str, object]) -> None:
    """Refuse a figure of more than so many things.

    Raises
    ------
    ValueError
        The message says how to show less.
    """
    if count > limit:
        raise too_many(what, count, limit, selection)


def facets(
    sizes: Mapping[str, int], n_quantities: int = 1, selection: Mapping[str, object] | None = None
) -> list[str]:
    """Return the parameters whose values get a panel each, none if one panel shows all lines.

    Parameters
    ----------
    sizes : mapping
        Numbers of values of the grid's parameters that are not held fixed, in order.
    quantities : int
        Each has panels of its own.
    at : mapping, optional
        Labels of the grid held fixed, for the message.

    Returns
    -------
    list of str
        At most two: all that vary but the first, whose values are lines.

    Raises
    ------
    ValueError
        If neither one panel of `MOST_LINES` nor `MOST_PANELS` of them show all.
    """
    count = math.prod(sizes.values())
    if count <= MOST_LINES:
        return []
    first, *others = (name for name, size in sizes.items() if size > 1)
    panels = n_quantities * (count // sizes[first])
    if sizes[first] > MOST_LINES or len(others) > 2 or panels > MOST_PANELS:
        what = (
            f"lines, or {MOST_PANELS} panels of two more parameters with at most {MOST_LINES} "
            "lines of the first,"
        )
        raise too_many(what, count, MOST_LINES, selection or {})
    return others


def mappable(polar_deg: np.ndarray, azimuth_deg: np.ndarray) -> bool:
    """Return whether directions lie all around, so that a map of the hemisphere can show them.

    Parameters
    ----------
    polar_deg, azimuth_deg : float, shape (angles,)
        All combinations are directions.
    """
    if np.size(azimuth_deg) < FEWEST_AZIMUTHS or np.size(polar_deg) < FEWEST_POLAR:
        return False
    around = np.sort(azimuth_deg)
    return bool(np.diff(around, append=around[0] + 360.0).max() <= WIDEST_GAP_DEG)
