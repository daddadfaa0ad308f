"""Figure of fitted and measured spectra of sand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.io.netcdf import select_points
from splits.plotting.lines import PlotLines
from splits.plotting.style import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    annotate_figure,
    describe_conditions,
    format_value,
    make_subplots,
    use_style,
)

MAX_SAMPLE_COLUMNS = 3
"""Largest number of columns of samples."""


def draw_fits(
    dataset: xr.Dataset, select: Mapping[str, float | str] | None = None, legend: str | None = None
) -> Figure:
    """Draw measured and fitted reflectance of every sample, and their difference below.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.experiments.run_fit.run_fit`.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Title of the legend; by default the parameters of the grid.
    """
    dataset = select_points(dataset, select or {})
    dims = [str(d) for d in dataset.rmse.dims if d != "sample"]
    lines = PlotLines(dataset, dims)
    samples = dataset.sample.values
    columns = min(MAX_SAMPLE_COLUMNS, len(samples))
    blocks = -(-len(samples) // columns)
    with use_style():
        figure, panels = make_subplots(
            2 * blocks, columns, width=ONE_COLUMN_INCHES if columns == 1 else TWO_COLUMNS_INCHES,
            height=3.6 * blocks, sharex=True, squeeze=False,
            gridspec_kw={"height_ratios": [2.2, 1] * blocks},
        )  # fmt: skip
        title = legend or lines.make_title() or "model"
        tops, bottoms = panels[0::2].ravel(), panels[1::2].ravel()
        for top, bottom, sample in zip(tops, bottoms, samples, strict=False):
            _draw_sample(top, bottom, dataset.sel(sample=sample), lines, title)
            top.set_title(format_value(sample, "sample"))
        for axes in (*tops[len(samples) :], *bottoms[len(samples) :]):
            axes.set_visible(False)
        _share_axes(dataset, tops, bottoms)
        for row in range(blocks):
            panels[2 * row, 0].set_ylabel("reflectance")
            panels[2 * row + 1, 0].set_ylabel("model − measured")
        return annotate_figure(figure, panels.flat, describe_conditions(dataset, select))


def _share_axes(dataset: xr.Dataset, tops: np.ndarray, bottoms: np.ndarray) -> None:
    """Set common axis limits for all samples."""
    error = BAND_SIGMA * dataset.reflectance_stderr
    difference = dataset.reflectance - dataset.measured
    highest = max(float(dataset.measured.max()), float((dataset.reflectance + error).max()))
    # The line of no difference is always visible.
    low = min(0.0, float((difference - error).min()))
    high = max(0.0, float((difference + error).max()))
    margin = 0.05 * (high - low)
    for top, bottom in zip(tops, bottoms, strict=True):
        top.set_ylim(0.0, 1.12 * highest)
        bottom.set_ylim(low - margin, high + margin)
        bottom.tick_params(labelbottom=True)
        for axes in (top, bottom):
            axes.spines[["top", "right"]].set_visible(False)
            axes.label_outer(remove_inner_ticks=False)


def _draw_sample(top: Axes, bottom: Axes, part: xr.Dataset, lines: PlotLines, title: str) -> None:
    """Draw the spectra and differences of one sample."""
    x = part.wavelength.values
    measured = part.measured.isel(dict.fromkeys(lines.dims, 0)).values
    top.plot(x, measured, "ks", ms=2, label="measured", zorder=1.9)
    for line in lines.lines:
        fit = part.sel(line.labels)
        y, error = fit.reflectance.values, BAND_SIGMA * fit.reflectance_stderr.values
        top.plot(
            x, y, label=f"{line.label or 'model'}: {float(fit.rmse):.4f}", **line.to_plot_style()
        )
        difference = y - fit.measured.values
        bottom.plot(x, difference, **line.to_plot_style())
        for axes, middle in ((top, y), (bottom, difference)):
            low, high = middle - error, middle + error
            axes.fill_between(x, low, high, color=line.colour, alpha=0.25, lw=0)
    bottom.axhline(0.0, color="black", lw=0.6)
    top.legend(
        title=f"{title}: misfit",
        frameon=False,
        fontsize=SMALL_FONT_PT,
        title_fontsize=SMALL_FONT_PT,
    )
    bottom.set_xlabel("wavelength (nm)")
