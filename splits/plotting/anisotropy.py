"""Anisotropy factors: the principal plane, and every measured direction beside the model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.analysis.anisotropy import ALL_DIRECTIONS, FACTOR_COLUMN
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
"""Axes of the dataset: of models, and of samples."""
MAX_PLANE_ANGLE_DEG = 65.0
"""Up to which the principal plane is drawn."""
ANGLE_MARKERS = "os^Dv<>ph*"
_HEIGHT_INCHES = 5.2


def draw_anisotropy(
    dataset: xr.Dataset, table: pd.DataFrame, misfits: pd.DataFrame, wavelength_nm: float
) -> Figure:
    """Draw a column for every measured sample: the principal plane, and all directions below.

    Parameters
    ----------
    dataset : xarray.Dataset
        BRDF, see `splits.analysis.anisotropy.beside_measured`.
    table, misfits : pandas.DataFrame
        As `beside_measured` and `by_angle` return them.
    wavelength_nm : float
        Of the principal plane.
    """
    axis, sample = MODEL_AXIS, SAMPLE_AXIS
    samples, models = list(dict.fromkeys(table[sample])), list(map(str, dataset[axis].values))
    shades = dict(zip(models, pick_colours(len(models), "medium"), strict=True))
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
            own = table[table[sample] == value]
            label = next(x for x in dataset[sample].values if float(x) == float(value))
            _draw_plane(top, dataset.sel({sample: label}), own[own.wavelength_nm == wavelength_nm],
                   axis, shades)  # fmt: skip
            top.set_title(f"{format_parameter(sample)} {value:g}, {wavelength_nm:g} nm")
            _draw_all_directions(bottom, own, misfits[misfits[sample] == value], axis, shades)
        panels[0, 0].set_ylabel("anisotropy factor")
        panels[1, 0].set_ylabel("anisotropy factor, modelled")
        note = (
            "Above: principal plane, forward to the right; bands are two standard errors of the "
            "model. Below: every direction and wavelength; marks tell the angle of view."
        )
        return annotate_figure(figure, panels[0], note)


def _draw_plane(
    axes: Axes, dataset: xr.Dataset, rows: pd.DataFrame, model_axis: str, colour_of: dict[str, Any]
) -> None:
    """Draw the principal plane of every model, and what was measured in it."""
    for model, colour in colour_of.items():
        part = dataset.sel({model_axis: model}).sel(wavelength=float(rows.wavelength_nm.iloc[0]))
        plane = select_principal_plane(part[["brdf", "brdf_stderr"]])
        plane = plane.isel(angle=np.abs(plane.angle.values) <= MAX_PLANE_ANGLE_DEG)
        above = float(plane.brdf.sel(angle=0.0, method="nearest"))
        x, y = plane.angle.values, plane.brdf.values / above
        error = BAND_SIGMA * plane.brdf_stderr.values / above
        axes.plot(x, y, color=colour, lw=1.2, label=format_value(model, model_axis))
        axes.fill_between(x, y - error, y + error, color=colour, alpha=0.25, lw=0)
    first = rows[rows[model_axis] == next(iter(colour_of))]
    inside = first[first.azimuth_deg.isin([0.0, 180.0])]
    x = np.where(inside.azimuth_deg == 0.0, 1.0, -1.0) * inside.polar_deg
    axes.plot(x, inside[FACTOR_COLUMN], "o", color="black", ms=4, label="measured", zorder=3)
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
        every = misfits[(misfits[model_axis] == model) & (misfits.polar_deg == ALL_DIRECTIONS)]
        rmse = float(np.sqrt(np.average(every.rmse**2, weights=every.directions)))
        for mark, angle in zip(ANGLE_MARKERS, angles, strict=False):
            part = rows[(rows[model_axis] == model) & (rows.polar_deg == angle)]
            label = (
                f"{format_value(model, model_axis)}: RMSE {rmse:.3f}"
                if mark == ANGLE_MARKERS[0]
                else None
            )
            axes.plot(part[FACTOR_COLUMN], part.modelled, mark, color=colour, ms=2.2, alpha=0.6,
                      label=label)  # fmt: skip
    low, high = min(rows[FACTOR_COLUMN].min(), rows.modelled.min()), max(rows[FACTOR_COLUMN].max(),
                                                                rows.modelled.max())  # fmt: skip
    axes.plot([low, high], [low, high], color="black", lw=0.6)
    for mark, angle in zip(ANGLE_MARKERS, angles, strict=False):
        axes.plot([], [], mark, color="0.4", ms=2.5, label=f"seen from {angle:g}°")
    axes.set_xlabel("anisotropy factor, measured")
    axes.legend(frameon=False, fontsize=SMALL_FONT_PT, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)
