"""What measured spectra tell: the fit, the distribution of what is free, the averaging kernel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from splits.figures.notes import finished
from splits.figures.style import (
    BAND,
    SMALLEST,
    TWO_COLUMNS,
    Drawing,
    colours,
    parameter_label,
    style,
    value_label,
)

MANY_NM = 2.0
"""Gaps in the wavelengths so many times the usual step are left open."""
BINS = 30
SHOWN = 400
"""Draws shown as dots."""
SHORT = {
    "optical_radius_um": "radius (µm)",
    "specific_surface_area_m2_kg": "area (m²/kg)",
    "liquid_water_content": "water",
    "saturation": "water",
    "iron_oxide": "iron oxide",
    "hematite_ratio": "hematite",
}
"""What corners and kernels, which have little room, call parameters."""
ROWS = 3
"""Rows at most: samples, evenly among all, and what is known of them."""
FEWEST = 3
"""Samples from which on a slope is told."""
_ROW_INCHES = 3.3


def retrievals(
    dataset: xr.Dataset, known: Mapping[str, Mapping[str, float]] | None = None
) -> Figure:
    """Draw a row for some samples, and what was found of all against what is known.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.experiments.run_retrieve.together` returns it.
    known : mapping, optional
        Values by parameter and sample that were found otherwise.
    """
    every = dataset.sample.values
    most = min(len(every), ROWS - bool(known))
    some = np.unique(np.linspace(0, len(every) - 1, most).round().astype(int))
    samples = every[some]
    rows = len(samples) + bool(known)
    with style():
        figure = Drawing(TWO_COLUMNS, _ROW_INCHES * rows)
        grid = figure.add_gridspec(rows, 3, width_ratios=[1.3, 1.6, 0.6])
        tops = []
        for row, sample in enumerate(samples):
            part = dataset.sel(sample=sample)
            tops.append(_spectrum(figure, grid[row, 0], part, value_label(sample, "sample")))
            _corner(figure, grid[row, 1], part)
            _kernel(figure.add_subplot(grid[row, 2]), part)
        if known:
            below = grid[rows - 1, :].subgridspec(1, max(2, len(known)))
            for column, (name, values) in enumerate(known.items()):
                tops.append(_against(figure.add_subplot(below[column]), dataset, name, values))
        note = (
            "Bands: two standard errors, of the measurement (grey) and of the table (blue). Dots: "
            "draws from what the spectrum allows; lines: 16, 50 and 84 %."
        )
        return finished(figure, tops, note)


def _against(axes: Axes, dataset: xr.Dataset, name: str, known: Mapping[str, float]) -> Axes:
    """Draw what was found of a parameter against what is known of it."""
    samples = [s for s in known if s in dataset.sample.values]
    x = np.array([known[s] for s in samples])
    part = dataset.quantiles.sel(sample=samples, parameter=name).transpose("quantile", "sample")
    widest, low, y, high, most = part.values
    (blue,) = colours(1)
    for ends, width in (((widest, most), 0.6), ((low, high), 2.0)):
        axes.vlines(x, *ends, color=blue, lw=width)
    axes.plot(x, y, "o", color=blue, ms=3)
    top = 1.08 * max(float(most.max()), float(x.max()))
    axes.plot([0.0, top], [0.0, top], color="black", lw=0.6)
    if len(samples) >= FEWEST:
        slope = float((x * y).sum() / (x * x).sum())
        scatter = float(np.sqrt(np.sum((y - slope * x) ** 2) / (len(x) - 1)))
        axes.set_title(f"slope {slope:.2f}, scatter {scatter:.2g}")
    else:
        axes.set_title("against what is known")
    axes.set_xlabel(f"{parameter_label(name)}, known")
    axes.set_ylabel(f"{parameter_label(name)}, retrieved")
    axes.set_xlim(0.0, top)
    axes.set_ylim(0.0, top)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _open(x: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Return rows with a gap wherever wavelengths were left out."""
    steps = np.diff(x)
    usual = np.median(steps) if steps.size else 0.0
    gaps = np.flatnonzero(steps > MANY_NM * usual) + 1
    return [np.insert(row.astype(float), gaps, np.nan) for row in (x, *rows)]


def _spectrum(figure: Figure, place: SubplotSpec, part: xr.Dataset, title: str) -> Axes:
    """Draw measured and fitted reflectance, and their difference below; return the upper panel."""
    inner = place.subgridspec(2, 1, height_ratios=[2.0, 1.0])
    top = figure.add_subplot(inner[0])
    bottom = figure.add_subplot(inner[1], sharex=top)
    (blue,) = colours(1)
    x, measured, noise, fitted, error = _open(
        part.wavelength.values, part.measured.values, part.measured_stderr.values,
        part.fitted.values, part.fitted_stderr.values,
    )  # fmt: skip
    top.plot(x, measured, color="black", lw=1.0, label="measured")
    top.plot(x, fitted, color=blue, lw=1.0, ls="--", label="table")
    bottom.plot(x, fitted - measured, color=blue, lw=0.8)
    for axes, middle in ((top, measured), (bottom, np.zeros_like(measured))):
        axes.fill_between(x, middle - BAND * noise, middle + BAND * noise, color="0.8", lw=0)
    bottom.fill_between(
        x, fitted - measured - BAND * error, fitted - measured + BAND * error, color=blue,
        alpha=0.25, lw=0,
    )  # fmt: skip
    bottom.axhline(0.0, color="black", lw=0.6)
    top.set_title(title)
    top.set_ylabel("reflectance")
    top.set_ylim(0.0, 1.1 * float(np.nanmax([measured, fitted])))
    top.tick_params(labelbottom=False)
    bottom.set_ylabel("difference")
    bottom.set_xlabel("wavelength (nm)")
    misfit = f"χ² {float(part.chi2):.3g} of {float(part.chi2_expected):.3g}"
    top.legend(title=misfit, frameon=False, fontsize=SMALLEST, title_fontsize=SMALLEST)
    for axes in (top, bottom):
        axes.spines[["top", "right"]].set_visible(False)
    return top


def _corner(figure: Figure, place: SubplotSpec, part: xr.Dataset) -> None:
    """Draw the draws: each parameter, and every two of them."""
    names = list(map(str, part.parameter.values))
    inner = place.subgridspec(len(names), len(names), wspace=0.04, hspace=0.04)
    (blue,) = colours(1)
    draws = part.draws.transpose("draw", "parameter").values
    some = draws[:: max(1, len(draws) // SHOWN)]
    marks = part.quantiles.sel(quantile=[0.16, 0.5, 0.84]).transpose("quantile", "parameter").values
    for i in range(len(names)):
        for j in range(i + 1):
            axes = figure.add_subplot(inner[i, j])
            if i == j:
                axes.hist(draws[:, i], bins=BINS, color=blue, alpha=0.6)
                for mark in marks[:, i]:
                    axes.axvline(mark, color="black", lw=0.6)
                axes.set_yticks([])
                axes.spines[["top", "right", "left"]].set_visible(False)
            else:
                axes.plot(some[:, j], some[:, i], ".", ms=1.0, color=blue, alpha=0.4,
                          rasterized=True)  # fmt: skip
            low, high = np.quantile(draws[:, j], [0.002, 0.998])
            axes.set_xlim(low, high)
            _label(axes, names, (i, j))


def _label(axes: Axes, names: list[str], place: tuple[int, int]) -> None:
    """Label a panel of the corner at its outer edges only."""
    i, j = place
    axes.locator_params(nbins=3, axis="x")
    if i != j:
        axes.locator_params(nbins=3, axis="y")
    axes.tick_params(labelsize=SMALLEST)
    if i == len(names) - 1:
        axes.set_xlabel(_short(names[j]), fontsize=SMALLEST)
        axes.tick_params(axis="x", labelrotation=45)
    else:
        axes.tick_params(labelbottom=False)
    if j == 0 and i > 0:
        axes.set_ylabel(_short(names[i]), fontsize=SMALLEST)
    elif i != j:
        axes.tick_params(labelleft=False)


def _short(name: str) -> str:
    """Return a short label of a parameter, on two lines where it has a unit."""
    return SHORT.get(name, parameter_label(name)).replace(" (", "\n(")


def _kernel(axes: Axes, part: xr.Dataset) -> None:
    """Draw the averaging kernel as numbers on shades."""
    names = [_short(str(n)).partition("\n")[0] for n in part.parameter.values]
    kernel = part.averaging_kernel.values
    axes.imshow(kernel, cmap="RdBu", vmin=-1.5, vmax=1.5)
    for i, j in np.ndindex(kernel.shape):
        told = f"{kernel[i, j]:.2f}".replace("-0.00", "0.00").replace("-", "−")
        colour = "white" if abs(kernel[i, j]) > 1.05 else "black"
        axes.text(j, i, told, ha="center", va="center", fontsize=SMALLEST, color=colour)
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=SMALLEST)
    axes.set_yticks(range(len(names)), names, fontsize=SMALLEST)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    freedom = float(part.degrees_of_freedom)
    axes.set_title(f"averaging kernel\n{freedom:.2f} degrees of freedom", fontsize=SMALLEST)
