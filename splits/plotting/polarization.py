"""Figure of the polarization of light reflected by layers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.core.incident_stokes import get_incident_stokes
from splits.core.validation import invalid
from splits.io.netcdf import select_points
from splits.plotting.annotations import annotate_figure, describe_conditions
from splits.plotting.direction_axes import (
    MAX_INSET_LINES,
    MAX_POLAR_DEG,
    QUANTITY_LABELS,
    VIEWING_ANGLE_LABEL,
    describe_bins,
    extract_plane,
    make_lines,
    select_line,
)
from splits.plotting.style import (
    BAND_SIGMA,
    TWO_COLUMNS_INCHES,
    make_subplots,
    start_at_zero,
    use_style,
)


def draw_polarization(
    dataset: xr.Dataset,
    select: Mapping[str, float | str] | None = None,
    legend: str | None = None,
) -> Figure:
    """Draw the BRDF and its degree of linear polarization in the principal plane.

    The degree has a sign, −Q/I, where U is 0 by symmetry: without U and V of the incident light.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.goniophotometer` with Stokes parameters, or of an experiment with it.
    select : mapping, optional
        Grid labels to select.
    legend : str, optional
        Title of the legend; by default the parameters of the grid.
    """
    dataset = select_points(dataset, select or {})
    if "brdf_dolp" not in dataset:
        hint = "stokes, and polarized layers of particles, with next_event or bins"
        raise invalid("figure.kind", "polarization", "left out without polarization", hint)
    plane = extract_plane(dataset)
    lines = make_lines(plane, "brdf")
    is_symmetric = not any(get_incident_stokes(dataset.attrs)[2:])
    with use_style():
        figure, (left, right) = make_subplots(1, 2, width=TWO_COLUMNS_INCHES, height=2.6)
        for grid_line in lines.lines:
            line = select_line(plane, grid_line.labels)
            angle = line.angle.values
            value, error = line.brdf.values, line.brdf_stderr.values
            degree, degree_error = _extract_degree(line, is_symmetric)
            for axes, y, stderr in ((left, value, error), (right, degree, degree_error)):
                axes.plot(angle, y, label=grid_line.label, **grid_line.to_plot_style())
                axes.fill_between(
                    angle,
                    y - BAND_SIGMA * stderr,
                    y + BAND_SIGMA * stderr,
                    color=grid_line.colour,
                    alpha=0.3,
                    lw=0,
                )
        left.set_ylabel(QUANTITY_LABELS["brdf"])
        start_at_zero(left, "brdf")
        right.set_ylabel("degree of polarization" + (", −Q/I" if is_symmetric else ""))
        right.axhline(0.0, color="0.6", lw=0.6)
        for axes in (left, right):
            axes.set(xlabel=VIEWING_ANGLE_LABEL)
            axes.set_xlim(-MAX_POLAR_DEG - 5.0, MAX_POLAR_DEG + 5.0)
            axes.set_xticks(np.arange(-90, 91, 30))
            axes.spines[["top", "right"]].set_visible(False)
        lines.add_legend(figure, [left], legend, MAX_INSET_LINES)
        return annotate_figure(
            figure, [left, right], describe_conditions(dataset, select), describe_bins(dataset)
        )


def _extract_degree(line: xr.Dataset, is_symmetric: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the degree of polarization and its error, not a number without light."""
    degree = line.brdf_dolp
    if is_symmetric:
        # This has no bias.
        degree = -line.brdf_q / line.brdf.where(line.brdf > 0.0)
    return degree.where(line.brdf > 0.0).values, line.brdf_dolp_stderr.values
