"""Figures of spectra and albedos of snowpacks over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from splits.media.snow_packs import count_missing_results
from splits.plotting.lines import is_covering_line, place_legend_above
from splits.plotting.spectra import make_axis_label
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    annotate_figure,
    describe_conditions,
    draw_curve,
    format_parameter,
    format_value,
    make_subplots,
    pick_colours,
    start_at_zero,
    use_style,
)

MAX_WAVELENGTHS = 4
"""Largest number of wavelengths, of which the first and the last are shown."""
MAX_TEXT_TICKS = 24
"""Largest number of labels along the axis; of more, evenly spaced ones are shown."""
_DAYS = "days since 1970-01-01"


@use_style()
def draw_season(dataset: xr.Dataset, quantity: Sequence[str] = ("reflectance",)) -> Figure:
    """Draw band albedos, or spectra at some wavelengths, over time or another label of snowpacks.

    Lines join snowpacks that have an order: times, in any calendar, and numbers.  Snowpacks with
    other labels are points.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.albedo` or `splits.spectrophotometer` for `splits.SnowPacks`.
    quantity : sequence of str
        Quantities of spectra, a panel each.

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = ["band_albedo"] if "band_albedo" in dataset else list(quantity)
    (label,) = dataset.quality_flag.dims
    figure, panels = make_subplots(
        len(names), 1, width=TWO_COLUMNS_INCHES, height=2.4 * len(names), squeeze=False,
        sharex=True,
    )  # fmt: skip
    x, has_order = _set_label_axis(panels[-1, 0], dataset.get_index(label))
    for axes, name in zip(panels[:, 0], names, strict=True):
        line_dim = str(dataset[name].dims[-1])
        n_lines = dataset.sizes[line_dim]
        rows = np.linspace(0, n_lines - 1, min(n_lines, MAX_WAVELENGTHS)).round().astype(int)
        rows = np.arange(n_lines) if line_dim == "band" else np.unique(rows)
        for row, colour in zip(rows, pick_colours(len(rows), line_dim), strict=True):
            part = dataset.isel({line_dim: row})
            y, error = part[name].values, part[f"{name}_stderr"].values
            text = format_value(part[line_dim].values.item(), line_dim)
            if has_order:
                draw_curve(axes, x, y, error, alpha=0.25, color=colour, label=text)
            else:
                axes.errorbar(x, y, BAND_SIGMA * error, fmt="o", ms=2.5, color=colour, label=text)
        axes.set_ylabel("albedo" if name == "band_albedo" else make_axis_label(dataset[name]))
        # Snowpacks without a result are on the axis, too.
        axes.update_datalim([(one, 0.0) for one in np.atleast_1d(axes.convert_xunits(x))])
        axes.autoscale_view()
        start_at_zero(axes, name)
        axes.margins(x=0.01)
        title = "wavelength (nm)" if line_dim == "wavelength" else None
    panels[-1, 0].set_xlabel(format_parameter(str(label)))
    legend = panels[0, 0].legend(title=title, frameon=False)
    if is_covering_line(legend, panels[0, 0]):
        legend.remove()
        place_legend_above(figure, panels[0, 0].get_legend_handles_labels()[0], title)
    band = "bands" if has_order else "bars"
    counts = count_missing_results(dataset)
    gaps = f"Gaps: snowpacks without a result ({counts})." if counts else ""
    return annotate_figure(figure, panels.flat, describe_conditions(dataset, band=band), gaps)


def _set_label_axis(axes: Axes, index: pd.Index) -> tuple[np.ndarray, bool]:
    """Set the ticks of the labels of snowpacks; return positions, and whether they have an order.

    Dates of calendars that NumPy lacks, such as those without leap days, are at their days.
    """
    is_simple = not isinstance(index, pd.MultiIndex)
    if is_simple and index.dtype.kind in "fiu":
        return index.to_numpy(), True
    if is_simple and index.dtype.kind == "M":
        locator = AutoDateLocator()
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        return index.to_numpy(), True
    if isinstance(index, xr.CFTimeIndex):
        import cftime  # xarray has this index only where cftime is installed

        calendar = index.calendar
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        axes.xaxis.set_major_formatter(
            lambda day, _: cftime.num2date(day, _DAYS, calendar).strftime("%Y-%m-%d")
        )
        return np.asarray(cftime.date2num(index.to_numpy(), _DAYS, calendar), dtype=float), True
    shown = np.unique(
        np.linspace(0, index.size - 1, min(index.size, MAX_TEXT_TICKS)).round().astype(int)
    )
    texts = [
        " · ".join(map(format_value, item if isinstance(item, tuple) else (item,)))
        for item in index[shown]
    ]
    axes.set_xticks(shown, texts, rotation=90, fontsize=SMALL_FONT_PT)
    return np.arange(index.size), False
