"""Figures over time and space: returns, range bias, spread of a beam, rough surfaces and lenses."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.validation import invalid
from splits.instruments.delay_record import SPEED_OF_LIGHT
from splits.io.netcdf import select_points
from splits.plotting.grammar import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Figure,
    annotate_figure,
    compute_axis_top,
    declare_figure,
    describe_conditions,
    draw_band,
    draw_curve,
    format_parameter,
    make_subplots,
    pick_colours,
)
from splits.plotting.lines import MAX_INSET_ENTRIES, PlotLines, place_legend_beside
from splits.plotting.settings import (
    MAX_LINES,
    MAX_ROWS,
    Legend,
    Selection,
    check_count,
    select_one_point,
)

HALF_SPEED_MM_PER_NS = 0.5e-6 * SPEED_OF_LIGHT
"""Apparent depth per delay."""

MAX_RELATIVE_ERROR = 0.25
"""Relative error above which a value is not drawn."""


@declare_figure
def draw_returns(dataset: xr.Dataset, select: Selection = None, legend: Legend = None) -> Figure:
    """Draw the rate at which light returns, and the light that has returned, over the delay.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.time_of_flight`, or of an experiment with it.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Title of the legend; by default the parameters of the grid.
    """
    dataset = _select_reflected(dataset, select)
    dims = [str(d) for d in dataset.return_rate.dims if d != "delay_s"]
    lines = PlotLines(dataset, [d for d in dims if d != "wavelength" or dataset.sizes[d] > 1])
    begin, end = (dataset.delay_bounds.values[:, column] for column in (0, 1))
    figure, (left, right) = make_subplots(1, 2, width=TWO_COLUMNS_INCHES, height=2.8)
    for grid_line in lines.lines:
        line = dataset.sel(grid_line.labels)
        line = line.isel(wavelength=0) if "wavelength" in line.dims else line
        rate, error = line.return_rate.values, line.return_rate_stderr.values
        is_drawn = (begin > 0.0) & (rate > 0.0) & (error < MAX_RELATIVE_ERROR * rate)
        delay = 1e9 * np.sqrt(np.maximum(begin, 0.0) * end)[is_drawn]
        returned = np.cumsum(rate * (end - begin))
        rate, error = 1e-9 * rate[is_drawn], 1e-9 * error[is_drawn]
        style = grid_line.to_plot_style()
        draw_curve(left, delay, rate, error, 0.1 * rate, **style)
        right.plot(1e9 * end, returned, **style)
    left.set(yscale="log", ylabel="returned light per time (ns⁻¹)")
    right.set(ylabel="light returned since the first delay", ylim=(0.0, compute_axis_top(1.0)))
    for axes in (left, right):
        axes.set(xscale="log", xlabel="delay (ns)")
        axes.spines["top"].set_visible(True)
        # Apparent depth.
        depth = axes.secondary_xaxis(
            "top",
            functions=(lambda x: HALF_SPEED_MM_PER_NS * x, lambda x: x / HALF_SPEED_MM_PER_NS),
        )
        depth.set_xlabel("apparent depth (mm)")
    lines.add_legend(figure, [left, right], legend)
    return annotate_figure(figure, [left, right], describe_conditions(dataset, select))


@declare_figure
def draw_range_bias(dataset: xr.Dataset, select: Selection = None, legend: Legend = None) -> Figure:
    """Draw the range bias, half of the mean delay times the speed of light, over a parameter.

    The horizontal axis is that of the parameter with the largest number of numeric values.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of an experiment with `splits.time_of_flight` over a grid.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Title of the legend; by default the parameters of the other lines.
    """
    dataset = _select_reflected(dataset, select)
    dims = [str(d) for d in dataset.mean_delay.dims if d != "wavelength"]
    axis = find_bias_axis(dataset)
    if not axis:
        allowed = "a parameter with several numbers for the kind 'range_bias'"
        raise invalid("grid", dims, allowed)
    check_count("points", dataset.sizes[axis], MAX_ROWS, select)
    lines = PlotLines(dataset, [*(d for d in dims if d != axis), "wavelength"])
    x = dataset[axis].values.astype(float)
    figure, axes = make_subplots(width=ONE_COLUMN_INCHES, height=2.9)
    for grid_line in lines.lines:
        line = dataset.sel(grid_line.labels)
        # Half of the mean delay times the speed of light.
        bias = 1e9 * HALF_SPEED_MM_PER_NS * line.mean_delay.values
        error = 1e9 * HALF_SPEED_MM_PER_NS * BAND_SIGMA * line.mean_delay_stderr.values
        axes.errorbar(x, bias, error, **grid_line.to_plot_style(), marker="o", ms=2.5)
    axes.set(
        yscale="log", xlabel=format_parameter(axis), ylabel="range bias (mm)",
        xscale="log" if x.min() > 0.0 else "linear",
    )  # fmt: skip
    axes.yaxis.set_major_formatter("{x:g}")
    # Few values are all labelled.
    if x.size <= 8:
        axes.set_xticks(x, [f"{value:g}" for value in x])
        axes.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
    lines.add_legend(figure, [axes], legend)
    return annotate_figure(figure, [axes], describe_conditions(dataset, select, "bars"))


def find_bias_axis(dataset: xr.Dataset) -> str:
    """Return the parameter with the largest number of numeric values, "" if none has several."""
    dims = [str(d) for d in dataset.mean_delay.dims if d != "wavelength"]
    numeric = [d for d in dims if dataset[d].dtype.kind in "iuf" and dataset.sizes[d] > 1]
    return max(numeric, key=lambda name: dataset.sizes[name], default="")


def _select_reflected(dataset: xr.Dataset, select: Selection) -> xr.Dataset:
    """Return the reflected light at values of the grid; a table of returns has no other."""
    dataset = select_points(dataset, select or {})
    return dataset.sel(side="reflected") if "side" in dataset.dims else dataset


@declare_figure
def draw_beam_spread(dataset: xr.Dataset, select: Selection = None) -> Figure:
    """Draw the exiting light against the distance from the entry, and its map.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.beam_spread`, without a grid or with one to select from.
    select : mapping, optional
        Grid labels to select.
    """
    from matplotlib.colors import LogNorm

    dataset = select_one_point(dataset, select, "spread")
    check_count("maps", dataset.sizes["wavelength"], MAX_LINES // 2, select)
    figure, (left, right) = make_subplots(
        1, 2, width=TWO_COLUMNS_INCHES, height=2.8, width_ratios=(1.15, 1.0)
    )
    colours = pick_colours(dataset.sizes["wavelength"])
    for colour, wavelength in zip(colours, dataset.wavelength.values, strict=True):
        for side, dash in (("reflected", "-"), ("transmitted", "--")):
            part = dataset.sel(wavelength=wavelength, side=side)
            value, error = part.profile.values, part.profile_stderr.values
            is_significant = (value > 0.0) & (error < MAX_RELATIVE_ERROR * value)
            if is_significant.sum() < 2:
                continue
            x, value, error = (
                one[is_significant] for one in (1e3 * part.radius.values, value, error)
            )
            label = f"{wavelength:g} nm, {side}"
            draw_curve(left, x, value, error, 0.1 * value, color=colour, ls=dash, label=label)
    label = "light leaving per area (m⁻²)"
    left.set(xscale="log", yscale="log", xlabel="distance from the entry (mm)", ylabel=label)
    handles, _ = left.get_legend_handles_labels()
    if len(handles) > MAX_INSET_ENTRIES:
        place_legend_beside(figure, handles, None)
    elif handles:
        left.legend(frameon=False)
    first = dataset.isel(wavelength=0).sel(side="reflected")
    values = first.profile_map.transpose("y", "x").values
    positive = values[values > 0.0]
    norm = LogNorm(np.quantile(positive, 0.02), positive.max()) if positive.size else None
    image = right.pcolormesh(
        1e3 * first.x, 1e3 * first.y, np.where(values > 0.0, values, np.nan), norm=norm,
        cmap="viridis", rasterized=True,
    )  # fmt: skip
    right.set(
        xlabel="along the beam's travel (mm)", ylabel="across (mm)", aspect="equal",
        title=f"{float(first.wavelength):g} nm, reflected",
    )  # fmt: skip
    right.spines[:].set_visible(True)
    figure.colorbar(image, ax=right, label=label, shrink=0.85)
    return annotate_figure(figure, [left, right], describe_conditions(dataset, select))


# --------------------------------------------------------------------------------------------------
# Rough surfaces.

_REFERENCE_LINE_STYLE: dict[str, Any] = {"color": "0.6", "lw": 0.6, "ls": "--"}
"""Style of reference lines."""


@declare_figure
def draw_surface(dataset: xr.Dataset, select: Selection = None) -> Figure:
    """Draw the heights of a surface in relief, and the distribution of rms slopes.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.surface_map`, without a grid or with one to select from.
    select : mapping, optional
        Grid labels to select.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LightSource, Normalize

    dataset = select_one_point(dataset, select, "surface")
    height = dataset.height.transpose("y", "x").values
    x, y = dataset.x.values, dataset.y.values
    figure, (left, right) = make_subplots(
        1, 2, width=TWO_COLUMNS_INCHES, height=2.8, width_ratios=(1.35, 1.0)
    )
    max_height = float(np.abs(height).max())
    light = LightSource(azdeg=315, altdeg=35)
    shaded = light.shade(
        height, colormaps["Blues_r"], blend_mode="soft", vmin=-max_height, vmax=max_height,
        dx=x[1] - x[0], dy=y[1] - y[0],
    )  # fmt: skip
    extent = (x[0], x[-1], y[0], y[-1])
    left.imshow(shaded, origin="lower", extent=extent, interpolation="bilinear")
    left.set(xlabel="x (m)", ylabel="y (m)")
    left.spines[:].set_visible(True)
    scale = ScalarMappable(Normalize(-max_height, max_height), "Blues_r")
    figure.colorbar(scale, ax=left, label="height (m)", location="top", shrink=0.7, aspect=30)
    slopes = np.sort(dataset.rms_slope.values)
    fraction = (np.arange(slopes.size) + 0.5) / slopes.size
    right.step(slopes, fraction, where="mid", color="black")
    median = float(np.median(slopes))
    right.axvline(median, **_REFERENCE_LINE_STYLE)
    right.annotate(
        f"median {median:.3g}", (median, 0.02), (4, 0), textcoords="offset points",
        fontsize=SMALL_FONT_PT,
    )  # fmt: skip
    right.set(
        xlabel="rms slope of a realization", ylim=(0.0, compute_axis_top(1.0)),
        xscale="log" if slopes[-1] > 10.0 * slopes[0] else "linear",
        ylabel="cumulative fraction of realizations",
    )  # fmt: skip
    return annotate_figure(figure, [left, right], describe_conditions(dataset, select, ""))


@declare_figure
def draw_lens(dataset: xr.Dataset, select: Selection = None) -> Figure:
    """Draw rays below a surface, the ring on screens, and the concentration of light.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.lens`, without a grid or with one to select from.
    select : mapping, optional
        Grid labels to select.
    """
    dataset = select_one_point(dataset, select, "lens")
    depth = dataset.screen_depth.values
    spot = dataset.screen_position.where(dataset.detected > 0)
    size = (spot - spot.mean("ray")).pipe(np.square).sum("axis").mean("ray").values
    best = int(size.argmin())
    double_depth = int(np.argmin(np.abs(depth - 2.0 * depth[best])))
    shown = sorted({0, best, double_depth})
    figure, (rays, screen, concentration) = make_subplots(
        1, 3, width=TWO_COLUMNS_INCHES, height=2.8
    )
    start, n_rays = dataset.surface_position.values, dataset.sizes["ray"]
    # Some of the rays of the ring, from above the surface to the screens.
    for ray in range(0, n_rays, max(1, n_rays // 24)):
        is_detected = dataset.detected.values[:, ray] > 0
        is_detected &= depth <= 1.4 * depth[double_depth]
        x = np.append(start[ray, 0], dataset.screen_position.values[is_detected, ray, 0])
        z = np.append(start[ray, 2], -depth[is_detected])
        rays.plot(x, z, color="0.35", lw=0.4)
        rays.plot([x[0], x[0]], [z[0], 0.3 * depth[double_depth]], color="0.35", lw=0.4)
    colours = pick_colours(len(shown))
    order = np.argsort(start[:, 0])
    rays.plot(start[order, 0], start[order, 2], ".", color="black", ms=1)
    for index, colour in zip(shown, colours, strict=True):
        rays.axhline(-depth[index], color=colour)
        is_detected = dataset.detected.values[index] > 0
        spot = dataset.screen_position.values[index][is_detected]
        screen.plot(*spot.T, ".", color=colour, ms=1.5, label=f"{depth[index]:g} m")
    rays.set(xlabel="x (m)", ylabel="height above the ring's centre (m)")
    is_detected = dataset.detected.values[shown] > 0
    positions = dataset.screen_position.values[shown][is_detected]
    middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    half = 0.58 * np.ptp(positions, axis=0).max()
    (left, bottom), (right, top) = middle - half, middle + half
    screen.set(
        xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="x (m)", ylabel="y (m)"
    )
    figure.legend(
        *screen.get_legend_handles_labels(), title="depth of the screen", frameon=False,
        loc="outside upper center", ncols=3, markerscale=6.0,
    )  # fmt: skip
    value = dataset.concentration.values
    concentration.plot(depth, value, color="black")
    if "concentration_stderr" in dataset:
        error = dataset.concentration_stderr.values
        draw_band(concentration, depth, value, error, 0.0, color="black", alpha=0.25)
    concentration.axhline(1.0, **_REFERENCE_LINE_STYLE)
    concentration.annotate(
        "without waves", (depth[-1], 1.0), (0, 3), textcoords="offset points", ha="right",
        fontsize=SMALL_FONT_PT,
    )  # fmt: skip
    concentration.set(
        xlabel="depth of the screen (m)", ylabel="concentration: 1 / mean square size",
        yscale="log" if value.max() > 10.0 * value.min() else "linear",
    )  # fmt: skip
    band = "band" if "concentration_stderr" in dataset else ""
    return annotate_figure(
        figure, [rays, screen, concentration], describe_conditions(dataset, select, band)
    )
