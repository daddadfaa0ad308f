"""Nodes of coarse tables of refractive indices, at which spectra may have kinks."""

from __future__ import annotations

import re

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from splits.materials import TabulatedIndex, list_datasets, make_refractive_index

COARSE_STEP_RATIO = 2.0
"""Spacing of rows, in steps of the wavelengths, above which a table is coarse."""
_INDEX_ATTRIBUTE = re.compile(r"(?P<medium>\w+?)_refractive_index_(?P<material>[a-z]+)")
_FRACTION_PARAMETERS = {"water": ("saturation",), "hematite": ("iron_oxide", "hematite_ratio"),
           "magnetite": ("magnetite",)}  # fmt: skip
"""Parameters that must all be above 0 for a material to be present."""


_TICK_COLOURS = {
    "water": ("#c8553d", "red"), "ice": ("#1f6fb4", "blue"), "hematite": ("#7b3294", "purple"),
}  # fmt: skip
_TICK_LENGTHS_PT = (8.0, 5.0, 3.0, 2.0)
"""Lengths (points) of the ticks of successive tables, half of which is above the axis."""


def find_coarse_nodes(dataset: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the rows of coarse tables within a spectrum.

    Parameters
    ----------
    dataset : xarray.Dataset
        Over wavelength.  Its attributes name the tables in use; users' own tables are ignored.

    Returns
    -------
    dict
        Wavelengths (nm) by material and table, such as ``"water (Hale & Querry 1973)"``, in order
        of decreasing gaps.
    """
    x = dataset.wavelength.values
    if x.size < 3:
        return {}
    step = float(np.median(np.diff(x)))
    nodes: dict[str, tuple[float, np.ndarray]] = {}
    for key, name in dataset.attrs.items():
        match = _INDEX_ATTRIBUTE.fullmatch(str(key))
        if match is None or not _is_in_use(dataset, match["medium"], match["material"]):
            continue
        table = _find_table(match["material"], str(name))
        if table is None:
            continue
        rows = table.wavelength_nm
        is_wide = np.diff(rows) > COARSE_STEP_RATIO * step
        largest_gap = np.diff(rows)[(rows[1:] > x[0]) & (rows[:-1] < x[-1])].max(initial=0.0)
        is_at_gap = np.concatenate([[False], is_wide]) | np.concatenate([is_wide, [False]])
        rows = rows[is_at_gap & (rows >= x[0]) & (rows <= x[-1])]
        if rows.size:
            label = f"{match['material']} ({_format_table_name(str(name))})"
            nodes[label] = (float(largest_gap), rows)
    order = sorted(nodes, key=lambda label: -nodes[label][0])
    return {label: nodes[label][1] for label in order}


def _format_table_name(name: str) -> str:
    """Return the printed name of a table, such as Hale & Querry 1973."""
    authors = re.sub(r"^([a-z]+)_([a-z]+)_(\d{4})", r"\1 & \2 \3", name.partition(",")[0])
    return authors.replace("_", " ").title()


def _is_in_use(dataset: xr.Dataset, medium: str, material: str) -> bool:
    """Return whether a medium contains a material according to its attributes."""
    fractions = [
        dataset.attrs.get(f"{medium}_{key}") for key in _FRACTION_PARAMETERS.get(material, ())
    ]
    return all(fraction is None or float(fraction) > 0.0 for fraction in fractions)


def _find_table(material: str, name: str) -> TabulatedIndex | None:
    """Return a table of the datasets by its name, without its factor of k."""
    base_name = name.partition(", k x")[0]
    try:
        available = list_datasets(material)
    except ValueError:
        return None
    index = make_refractive_index(material, base_name) if base_name in available else None
    return index if isinstance(index, TabulatedIndex) else None


def draw_node_ticks(axes: Axes, nodes: dict[str, np.ndarray]) -> None:
    """Draw a tick upwards from the wavelength axis at every row of the tables."""
    for (name, rows), length in zip(nodes.items(), _TICK_LENGTHS_PT, strict=False):
        axes.plot(
            rows, np.zeros(rows.size), "|", transform=axes.get_xaxis_transform(), ms=length,
            color=_get_tick_colour(name)[0], mew=0.7, zorder=1.0, label="_nodes",
        )  # fmt: skip


def make_nodes_note(nodes: dict[str, np.ndarray]) -> str:
    """Return the note that explains the ticks."""
    if not nodes:
        return ""
    tables = ", ".join(
        name.replace(")", f", {_get_tick_colour(name)[1]})") if len(nodes) > 1 else name
        for name in nodes
    )
    return f"Ticks above the axis: rows of coarse tables, at which spectra may kink: {tables}."


def _get_tick_colour(name: str) -> tuple[str, str]:
    """Return the colour of a material's ticks, and the name of the colour."""
    return _TICK_COLOURS.get(name.partition(" ")[0], ("#666666", "grey"))
