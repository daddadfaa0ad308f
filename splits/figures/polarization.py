"""How light that layers send back is polarized."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.dataset import at_points
from splits.figures.conditions import conditions
from splits.figures.notes import finished
from splits.figures.planes import (
    INSIDE,
    NAMES,
    STEEPEST_DEG,
    VIEWING,
    lines_of,
    part_of,
    plane_of,
)
from splits.figures.style import BAND, TWO_COLUMNS, style, subplots


def polarization(
    dataset: xr.Dataset,
    at: Mapping[str, float | str] | None = None,
    legend: str | None = None,
) -> Figure:
    """Draw the BRDF and its degree of linear polarization in the principal plane.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of `splits.goniophotometer` with Stokes parameters, or of an experiment with it.
    at : mapping, optional
        Grid labels to hold fixed.
    legend : str, optional
        Title of the legend; the grid's parameters by default.
    """
    dataset = at_points(dataset, at or {})
    plane = plane_of(dataset)
    lines = lines_of(plane, "brdf")
    with style():
        figure, (left, right) = subplots(1, 2, width=TWO_COLUMNS, height=2.6)
        for one in lines.lines:
            line = part_of(plane, one.labels)
            angle = line.angle.values
            value, error = line.brdf.values, line.brdf_stderr.values
            q, q_error = line.brdf_q.values, line.brdf_q_stderr.values
            # Where no light is, or no cell, there is no degree.
            lit = value > 0.0
            nothing = np.full_like(q, np.nan)
            degree = np.divide(-q, value, out=nothing.copy(), where=lit)
            # Q and I are taken as independent: where light is polarized, they vary together.
            spread = np.hypot(q_error, degree * error)
            spread = np.divide(spread, value, out=nothing, where=lit)
            for axes, y, e in ((left, value, error), (right, degree, spread)):
                axes.plot(angle, y, label=one.label, **one.to_plot_style())
                axes.fill_between(
                    angle, y - BAND * e, y + BAND * e, color=one.colour, alpha=0.3, lw=0
                )
        left.set(ylabel=NAMES["brdf"], ylim=(0.0, None))
        right.set_ylabel("degree of polarization across the plane")
        right.axhline(0.0, color="0.6", lw=0.6)
        for axes in (left, right):
            axes.set(xlabel=VIEWING)
            axes.set_xlim(-STEEPEST_DEG - 5.0, STEEPEST_DEG + 5.0)
            axes.set_xticks(np.arange(-90, 91, 30))
            axes.spines[["top", "right"]].set_visible(False)
        lines.add_legend(figure, [left], legend, INSIDE)
        return finished(figure, [left, right], conditions(dataset, at))
