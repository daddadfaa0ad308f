"""Lines of figures: colours, dashes, legends, ticks at nodes of tables with kinks, and shifts."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import xarray as xr

from splits.materials import TabulatedIndex
from splits.materials.library import MATERIALS, list_datasets, make_refractive_index
from splits.plotting.grammar import (
    BAND_SIGMA,
    NOMINAL_PARAMETERS,
    TWO_COLUMNS_INCHES,
    Axes,
    Colour,
    Dash,
    Figure,
    annotate_figure,
    draw_curve,
    format_parameter,
    format_point,
    format_value,
    hide_empty_panels,
    make_subplots,
    pick_colours,
    start_at_zero,
)
from splits.plotting.settings import DEFAULT_LABEL, MAX_LINES, MAX_PANELS, check_count

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.legend import Legend

DASHES: tuple[Dash, ...] = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (8, 3)))
MAX_INSET_ENTRIES = 6
"""Largest number of lines with individual entries and a legend inside the axes."""
MAX_COLOUR_ENTRIES = 10
"""Largest number of values of an ordered parameter without a colour bar."""


class PlotLine(NamedTuple):
    """One line of a figure: its point of the grid and its style."""

    labels: dict[str, Any]
    label: str
    colour: Colour
    dash: Dash
    is_default: bool
    zorder: float

    def to_plot_style(self) -> dict[str, Any]:
        """Return the style as keywords of `matplotlib.axes.Axes.plot`."""
        return {
            "color": self.colour, "ls": self.dash, "lw": 1.4 if self.is_default else 1.0,
            "zorder": self.zorder,
        }  # fmt: skip


class PlotLines:
    """The lines of a figure over some dimensions of a dataset.

    The first varying dimension has colours and all others dashes.  If dashes do not suffice, the
    longest dimension has colours.

    Parameters
    ----------
    dataset : xarray.Dataset
    dims : sequence of str
    use_dashes : bool
        Whether few lines over a single dimension, which may overlap, also have dashes.
    """

    def __init__(self, dataset: xr.Dataset, dims: Sequence[str], use_dashes: bool = False) -> None:
        self.dims = list(dims)
        self._values = {d: dataset[d].values for d in dims}
        sizes = {d: dataset.sizes[d] for d in dims}
        n_lines = math.prod(sizes.values())
        check_count("lines", n_lines, MAX_LINES)
        varying = [d for d in dims if sizes[d] > 1]
        # A dimension with a default has colours.
        with_default = [d for d in varying if DEFAULT_LABEL in map(str, self._values[d])]
        self.colour_dim = next(iter([*with_default, *varying]), "")
        if self.colour_dim and n_lines // sizes[self.colour_dim] > len(DASHES):
            self.colour_dim = max(sizes, key=lambda d: sizes[d])
        n_dashed = n_lines // sizes.get(self.colour_dim, 1)
        is_nominal = self.colour_dim in NOMINAL_PARAMETERS and not np.issubdtype(
            self._values[self.colour_dim].dtype, np.number
        )
        # Colours of nominal values repeat, which dashes of other dimensions cannot resolve.
        repeats = is_nominal and n_dashed > 1 and sizes[self.colour_dim] > MAX_COLOUR_ENTRIES
        is_crowded = n_dashed > len(DASHES) or repeats
        if is_crowded:
            # Every line has its own colour and entry.
            self.colour_dim, is_nominal = "", False
        self.dash_dims = [
            d for d in dims if d != self.colour_dim and sizes[d] > 1 and not is_crowded
        ]
        values = self._values.get(self.colour_dim, np.zeros(n_lines if is_crowded else 1))
        coloured = [v for v in values if str(v) != DEFAULT_LABEL]
        colours = iter(pick_colours(len(coloured), self.colour_dim if is_nominal else None))
        self.colours: list[Colour] = [
            "black" if str(v) == DEFAULT_LABEL else next(colours) for v in values
        ]
        self.has_colour_bar = len(values) > MAX_COLOUR_ENTRIES and not is_nominal and not is_crowded
        dash_points = list(np.ndindex(*(sizes[d] for d in self.dash_dims)))
        self.lines: list[PlotLine] = []
        for index in np.ndindex(*sizes.values()):
            indices = dict(zip(dims, index, strict=True))
            row = len(self.lines) if is_crowded else indices.get(self.colour_dim, 0)
            dash_index = (
                row if is_crowded else dash_points.index(tuple(indices[d] for d in self.dash_dims))
            )
            if use_dashes and not self.dash_dims and len(values) <= 4:
                dash_index = row
            elif is_nominal and not self.dash_dims:
                dash_index += row // MAX_COLOUR_ENTRIES
            labels = {d: self._values[d][position] for d, position in indices.items()}
            is_default = str(labels.get(self.colour_dim)) == DEFAULT_LABEL
            # The first line is the reference and is drawn on top.
            zorder = 4.0 if is_default else 2.0 + 1.0 / (1 + len(self.lines))
            dash = DASHES[dash_index % len(DASHES)]
            self.lines.append(
                PlotLine(labels, format_point(labels), self.colours[row], dash, is_default, zorder)
            )

    def add_legend(
        self,
        figure: Figure,
        axes: Sequence[Axes],
        title: str | None = None,
        max_inset_entries: int = MAX_INSET_ENTRIES,
        extra_handles: Sequence[Artist] = (),
    ) -> None:
        """Add a legend: on the first axes where it covers no line, above, or beside all axes.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
            With constrained layout.
        axes : sequence of matplotlib.axes.Axes
            Axes of the lines.
        title : str, optional
            By default the names of the dimensions.
        max_inset_entries : int
            Largest number of entries of a legend inside the axes.
        extra_handles : sequence of artists
            Additional entries.
        """
        if not self.dims and not extra_handles:
            return
        if self.has_colour_bar:
            self._add_colour_bar(figure, axes, title)
        handles = [*self._make_handles(title), *extra_handles]
        is_split = len(self.lines) > MAX_INSET_ENTRIES and bool(self.dash_dims)
        heading = (
            None if is_split or self.has_colour_bar else title or format_names(self.dims) or None
        )
        if not handles:
            return
        if len(handles) <= max_inset_entries and not self.has_colour_bar:
            for panel in axes:
                legend = panel.legend(handles=handles, title=heading, frameon=False)
                if not is_covering_line(legend, panel):
                    return
                legend.remove()
        if len(handles) <= MAX_INSET_ENTRIES and not self.has_colour_bar:
            place_legend_above(figure, handles, heading)
        else:
            place_legend_beside(figure, handles, heading)

    def _make_handles(self, title: str | None) -> list[Artist]:
        """Return an entry per line, or for many lines an entry per value of each parameter."""
        if len(self.lines) <= MAX_INSET_ENTRIES or not self.dash_dims:
            items = () if self.has_colour_bar else self.lines
            return [make_handle(item.label or "model", **item.to_plot_style()) for item in items]
        handles = []
        if not self.has_colour_bar:
            handles.append(make_handle(title or format_parameter(self.colour_dim), ls="none"))
            for value, colour in zip(self._values[self.colour_dim], self.colours, strict=True):
                text = format_value(value, self.colour_dim)
                handles.append(make_handle(text, color=colour, lw=1.4))
        handles.append(make_handle(format_names(self.dash_dims), ls="none"))
        points = itertools.product(*(self._values[d] for d in self.dash_dims))
        for values, dash in zip(points, itertools.cycle(DASHES)):
            text = format_point(dict(zip(self.dash_dims, values, strict=True)))
            handles.append(make_handle(text, color="0.15", lw=1.0, ls=dash))
        return handles

    def _add_colour_bar(self, figure: Figure, axes: Sequence[Axes], title: str | None) -> None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import BoundaryNorm, ListedColormap

        n_colours = len(self.colours)
        norm = BoundaryNorm(np.arange(n_colours + 1) - 0.5, n_colours)
        ticks = np.arange(0, n_colours, -(-n_colours // MAX_COLOUR_ENTRIES))
        specs = [spec for panel in axes if (spec := panel.get_subplotspec()) is not None]
        if len({id(spec.get_gridspec()) for spec in specs}) > 1:
            # Matplotlib cannot lay out a bar that spans several grids of panels.
            axes, specs = axes[:1], specs[:1]
        rows = len({spec.rowspan.start for spec in specs})
        colour_bar = figure.colorbar(
            ScalarMappable(norm, ListedColormap(self.colours)), ax=list(axes), ticks=ticks,
            aspect=20 * rows, label=title or format_parameter(self.colour_dim), pad=0.02,
        )  # fmt: skip
        colour_bar.ax.set_yticklabels(
            [format_value(self._values[self.colour_dim][i], self.colour_dim) for i in ticks]
        )
        colour_bar.ax.minorticks_off()


def format_names(parameters: Sequence[str]) -> str:
    """Return the labels of parameters."""
    return " · ".join(map(format_parameter, parameters))


def make_handle(label: str, **style: Any) -> Artist:
    """Return the entry of a line in a legend; with ``ls="none"``, a heading."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def is_covering_line(legend: Legend, axes: Axes) -> bool:
    """Return whether a legend covers a line of its axes."""
    figure = axes.get_figure()
    assert figure is not None
    figure.draw_without_rendering()  # type: ignore[union-attr]
    box = legend.get_window_extent()
    paths = (line.get_transform().transform_path(line.get_path()) for line in axes.lines)
    return any(path.intersects_bbox(box, filled=False) for path in paths)


def _place_legend(
    figure: Figure, handles: Sequence[Artist], title: str | None,
    loc: Literal["outside upper center", "outside right upper"], columns: int, max_width: float,
) -> float:  # fmt: skip
    """Place a legend in as many columns as a width (pixels) allows; return its height (inches)."""
    for n_columns in range(columns, 0, -1):
        legend = figure.legend(
            handles=list(handles), title=title, frameon=False, loc=loc, ncols=n_columns
        )
        box = legend.get_window_extent()
        if n_columns == 1 or box.width < max_width:
            break
        legend.remove()
    return float(box.height / figure.dpi)


def place_legend_above(figure: Figure, handles: Sequence[Artist], title: str | None) -> None:
    """Place a legend of few entries above all axes; the figure height increases accordingly.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout.
    handles : sequence of artists
    title : str or None
    """
    if handles:
        height = _place_legend(
            figure, handles, title, "outside upper center", len(handles), figure.bbox.width
        )
        figure.set_figheight(figure.get_figheight() + height)


def place_legend_beside(figure: Figure, handles: Sequence[Artist], title: str | None) -> None:
    """Place a legend to the right of all axes, and set the figure to the width of two columns.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout.  Its height increases if the legend would be too wide.
    handles : sequence of artists
    title : str or None
    """
    figure.set_figwidth(TWO_COLUMNS_INCHES)
    # An entry is 0.145 inches high, and the legend at most 0.4 of the width of the figure.
    rows = max(1, int(figure.get_figheight() / 0.145) - 2)
    columns, max_width = -(-len(handles) // rows), 0.4 * figure.bbox.width
    height = _place_legend(figure, handles, title, "outside right upper", columns, max_width)
    figure.set_figheight(max(figure.get_figheight(), height + 0.1))


_FRACTION_PARAMETERS = {"water": ("saturation",), "hematite": ("iron_oxide", "hematite_ratio"),
           "magnetite": ("magnetite",)}  # fmt: skip
"""Parameters that must all be above 0 for a material to be present."""


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
        medium, _, material = str(key).partition("_refractive_index_")
        # Without the factor of k.
        base_name = str(name).partition(", k x")[0]
        needed = (f"{medium}_{one}" for one in _FRACTION_PARAMETERS.get(material, ()))
        is_in_use = all(float(dataset.attrs.get(one, 1.0)) > 0.0 for one in needed)
        # Layers of stacks, whose keys have dots, are left out.
        is_known = medium.isidentifier() and material in MATERIALS
        if not is_known or not is_in_use or base_name not in list_datasets(material):
            continue
        table = make_refractive_index(material, base_name)
        if not isinstance(table, TabulatedIndex):
            continue
        # Ends of steps of a coarse table, which are wider than two of the wavelengths.
        low, high = table.wavelength_nm[:-1], table.wavelength_nm[1:]
        is_wide = high - low > 2.0 * step
        gap = float((high - low)[(high > x[0]) & (low < x[-1])].max(initial=0.0))
        rows = np.union1d(low[is_wide], high[is_wide])
        rows = rows[(rows >= x[0]) & (rows <= x[-1])]
        if rows.size:
            # The printed name of a table, such as Hale & Querry 1973.
            printed = re.sub(
                r"^([a-z]+)_([a-z]+)_(\d{4})", r"\1 & \2 \3", str(name).partition(",")[0]
            )
            nodes[f"{material} ({printed.replace('_', ' ').title()})"] = (gap, rows)
    return {label: rows for label, (_, rows) in sorted(nodes.items(), key=lambda n: -n[1][0])}


def draw_node_ticks(axes: Axes, nodes: dict[str, np.ndarray]) -> None:
    """Draw a tick upwards from the wavelength axis at every row of the tables."""
    # Ticks of successive tables have these lengths (points), half of which is above the axis.
    for (name, rows), length in zip(nodes.items(), (8.0, 5.0, 3.0, 2.0), strict=False):
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
    colours = {
        "water": ("#c8553d", "red"), "ice": ("#1f6fb4", "blue"), "hematite": ("#7b3294", "purple"),
    }  # fmt: skip
    return colours.get(name.partition(" ")[0], ("#666666", "grey"))


# --------------------------------------------------------------------------------------------------
# Panels of the shifts of curves from the one labelled ``default``.

SHIFT_COLOUR = "#1f6fb4"
INDEPENDENCE_NOTE = (
    "errors of shifts assume independent runs, though they share some random numbers"
)
"""Note on errors of shifts: points of a grid have the same seed, but not the same rays."""


def find_default_dim(dataset: xr.Dataset, dims: Sequence[str]) -> str | None:
    """Return the only varying dimension if it has a value labelled ``default``, else None."""
    varying = [d for d in dims if dataset.sizes[d] > 1]
    if len(varying) != 1 or dataset.sizes[varying[0]] > MAX_PANELS:
        return None
    return varying[0] if DEFAULT_LABEL in map(str, dataset[varying[0]].values) else None


def compute_shift(dataset: xr.Dataset, name: str, dim: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Return the shift of a quantity from its default along a dimension, and its standard error.

    The runs are assumed independent, see `INDEPENDENCE_NOTE`.
    """
    default = dataset.sel({dim: DEFAULT_LABEL})
    error = f"{name}_stderr"
    variance = dataset[error] ** 2 + default[error] ** 2
    return dataset[name] - default[name], variance**0.5


def draw_shifts(
    dataset: xr.Dataset,
    quantity: Sequence[str],
    dim: str,
    axis_dim: str,
    labels: tuple[str, Sequence[str]],
    note: str = "",
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw the curve of the default, and the shift of every other one from it, a panel each.

    Parameters
    ----------
    dataset : xarray.Dataset
        Over `dim` and `axis_dim`; other dimensions have one value.
    quantity : sequence of str
        Quantities, each with a block of panels.
    dim : str
        See `find_default_dim`.
    axis_dim : str
        Dimension of the horizontal axis.
    labels : (str, sequence of str)
        Labels of the horizontal axis and of the quantities.
    note : str
        Note for the foot of the figure.
    ylim : (low, high), optional
        Limits of the panels of defaults; from 0 by default.
    """
    dataset = dataset.squeeze([d for d, n in dataset.sizes.items() if n == 1 and d in
                               dataset[quantity[0]].dims and d not in (dim, axis_dim)])  # fmt: skip
    others = [v for v in dataset[dim].values if str(v) != DEFAULT_LABEL]
    columns = min(4, 1 + len(others))
    rows_per_quantity = -(-(1 + len(others)) // columns)
    nodes = find_coarse_nodes(dataset) if axis_dim == "wavelength" else {}
    figure, panels = make_subplots(
        rows_per_quantity * len(quantity),
        columns,
        width=TWO_COLUMNS_INCHES,
        sharex=True,
        squeeze=False,
        height=0.4 + 1.2 * rows_per_quantity * len(quantity),
    )
    for number, (name, label) in enumerate(zip(quantity, labels[1], strict=True)):
        part = panels[number * rows_per_quantity : (number + 1) * rows_per_quantity].ravel()
        x, default = dataset[axis_dim].values, dataset.sel({dim: DEFAULT_LABEL})
        errors = default[f"{name}_stderr"].values
        draw_curve(part[0], x, default[name].values, errors, color="black")
        part[0].set_title("default")
        shift, error = compute_shift(dataset, name, dim)
        limit = 1.05 * float((np.abs(shift) + BAND_SIGMA * error).max()) or 1.0
        for axes, other in zip(part[1:], others, strict=False):
            selection = {dim: other}
            values, errors = shift.sel(selection).values, error.sel(selection).values
            draw_curve(axes, x, values, errors, color=SHIFT_COLOUR)
            axes.axhline(0.0, color="black", lw=0.6, zorder=1.5)
            axes.set_ylim(-limit, limit)
            value = format_value(other, dim)
            text = value if dim in NOMINAL_PARAMETERS else f"{format_parameter(dim)}: {value}"
            # As many characters as fit; a line break may separate a dollar sign from its escape.
            axes.set_title(fill(text, 22).replace("\\\n$", "\n\\$"))
        for axes in part[: 1 + len(others)]:
            axes.margins(x=0.01)
            draw_node_ticks(axes, nodes)
        part[0].set_ylabel(label)
        start_at_zero(part[0], name, ylim)
        for row in part[columns::columns] if rows_per_quantity > 1 else part[1:2]:
            row.set_ylabel("shift")
    hide_empty_panels(panels, labels[0])
    shift_note = f"Shifts: value minus that of the default in panel (a); {INDEPENDENCE_NOTE}."
    return annotate_figure(figure, panels.flat, note, shift_note, make_nodes_note(nodes))
