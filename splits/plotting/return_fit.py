"""Panels of a measured return of a pulse and its fit."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from splits.plotting.style import BAND_SIGMA, SMALL_FONT_PT, pick_colours

RETURN_NOTE = (
    "Return: two standard errors of the measurement (bars) and of the table (bands); below, "
    "the difference from the fit in standard errors of the measurement. Dots: draws from the "
    "posterior; crosses and dotted lines: reference values"
)
"""Note on the figure of retrievals from returns."""
MIN_SHOWN_FRACTION = 0.3
"""Lower end of the axis, relative to the smallest measured or fitted value above 0."""
KNOWN_COLOUR = "crimson"
"""Colour of known values of parameters."""
MIN_SHOWN_SIGMA = 3.0
"""Smallest end of the axis of differences, in standard errors."""


def draw_return_fit(figure: Figure, cell: SubplotSpec, part: xr.Dataset, title: str) -> Axes:
    """Draw a measured and fitted return and their difference; return the upper panel."""
    inner = cell.subgridspec(2, 1, height_ratios=[2.0, 1.0])
    top = figure.add_subplot(inner[0])
    bottom = figure.add_subplot(inner[1], sharex=top)
    part = part.isel(model=0)
    delay = 1e9 * part.delay.values
    n_wavelengths, lowest = part.sizes["wavelength"], np.inf
    several = n_wavelengths > 1
    for wavelength, colour in zip(
        part.wavelength.values, pick_colours(n_wavelengths, "wavelength"), strict=True
    ):
        line = part.sel(wavelength=wavelength)
        measured, noise, fitted, error = (
            1e-9 * line[name].values
            for name in ("measured", "measured_stderr", "fitted", "fitted_stderr")
        )
        label, marks = (f"{wavelength:g} nm", colour) if several else ("return", "black")
        top.errorbar(
            delay, measured, BAND_SIGMA * noise, fmt="o", ms=2.0, lw=0.7, color=marks, label=label
        )
        top.plot(delay, fitted, color=colour, lw=1.0, ls="--")
        low, high = fitted - BAND_SIGMA * error, fitted + BAND_SIGMA * error
        top.fill_between(delay, low, high, color=colour, alpha=0.25, lw=0)
        bottom.step(delay, (measured - fitted) / noise, where="mid", color=colour, lw=0.8)
        shown = np.concatenate([measured, fitted])
        lowest = min(lowest, shown[shown > 0.0].min(initial=np.inf))
    fit_label = f"fit, χ² {float(part.chi2):.0f} of {float(part.chi2_expected):.0f}"
    fit_colour = "black" if several else pick_colours(1)[0]
    top.plot([], [], color=fit_colour, lw=1.0, ls="--", label=fit_label)
    top.set(yscale="log", ylabel="returned light per time (ns⁻¹)", title=title)
    if np.isfinite(lowest):
        top.set_ylim(bottom=MIN_SHOWN_FRACTION * lowest)
    largest = float(np.abs(bottom.dataLim.intervaly).max())
    bottom.set_ylim(-max(MIN_SHOWN_SIGMA, 1.1 * largest), max(MIN_SHOWN_SIGMA, 1.1 * largest))
    bottom.axhspan(-BAND_SIGMA, BAND_SIGMA, color="0.85", lw=0, zorder=0)
    bottom.axhline(0.0, color="black", lw=0.6)
    bottom.set(xlabel="delay (ns)", ylabel="difference / error")
    top.tick_params(labelbottom=False)
    top.legend(frameon=False, fontsize=SMALL_FONT_PT, handlelength=1.2, borderaxespad=0.0)
    for axes in (top, bottom):
        axes.spines[["top", "right"]].set_visible(False)
    return top


def mark_known_values(axes: Axes, x: float | None, y: float | None) -> None:
    """Mark known values of one or two parameters in a panel of draws, if they are inside it."""
    if x is not None and y is not None:
        axes.plot([x], [y], "x", color=KNOWN_COLOUR, ms=5, mew=1.2)
    elif x is not None and axes.get_xlim()[0] <= x <= axes.get_xlim()[1]:
        axes.axvline(x, color=KNOWN_COLOUR, lw=1.2, ls=":")
