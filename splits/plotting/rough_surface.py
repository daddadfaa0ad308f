"""Figures of rough surfaces: height maps, and the refraction of a ring of parallel rays."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.plotting.grammar import (
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Figure,
    annotate_figure,
    compute_axis_top,
    declare_figure,
    describe_conditions,
    draw_band,
    make_subplots,
    pick_colours,
)
from splits.plotting.settings import Selection, select_one_point

_REFERENCE_LINE_STYLE: dict[str, Any] = {"color": "0.6", "lw": 0.6, "ls": "--"}
"""Style of reference lines."""


def _make_panels(count: int, map_panel: int, **settings: Any) -> tuple[Figure, np.ndarray]:
    """Return a figure with panels side by side, one of which is a map."""
    figure, panels = make_subplots(1, count, width=TWO_COLUMNS_INCHES, height=2.8, **settings)
    panels[map_panel].set(xlabel="x (m)", ylabel="y (m)")
    return figure, panels


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
    figure, (left, right) = _make_panels(2, map_panel=0, width_ratios=(1.35, 1.0))
    max_height = float(np.abs(height).max())
    light = LightSource(azdeg=315, altdeg=35)
    shaded = light.shade(
        height, colormaps["Blues_r"], blend_mode="soft", vmin=-max_height, vmax=max_height,
        dx=x[1] - x[0], dy=y[1] - y[0],
    )  # fmt: skip
    extent = (x[0], x[-1], y[0], y[-1])
    left.imshow(shaded, origin="lower", extent=extent, interpolation="bilinear")
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
    is_wide = slopes[-1] > 10.0 * slopes[0]
    right.set(xlabel="rms slope of a realization", ylim=(0.0, compute_axis_top(1.0)))
    right.set_xscale("log" if is_wide else "linear")
    right.set_ylabel("cumulative fraction of realizations")
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
    figure, (rays, screen, concentration) = _make_panels(3, map_panel=1)
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
    screen.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
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
        xlabel="depth of the screen (m)", ylabel="concentration: 1 / mean square size"
    )
    concentration.set_yscale("log" if value.max() > 10.0 * value.min() else "linear")
    band = "band" if "concentration_stderr" in dataset else ""
    return annotate_figure(
        figure, [rays, screen, concentration], describe_conditions(dataset, select, band)
    )
