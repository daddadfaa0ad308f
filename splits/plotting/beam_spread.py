"""Figure of the spread of a thin beam: radial profiles and a map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from splits.io.netcdf import select_points
from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.lines import MAX_INSET_ENTRIES, place_legend_beside
from splits.plotting.panels import MAX_LINES, check_count
from splits.plotting.style import (
    BAND_SIGMA,
    TWO_COLUMNS_INCHES,
    make_subplots,
    pick_colours,
    use_style,
)

MAX_RELATIVE_ERROR = 0.25
"""Relative error above which a value is not drawn."""


def draw_beam_spread(
    dataset: xr.Dataset, select: Mapping[str, float | str] | None = None
) -> Figure:
    """Draw the exiting light against the distance from the entry, and its map.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.beam_spread`, without a grid or with one to select from.
    select : mapping, optional
        Grid labels to select.
    """
    dataset = select_points(dataset, select or {})
    check_count("maps", dataset.sizes["wavelength"], MAX_LINES // 2, select)
    with use_style():
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
                x = 1e3 * part.radius.values[is_significant]
                value, error = value[is_significant], BAND_SIGMA * error[is_significant]
                label = f"{wavelength:g} nm, {side}"
                left.plot(x, value, color=colour, ls=dash, label=label)
                left.fill_between(
                    x, np.maximum(value - error, 0.1 * value), value + error,
                    color=colour, alpha=0.3, lw=0,
                )  # fmt: skip
        left.set(xscale="log", yscale="log", xlabel="distance from the entry (mm)")
        left.set_ylabel("light leaving per area (m⁻²)")
        left.spines[["top", "right"]].set_visible(False)
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
        right.set(xlabel="along the beam's travel (mm)", ylabel="across (mm)", aspect="equal")
        right.set_title(f"{float(first.wavelength):g} nm, reflected")
        figure.colorbar(image, ax=right, label="light leaving per area (m⁻²)", shrink=0.85)
        return annotate_figure(figure, [left, right], describe_conditions(dataset, select))
