"""Settings of figures as annotated types, and limits on numbers of lines, rows and panels."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
import xarray as xr
from pydantic import BeforeValidator

from splits.core.declarations import Quantity
from splits.core.inputs import FiniteNumber, Interval
from splits.core.validation import (
    MAX_LABEL_CHARS,
    MAX_TITLE_CHARS,
    as_scalar,
    check_choice,
    check_text,
    invalid,
)
from splits.io.netcdf import select_points


def check_quantity_names(key: str, value: Any) -> tuple[str, ...]:
    """Return one name, or several, as a tuple; reject none at all and repeated ones."""
    names = (value,) if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(one, str) for one in names):
        raise invalid(key, value, "a name, or a list of names")
    if not names or len({*names}) < len(names):
        raise invalid(key, value, "at least one, without repetition")
    return tuple(names)


def check_formula(key: str, text: Any, max_chars: int = MAX_LABEL_CHARS) -> str:
    """Return a text that may contain formulas between dollar signs; reject invalid formulas."""
    if not isinstance(text, str):
        raise invalid(key, text, "text", "put it into quotes" if np.isscalar(text) else "")
    check_text(key, text, max_chars)
    # A single dollar sign starts no formula.
    n_dollars = text.count("$") - text.count(r"\$")
    if n_dollars >= 2 and n_dollars % 2 == 0:
        from matplotlib.mathtext import MathTextParser  # optional, and its import is slow

        try:
            MathTextParser("path").parse(text)
        except (ValueError, RuntimeError):
            hint = r"write \$ for a dollar sign"
            raise invalid(key, text, "text that matplotlib can typeset", hint) from None
    return text


def _label_values(values: Any) -> Any:
    # Labels of booleans on a grid are texts.
    if not isinstance(values, Mapping):
        return values
    scalars = {str(key): as_scalar(value) for key, value in values.items()}
    return {key: str(one) if isinstance(one, bool) else one for key, one in scalars.items()}


# A setting that is None, or an empty selection, is left out.
Quantities = Annotated[
    tuple[str, ...],
    Quantity(
        "one quantity, or several",
        check=check_quantity_names,
        schema={"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]},
    ),
]
SpectralRange = Annotated[
    Interval | None, Quantity("limits of the wavelength axis, by default all", "nm")
]
Selection = Annotated[
    dict[str, FiniteNumber | str] | None,
    BeforeValidator(_label_values),
    Quantity(
        "values at which parameters of the grid are fixed: a text is a label, a number is a value; "
        "required for figures that show one point"
    ),
]
Measured = Annotated[
    pd.DataFrame | None,
    Quantity("measured values to draw with the spectra", check=lambda _, value: value),
]
Legend = Annotated[
    str | None,
    Quantity(
        "title of the legend, by default the parameters of the grid; may contain formulas between "
        "dollar signs",
        check=check_formula,
        schema={"type": "string", "maxLength": MAX_LABEL_CHARS},
    ),
]
Limits = Annotated[
    Interval | None,
    Quantity(
        "limits of the vertical axis; in a figure of differences from `default`, those of the "
        "panel of the default"
    ),
]
Note = Annotated[
    str | None,
    Quantity(
        "a sentence below the figure; may contain formulas between dollar signs",
        check=lambda key, text: check_formula(key, text, MAX_TITLE_CHARS),
        schema={"type": "string", "maxLength": MAX_TITLE_CHARS},
    ),
]

DEFAULT_LABEL = "default"
"""Label of the reference value of a parameter, whose line is black and on top."""
MAX_LINES = 60
"""Largest number of lines, or series of points, in a panel."""
MAX_PANELS = 24
"""Largest number of panels in a figure."""
MAX_ROWS = 80
"""Largest number of rows of points or colour patches."""
MIN_AZIMUTHS, MIN_POLAR_ANGLES, MAX_AZIMUTH_GAP_DEG = 8, 3, 60.0
"""Smallest numbers of directions of a hemisphere map, and the largest gap in azimuth."""


def check_count(
    items: str, count: int, limit: int, selection: Mapping[str, object] | None = None
) -> None:
    """Reject a figure with more items than a limit; the message names the remedy."""
    if count > limit:
        allowed = f"with values of enough parameters to leave at most {limit} {items} of {count}"
        hint = "the dataset holds all; or use figure: none"
        raise invalid("select", dict(selection or {}), allowed, hint)


def choose_quantities(
    dataset: xr.Dataset, given: Sequence[str] | None, names: Sequence[str]
) -> tuple[str, ...]:
    """Return the given quantities, by default the first one of those that a kind of figure has."""
    if not names:
        given_names, hint = (
            ", ".join(map(str, dataset)),
            "without a kind, draw chooses one that fits",
        )
        raise invalid(
            "dataset", f"with {given_names}", "with quantities of the figure's kind", hint
        )
    for name in given or ():
        check_choice("quantity", name, names)
    return tuple(given or names[:1])


def select_one_point(
    dataset: xr.Dataset, select: Mapping[str, float | str] | None, kind: str, max_free: int = 0
) -> xr.Dataset:
    """Return the dataset at labels of its grid, of which a kind of figure shows one point.

    Parameters
    ----------
    dataset : xarray.Dataset
    select : mapping, optional
    kind : str
    max_free : int
        Number of parameters that may vary.
    """
    select = select or {}
    grid = json.loads(dataset.attrs.get("configuration", "{}")).get("grid", {})
    free = [name for name in grid if name in dataset.dims and name not in select]
    if len(free) > max_free:
        allowed = f"with a value of {', '.join(free)} for a figure of kind {kind}"
        hint = "it shows one point of the grid; the dataset holds all"
        raise invalid("select", dict(select), allowed, hint)
    return select_points(dataset, select)


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
