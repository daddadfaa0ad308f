"""Numbers of colours in documents: CIELAB coordinates of the named sands."""

from __future__ import annotations

from collections.abc import Callable

import xarray as xr

from _numbers.formatting import QuotedNumber, QuotedValue
from splits.analysis.colour import make_colour_table

NAMED_SANDS_FILE = "data/named_sands.nc"
NAMED_SANDS = {
    "white": "white quartz",
    "yellow": "yellow dune",
    "red": "red dune",
    "black": "black magnetite",
    "beach.dry": "beach, dry",
    "beach.wet": "beach, wet",
}
"""Labels of the experiment `named_sands` by key."""


def _select_coordinate(name: str, sand: str) -> Callable[[xr.Dataset], QuotedValue]:
    """Return a selector of a CIELAB coordinate of a sand, with its standard error."""

    def select(dataset: xr.Dataset) -> QuotedValue:
        row = make_colour_table(dataset.sel(medium=[sand])).iloc[0]
        return float(row[name]), float(row[f"{name}_stderr"]), ""

    return select


COLOUR_NUMBERS = {
    f"colour.{key}.{name.lower()}": QuotedNumber(
        NAMED_SANDS_FILE, _select_coordinate(name, sand), ".1f"
    )
    for key, sand in NAMED_SANDS.items()
    for name in ("L", "a", "b")
}
"""Coordinates L*, a*, b* of the named sands, by key."""
