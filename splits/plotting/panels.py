"""How much a figure can show: lines, rows and panels, counted from the sizes of a grid.

Configuration is held against these limits before anything runs, figures when they are drawn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from splits.core.validation import invalid

DEFAULT_LABEL = "default"
"""Label of a value that the others are read against: its line is black and on top."""
MAX_LINES = 60
"""Lines that one panel can show, and series of points."""
MAX_PANELS = 24
"""Panels that a page can show."""
MAX_ROWS = 80
"""Rows of points, and of patches of colour, that one can look up."""
MAX_COLUMNS = 16
"""Patches of colour side by side."""
MIN_AZIMUTHS, MIN_POLAR_ANGLES, MAX_AZIMUTH_GAP_DEG = 8, 3, 60.0
"""Directions that a map of the hemisphere needs: so many, and no larger gap around."""
REDUCTION_HINT = "the dataset holds all; figure: none draws nothing"


def make_limit_error(what: str, count: int, limit: int, selection: object) -> ValueError:
    """Return the error that says that a figure would show too much, and how to show less."""
    allowed = f"with values of so many parameters that at most {limit} {what} are left of {count}"
    return invalid(
        "figure.select",
        dict(selection) if isinstance(selection, Mapping) else selection,
        allowed,
        REDUCTION_HINT,
    )


def check_count(what: str, count: int, limit: int, selection: Mapping[str, object]) -> None:
    """Reject a figure of more than so many things.

    Raises
    ------
    ValueError
        The message says how to show less.
    """
    if count > limit:
        raise make_limit_error(what, count, limit, selection)


def choose_panel_parameters(
    sizes: Mapping[str, int], n_quantities: int = 1, selection: Mapping[str, object] | None = None
) -> list[str]:
    """Return the parameters whose values get a panel each, none if one panel shows all lines.

    Parameters
    ----------
    sizes : mapping
        Numbers of values of the grid's parameters that are not held fixed, in order.
    n_quantities : int
        Each has panels of its own.
    selection : mapping, optional
        Labels of the grid held fixed, for the message.

    Returns
    -------
    list of str
        At most two: all that vary but the first, whose values are lines.

    Raises
    ------
    ValueError
        If neither one panel of `MAX_LINES` nor `MAX_PANELS` of them show all.
    """
    count = math.prod(sizes.values())
    if count <= MAX_LINES:
        return []
    first, *others = (name for name, size in sizes.items() if size > 1)
    panels = n_quantities * (count // sizes[first])
    if sizes[first] > MAX_LINES or len(others) > 2 or panels > MAX_PANELS:
        what = (
            f"lines, or {MAX_PANELS} panels of two more parameters with at most {MAX_LINES} "
            "lines of the first,"
        )
        raise make_limit_error(what, count, MAX_LINES, selection or {})
    return others


def can_map_hemisphere(polar_deg: np.ndarray, azimuth_deg: np.ndarray) -> bool:
    """Return whether directions lie all around, so that a map of the hemisphere can show them.

    Parameters
    ----------
    polar_deg, azimuth_deg : float, shape (angles,)
        All combinations are directions.
    """
    if np.size(azimuth_deg) < MIN_AZIMUTHS or np.size(polar_deg) < MIN_POLAR_ANGLES:
        return False
    around = np.sort(azimuth_deg)
    return bool(np.diff(around, append=around[0] + 360.0).max() <= MAX_AZIMUTH_GAP_DEG)
