"""Figure of modelled and measured ratios to the nadir."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.analysis.anisotropy import ALL_DIRECTIONS, NADIR_RATIO
from splits.analysis.directions import select_principal_plane
from splits.plotting.annotations import annotate_figure
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    format_parameter,
    format_value,
    make_subplots,
    pick_colours,
    use_style,
)

MODEL_AXIS, SAMPLE_AXIS = "interpretation", "saturation"
"""Axes of the dataset for models and for samples."""
MAX_PLANE_ANGLE_DEG = 65.0
"""Largest viewing angle of the principal plane (degrees)."""
ANGLE_MARKERS = "os^Dv<>ph*"
_HEIGHT_INCHES = 5.2


def draw_anisotropy(
    dataset: xr.Dataset, table: pd.DataFrame, misfits: pd.DataFrame, wavelength_nm: float
) -> Figure:
    """Draw the principal plane and all directions for every measured sample, a column each.

    Parameters
    ----------
    dataset : xarray.Dataset
        BRDF, see `splits.analysis.anisotropy.compare_with_measured`.
    table, misfits : pandas.DataFrame
        Outputs of `compare_with_measured` and `summarize_by_angle`.
    wavelength_nm : float
        Wavelength of the principal plane.
    """
    axis, sample = MODEL_AXIS, SAMPLE_AXIS
    table, misfits = (one[one.quantity == NADIR_RATIO] for one in (table, misfits))
    samples, models = list(dict.fromkeys(table[sample])), list(map(str, dataset[axis].values))
    colours = dict(zip(models, pick_colours(len(models), "medium"), strict=True))
    with use_style():
        figure, panels = make_subplots(
            2,
            len(samples),
            width=TWO_COLUMNS_INCHES,
            height=_HEIGHT_INCHES,
            sharey="row",
            squeeze=False,
            gridspec_kw={"height_ratios": [1.0, 1.1]},
        )
        for column, value in enumerate(samples):
            top, bottom = panels[:, column]
            rows = table[table[sample] == value]
            label = next(x for x in dataset[sample].values if float(x) == float(value))
            _draw_plane(
                top,
                dataset.sel({sample: label}),
                rows[rows.wavelength_nm == wavelength_nm],
                axis,
                colours,
            )
            top.set_title(f"{format_parameter(sample)} {value:g}, {wavelength_nm:g} nm")
            _draw_all_directions(bottom, rows, misfits[misfits[sample] == value], axis, colours)
        panels[0, 0].set_ylabel("ratio to the nadir")
        panels[1, 0].set_ylabel("ratio to the nadir, modelled")
        note = (
            "Above: principal plane, forward to the right; bands are two standard errors of the "
            "model. Below: every direction and wavelength; markers show the viewing angle."
        )
        return annotate_figure(figure, panels[0], note)


def _draw_plane(
    axes: Axes, dataset: xr.Dataset, rows: pd.DataFrame, model_axis: str, colour_of: dict[str, Any]
) -> None:
    """Draw the principal plane of every model and of the measurement."""
    for model, colour in colour_of.items():
        part = dataset.sel({model_axis: model}).sel(wavelength=float(rows.wavelength_nm.iloc[0]))
        plane = select_principal_plane(part[["brdf", "brdf_stderr"]])
        plane = plane.isel(angle=np.abs(plane.angle.values) <= MAX_PLANE_ANGLE_DEG)
        nadir = float(plane.brdf.sel(angle=0.0, method="nearest"))
        x, y = plane.angle.values, plane.brdf.values / nadir
        error = BAND_SIGMA * plane.brdf_stderr.values / nadir
        axes.plot(x, y, color=colour, lw=1.2, label=format_value(model, model_axis))
        axes.fill_between(x, y - error, y + error, color=colour, alpha=0.25, lw=0)
    first = rows[rows[model_axis] == next(iter(colour_of))]
    inside = first[first.azimuth_deg.isin([0.0, 180.0])]
    x = np.where(inside.azimuth_deg == 0.0, 1.0, -1.0) * inside.polar_deg
    axes.plot(x, inside.measured, "o", color="black", ms=4, label="measured", zorder=3)
    axes.set_xlabel("viewing angle, forward positive (°)")
    axes.legend(frameon=False, fontsize=SMALL_FONT_PT)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_all_directions(
    axes: Axes,
    rows: pd.DataFrame,
    misfits: pd.DataFrame,
    model_axis: str,
    colour_of: dict[str, Any],
) -> None:
    """Draw every direction and wavelength of a sample, modelled over measured."""
    angles = sorted(rows.polar_deg.unique())
    for model, colour in colour_of.items():
        summary = misfits[(misfits[model_axis] == model) & (misfits.polar_deg == ALL_DIRECTIONS)]
        rmse = float(np.sqrt(np.average(summary.rmse**2, weights=summary.directions)))
        for marker, angle in zip(ANGLE_MARKERS, angles, strict=False):
            part = rows[(rows[model_axis] == model) & (rows.polar_deg == angle)]
            label = (
                f"{format_value(model, model_axis)}: RMSE {rmse:.3f}"
                if marker == ANGLE_MARKERS[0]
                else None
            )
            axes.plot(part.measured, part.modelled, marker, color=colour, ms=2.2, alpha=0.6,
                      label=label)  # fmt: skip
    low, high = min(rows.measured.min(), rows.modelled.min()), max(rows.measured.max(),
                                                                rows.modelled.max())  # fmt: skip
    axes.plot([low, high], [low, high], color="black", lw=0.6)
    for marker, angle in zip(ANGLE_MARKERS, angles, strict=False):
        axes.plot([], [], marker, color="0.4", ms=2.5, label=f"seen from {angle:g}°")
    axes.set_xlabel("ratio to the nadir, measured")
    axes.legend(frameon=False, fontsize=SMALL_FONT_PT, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)
