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
    "the difference from the fit relative to the standard error. Dots: draws from the posterior"
)
"""Note on the figure of retrievals from returns."""
MIN_SHOWN_FRACTION = 0.3
"""Lower end of the axis, relative to the smallest measured or fitted value above 0."""


def draw_return_fit(figure: Figure, cell: SubplotSpec, part: xr.Dataset, title: str) -> Axes:
    """Draw a measured and fitted return and their difference; return the upper panel."""
    inner = cell.subgridspec(2, 1, height_ratios=[2.0, 1.0])
    top = figure.add_subplot(inner[0])
    bottom = figure.add_subplot(inner[1], sharex=top)
    part = part.isel(model=0)
    delay, width = 1e9 * part.delay.values, 1e9 * np.diff(part.delay_bounds.values, axis=1)[:, 0]
    n_wavelengths, lowest = part.sizes["wavelength"], np.inf
    for wavelength, colour in zip(
        part.wavelength.values, pick_colours(n_wavelengths, "wavelength"), strict=True
    ):
        line = part.sel(wavelength=wavelength)
        measured, noise, fitted, error = (
            1e-9 * line[name].values
            for name in ("measured", "measured_stderr", "fitted", "fitted_stderr")
        )
        label = f"{wavelength:g} nm" if n_wavelengths > 1 else "measured"
        top.errorbar(
            delay, measured, BAND_SIGMA * noise, fmt="o", ms=2.0, lw=0.7,
            color=colour if n_wavelengths > 1 else "black", label=label,
        )  # fmt: skip
        top.plot(delay, fitted, color=colour, lw=1.0, ls="--")
        low, high = fitted - BAND_SIGMA * error, fitted + BAND_SIGMA * error
        top.fill_between(delay, low, high, color=colour, alpha=0.25, lw=0)
        bottom.bar(
            delay, (measured - fitted) / noise, width, color=colour, alpha=0.6 / n_wavelengths**0.5
        )
        shown = np.concatenate([measured, fitted])
        lowest = min(lowest, shown[shown > 0.0].min(initial=np.inf))
    top.plot([], [], color="black", lw=1.0, ls="--", label=_describe_fit(part))
    top.set(yscale="log", ylabel="returned light per time (ns⁻¹)", title=title)
    if np.isfinite(lowest):
        top.set_ylim(bottom=MIN_SHOWN_FRACTION * lowest)
    bottom.axhspan(-BAND_SIGMA, BAND_SIGMA, color="0.85", lw=0, zorder=0)
    bottom.axhline(0.0, color="black", lw=0.6)
    bottom.set(xlabel="delay (ns)", ylabel="difference / error")
    top.tick_params(labelbottom=False)
    top.legend(frameon=False, fontsize=SMALL_FONT_PT, handlelength=1.2, borderaxespad=0.0)
    for axes in (top, bottom):
        axes.spines[["top", "right"]].set_visible(False)
    return top


def _describe_fit(part: xr.Dataset) -> str:
    """Return the label of the fit with its misfit."""
    return f"fit, χ² {float(part.chi2):.0f} of {float(part.chi2_expected):.0f}"
