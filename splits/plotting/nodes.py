"""Rows of coarse tables of refractive indices, at whose wavelengths spectra may kink."""

from __future__ import annotations

import re

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from splits.materials import TabulatedIndex, list_datasets, make_refractive_index

COARSE_STEP_RATIO = 2.0
"""A table is coarse where its rows are farther apart than so many steps of the wavelengths."""
_INDEX_ATTRIBUTE = re.compile(r"(?P<medium>\w+?)_refractive_index_(?P<material>[a-z]+)")
_FRACTION_PARAMETERS = {"water": ("saturation",), "hematite": ("iron_oxide", "hematite_ratio"),
           "magnetite": ("magnetite",)}  # fmt: skip
"""Parameters of which none may be 0 where a material is in use."""


_TICK_COLOURS = {
    "water": ("#c8553d", "red"), "ice": ("#1f6fb4", "blue"), "hematite": ("#7b3294", "purple"),
}  # fmt: skip
_TICK_LENGTHS_PT = (8.0, 5.0, 3.0, 2.0)
"""Lengths (points) of the ticks of one table after the other: half of it is above the axis."""


def find_coarse_nodes(dataset: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the rows of coarse tables within a spectrum.

    Parameters
    ----------
    dataset : xarray.Dataset
        Over wavelength; its attributes name the tables in use.  Tables of users are not known by
        their name.

    Returns
    -------
    dict
        Wavelengths (nm) by material and table, such as ``"water (Hale & Querry 1973)"``; those of
        the largest gaps first.
    """
    x = dataset.wavelength.values
    if x.size < 3:
        return {}
    step = float(np.median(np.diff(x)))
    found: dict[str, tuple[float, np.ndarray]] = {}
    for key, name in dataset.attrs.items():
        named = _INDEX_ATTRIBUTE.fullmatch(str(key))
        if named is None or not _is_in_use(dataset, named["medium"], named["material"]):
            continue
        table = _find_table(named["material"], str(name))
        if table is None:
            continue
        rows = table.wavelength_nm
        wide = np.diff(rows) > COARSE_STEP_RATIO * step
        widest = np.diff(rows)[(rows[1:] > x[0]) & (rows[:-1] < x[-1])].max(initial=0.0)
        beside = np.concatenate([[False], wide]) | np.concatenate([wide, [False]])
        rows = rows[beside & (rows >= x[0]) & (rows <= x[-1])]
        if rows.size:
            words = f"{named['material']} ({_format_table_name(str(name))})"
            found[words] = (float(widest), rows)
    order = sorted(found, key=lambda words: -found[words][0])
    return {words: found[words][1] for words in order}


def _format_table_name(name: str) -> str:
    """Return the name of a table as a reader knows it: Hale & Querry 1973."""
    authors = re.sub(r"^([a-z]+)_([a-z]+)_(\d{4})", r"\1 & \2 \3", name.partition(",")[0])
    return authors.replace("_", " ").title()


def _is_in_use(dataset: xr.Dataset, medium: str, material: str) -> bool:
    """Return whether a medium has some of a material, as far as its attributes say."""
    shares = [
        dataset.attrs.get(f"{medium}_{key}") for key in _FRACTION_PARAMETERS.get(material, ())
    ]
    return all(share is None or float(share) > 0.0 for share in shares)


def _find_table(material: str, name: str) -> TabulatedIndex | None:
    """Return a table of the datasets by its name, whatever its k is multiplied with."""
    plain = name.partition(", k x")[0]
    try:
        known = list_datasets(material)
    except ValueError:
        return None
    index = make_refractive_index(material, plain) if plain in known else None
    return index if isinstance(index, TabulatedIndex) else None


def draw_node_ticks(axes: Axes, nodes: dict[str, np.ndarray]) -> None:
    """Draw a tick upwards from the wavelength axis at every row of the tables."""
    for (name, rows), length in zip(nodes.items(), _TICK_LENGTHS_PT, strict=False):
        axes.plot(
            rows, np.zeros(rows.size), "|", transform=axes.get_xaxis_transform(), ms=length,
            color=_get_tick_colour(name)[0], mew=0.7, zorder=1.0, label="_nodes",
        )  # fmt: skip


def make_nodes_note(nodes: dict[str, np.ndarray]) -> str:
    """Return what the ticks are."""
    if not nodes:
        return ""
    tables = ", ".join(
        name.replace(")", f", {_get_tick_colour(name)[1]})") if len(nodes) > 1 else name
        for name in nodes
    )
    return f"Ticks above the axis: rows of coarse tables, where spectra may kink: {tables}."


def _get_tick_colour(name: str) -> tuple[str, str]:
    """Return the colour of a material's ticks, and the colour's name."""
    return _TICK_COLOURS.get(name.partition(" ")[0], ("#666666", "grey"))
