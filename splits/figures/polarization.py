"""How light that layers send back is polarized."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.dataset import at_points
from splits.figures.directions import DASHES, STEEPEST_DEG, lines_of, plane_of
from splits.figures.style import BAND, parameter_label, style


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
    plane = plane_of(at_points(dataset, at or {}))
    with style():
        figure, (left, right) = plt.subplots(1, 2, figsize=(8.8, 3.9), layout="constrained")
        for number, (label, colour, line) in enumerate(lines_of(plane, "brdf")):
            dash = DASHES[number % len(DASHES)]
            angle = line.angle.values
            value, error = line.brdf.values, line.brdf_stderr.values
            q, q_error = line.brdf_q.values, line.brdf_q_stderr.values
            lit = value > 0.0
            degree = np.divide(-q, value, out=np.zeros_like(q), where=lit)
            # Q and I are taken as independent: where light is polarized, they vary together.
            spread = np.hypot(q_error, degree * error)
            spread = np.divide(spread, value, out=np.zeros_like(q), where=lit)
            for axes, y, e in ((left, value, error), (right, degree, spread)):
                axes.plot(angle, y, color=colour, ls=dash, lw=1.4, label=label)
                axes.fill_between(angle, y - BAND * e, y + BAND * e, color=colour, alpha=0.3, lw=0)
        left.set(ylabel="BRDF (1/sr)", ylim=(0.0, None))
        right.set_ylabel("degree of polarization across the plane")
        right.axhline(0.0, color="0.6", lw=0.8)
        for axes in (left, right):
            axes.set(xlabel="viewing angle, forward positive (°)")
            axes.set_xlim(-STEEPEST_DEG - 5.0, STEEPEST_DEG + 5.0)
            axes.set_xticks(np.arange(-90, 91, 30))
            axes.spines[["top", "right"]].set_visible(False)
        dims = [str(d) for d in plane.brdf.dims if d not in ("angle", "wavelength")]
        if dims:
            title = legend or " · ".join(map(parameter_label, dims))
            left.legend(title=title, frameon=False)
    return figure
