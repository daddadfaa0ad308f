"""Kinds of figures with their settings, and limits on the numbers of lines, rows and panels."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from splits.core.validation import invalid

FIGURE_SETTINGS: dict[str, tuple[str, ...]] = {
    "spectra": ("quantity", "select", "wavelength_nm", "measured", "legend", "ylim"),
    "points": ("quantity", "select", "legend"),
    "summary": ("quantity", "select", "legend"),
    "hemisphere": ("quantity", "select", "legend"),
    "principal_plane": ("quantity", "select", "legend", "ylim"),
    "season": ("quantity",),
    **dict.fromkeys(("return", "range_bias", "polarization"), ("select", "legend")),
    **dict.fromkeys(("lobes", "bins", "spread", "surface", "lens", "swatches"), ("select",)),
    "refractive_index": (),
}
"""Settings of each kind of figure, the arguments of the function that draws it."""

INSTRUMENT_FIGURES: dict[str, tuple[str, ...]] = {
    "refractive_index": ("refractive_index",),
    "spectrophotometer": ("spectra", "points", "swatches", "season"),
    "albedo": ("season",),
    "goniophotometer": ("principal_plane", "hemisphere", "lobes", "bins", "polarization"),
    "beam_spread": ("spread",),
    **dict.fromkeys(("time_of_flight", "return_table"), ("return", "range_bias")),
    "surface_map": ("surface",),
    "lens": ("lens",),
    "table": ("summary",),
}
"""Kinds of figures by instrument, the default first."""
DEFAULT_LABEL = "default"
"""Label of the reference value of a parameter, whose line is black and on top."""
MAX_LINES = 60
"""Largest number of lines, or series of points, in a panel."""
MAX_PANELS = 24
"""Largest number of panels in a figure."""
MAX_ROWS = 80
"""Largest number of rows of points or colour patches."""
MAX_COLUMNS = 16
"""Largest number of columns of colour patches."""
MIN_AZIMUTHS, MIN_POLAR_ANGLES, MAX_AZIMUTH_GAP_DEG = 8, 3, 60.0
"""Smallest numbers of directions of a hemisphere map, and the largest gap in azimuth."""


def check_settings(kind: str, section: Mapping[str, object]) -> None:
    """Reject given settings of a figure that its kind, or a figure left out, does not have."""
    for key, value in section.items():
        if value and key not in ("kind", "note", *FIGURE_SETTINGS.get(kind, ())):
            owners = [one for one, settings in FIGURE_SETTINGS.items() if key in settings]
            allowed, hint = f"left out for kind {kind}", f"it belongs to {', '.join(owners)}"
            raise invalid(f"figure.{key}", value, allowed, hint)


def check_count(
    items: str, count: int, limit: int, selection: Mapping[str, object] | None = None
) -> None:
    """Reject a figure with more items than a limit.

    Raises
    ------
    ValueError
        The message names the remedy.
    """
    if count > limit:
        allowed = f"with values of enough parameters to leave at most {limit} {items} of {count}"
        hint = "the dataset holds all; or use figure: none"
        raise invalid("figure.select", dict(selection or {}), allowed, hint)


def choose_panel_parameters(
    sizes: Mapping[str, int], n_quantities: int = 1, selection: Mapping[str, object] | None = None
) -> list[str]:
    """Return the parameters with one panel per value, none if one panel shows all lines.

    Parameters
    ----------
    sizes : mapping
        Numbers of values of the free parameters of the grid, in order.
    n_quantities : int
        Number of quantities, each with its own panels.
    selection : mapping, optional
        Selected labels of the grid, for the message.

    Returns
    -------
    list of str
        At most two: all varying parameters except the first, whose values are lines.

    Raises
    ------
    ValueError
        If neither one panel of `MAX_LINES` nor `MAX_PANELS` panels suffice.
    """
    count = math.prod(sizes.values())
    if count <= MAX_LINES:
        return []
    first, *others = (name for name, size in sizes.items() if size > 1)
    panels = n_quantities * (count // sizes[first])
    if sizes[first] > MAX_LINES or len(others) > 2 or panels > MAX_PANELS:
        items = (
            f"lines, or {MAX_PANELS} panels of two more parameters with at most {MAX_LINES} "
            "lines of the first,"
        )
        check_count(items, count, MAX_LINES, selection)
    return others


def can_map_hemisphere(polar_deg: np.ndarray, azimuth_deg: np.ndarray) -> bool:
    """Return whether directions cover all azimuths densely enough for a hemisphere map.

    Parameters
    ----------
    polar_deg, azimuth_deg : float, shape (angles,)
        Angles whose combinations are the directions.
    """
    if np.size(azimuth_deg) < MIN_AZIMUTHS or np.size(polar_deg) < MIN_POLAR_ANGLES:
        return False
    azimuth = np.sort(azimuth_deg)
    return bool(np.diff(azimuth, append=azimuth[0] + 360.0).max() <= MAX_AZIMUTH_GAP_DEG)
