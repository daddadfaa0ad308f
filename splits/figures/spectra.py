"""Spectra: a quantity over wavelength, one line per point of the grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.dataset import at_points
from splits.escaping import escape_mathtext
from splits.figures.conditions import conditions
from splits.figures.facets import faceted
from splits.figures.lines import Lines, above
from splits.figures.nodes import coarse_nodes, mark_nodes, nodes_note
from splits.figures.notes import finished
from splits.figures.shifts import read_against, shifts
from splits.figures.style import BAND, style, subplots
from splits.panels import facets

MATERIAL_COLOURS = {
    "ice": "#1f6fb4",
    "water": "#c8553d",
    "quartz": "#666666",
    "hematite": "#7b3294",
    "goethite": "#c79100",
    "magnetite": "#111111",
    "kaolinite": "#7fb069",
}
"""Materials that figures of refractive indices show; mixtures follow from them."""
_LONGEST_LINE = 30
"""Letters that fit along an axis."""


def spectra(
    dataset: xr.Dataset,
    quantity: Sequence[str] = ("reflectance",),
    wavelength_nm: tuple[float, float] | None = None,
    at: Mapping[str, float | str] | None = None,
    measured: pd.DataFrame | None = None,
    legend: str | None = None,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw spectra with bands of two standard errors, of many points in several panels.

    Where one value of the grid's only parameter is labelled ``default``, panels show how far the
    others lie from it; then `ylim` is that of the default's panel, and there is no legend.

    Parameters
    ----------
    dataset : xarray.Dataset
        As written by an experiment.
    quantity : sequence of str
        One panel each.
    wavelength_nm : (low, high), optional
        Part of the spectrum to show.
    at : mapping, optional
        Grid labels to hold fixed.
    measured : pandas.DataFrame, optional
        Columns ``wavelength_nm``, ``reflectance`` and optionally its ``_min`` and ``_max``.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    ylim : (low, high), optional

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For more lines than can be shown, see `splits.panels.facets`.
    """
    dataset = at_points(dataset, at or {})
    if wavelength_nm:
        dataset = dataset.sel(wavelength=slice(*wavelength_nm))
    dims = [str(d) for d in dataset[quantity[0]].dims if d != "wavelength"]
    note = conditions(dataset, at)
    if apart := facets({d: dataset.sizes[d] for d in dims}, len(quantity), at):
        return faceted(dataset, quantity, apart, legend, ylim, note)
    dim = None if measured is not None else read_against(dataset, dims)
    if dim:
        labels = ("wavelength (nm)", quantity)
        return shifts(dataset, quantity, dim, "wavelength", labels, note, ylim)
    lines = Lines(dataset, dims)
    nodes = coarse_nodes(dataset)
    with style():
        figure, panels = subplots(
            len(quantity), 1, height=2.2 * len(quantity), squeeze=False, sharex=True
        )
        shown = []
        for axes, name in zip(panels[:, 0], quantity, strict=True):
            _lines(axes, dataset, name, lines)
            if measured is not None and name in measured:
                shown = [_measured(axes, measured, name)]
            axes.set_ylabel(_label(dataset[name]))
            axes.set_ylim(ylim or (0.0, None))
            axes.margins(x=0.01)
            mark_nodes(axes, nodes)
            axes.spines[["top", "right"]].set_visible(False)
        panels[-1, 0].set_xlabel("wavelength (nm)")
        lines.add_legend(figure, list(panels[:, 0]), legend, extra_handles=shown)
        return finished(figure, panels.flat, note, nodes_note(nodes))


def _lines(axes: Axes, dataset: xr.Dataset, name: str, lines: Lines) -> None:
    for line in lines.lines:
        part = dataset.sel(line.labels)
        x, y = part.wavelength.values, part[name].values
        error = BAND * part[f"{name}_stderr"].values
        axes.plot(x, y, label=line.label or "model", **line.to_plot_style())
        axes.fill_between(
            x, np.maximum(y - error, 0.0), y + error, color=line.colour, alpha=0.25, lw=0
        )


def _measured(axes: Axes, table: pd.DataFrame, name: str) -> Artist:
    y = table[name]
    span = None
    if f"{name}_min" in table:
        span = np.stack([y - table[f"{name}_min"], table[f"{name}_max"] - y])
    return axes.errorbar(  # type: ignore[return-value]
        table["wavelength_nm"], y, span, fmt="s", color="black", ms=2.5, label="measured"
    )


def _label(variable: xr.DataArray) -> str:
    """Return what an axis shows, on two lines if it is long."""
    words = escape_mathtext(str(variable.attrs.get("long_name", variable.name)))
    first, _, last = words.rpartition(" ")
    return f"{first}\n{last}" if first and len(words) > _LONGEST_LINE else words


def refractive_indices(dataset: xr.Dataset) -> Figure:
    """Draw n (left axis) and k (right axis, logarithmic) of the materials of `MATERIAL_COLOURS`.

    Of a stack, a material that has the same index in several layers is shown once.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variables ``n`` and ``k`` over wavelength and material.
    """
    with style():
        figure, left = subplots(height=2.6)
        right = left.twinx()
        nodes = coarse_nodes(dataset)
        for material, label, colour in _materials(dataset):
            part = dataset.sel(material=material)
            left.plot(part.wavelength, part.n, color=colour, label=label)
            if float(part.k.max()) > 0.0:
                right.plot(part.wavelength, part.k, color=colour, ls="--")
                _rows(right, part, nodes, colour)
        right.set_yscale("log")
        left.set_xlabel("wavelength (nm)")
        left.set_ylabel("refractive index n (solid)")
        right.set_ylabel("extinction coefficient k (dashed)")
        left.margins(x=0.01)
        above(figure, left.get_lines(), None)
        names = ", ".join(nodes)
        told = f"Dots: rows of coarse tables, between which k is interpolated: {names}."
        return finished(figure, [left], told if nodes else "")


def _materials(dataset: xr.Dataset) -> list[tuple[str, str, str]]:
    """Return name, label and colour of the materials to show; those of layers begin with these."""
    found: dict[str, list[str]] = {}
    for name in map(str, dataset.material.values):
        found.setdefault(name.rpartition(".")[2], []).append(name)
    shown = []
    for material, colour in MATERIAL_COLOURS.items():
        names = found.get(material, [])
        parts = [dataset.sel(material=name, drop=True) for name in names]
        same = all(part.equals(parts[0]) for part in parts)
        for name in names[:1] if same else names:
            label = material if same else name.removeprefix("layers.").replace(".", ": ")
            shown.append((name, label if same else f"layer {label}", colour))
    return shown


def _rows(axes: Axes, part: xr.Dataset, nodes: dict[str, np.ndarray], colour: str) -> None:
    """Draw a dot where a coarse table has a row."""
    for name, rows in nodes.items():
        if name.startswith(str(part.material.values)):
            k = np.exp(np.interp(rows, part.wavelength, np.log(part.k)))
            axes.plot(rows, k, ".", color=colour, ms=4)
