"""What measured spectra tell: the fit, the distribution of what is free, the averaging kernel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import EngFormatter

from splits.plotting.annotations import annotate_figure
from splits.plotting.reference_values import (
    MIN_SLOPE_SAMPLES,
    draw_against_reference,
    get_model_colours,
    select_referenced_samples,
)
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    OffscreenFigure,
    format_parameter,
    format_value,
    use_style,
)

GAP_STEP_RATIO = 2.0
"""Gaps in the wavelengths so many times the usual step are left open."""
N_HISTOGRAM_BINS = 30
MAX_DRAWS_SHOWN = 400
"""Draws shown as dots, of all models together."""
SHORT_LABELS = {
    "optical_radius_um": "radius (µm)",
    "specific_surface_area_m2_kg": "area (m²/kg)",
    "liquid_water_content": "water",
    "saturation": "water",
    "iron_oxide": "iron oxide",
    "hematite_ratio": "hematite",
    "magnetite": "magnetite",
}
"""What corners and kernels, which have little room, call parameters."""
ENGINEERING_TICKS_FROM = 1e4
"""Numbers from which on ticks of corners say k for a thousand."""
MAX_ROWS = 3
"""Rows at most: samples, evenly among all, and what is known of them."""
MAX_KERNEL_PARAMETERS = 4
"""Parameters of an averaging kernel whose numbers fit at the usual size."""
_SAMPLE_HEIGHT_INCHES, _REFERENCE_HEIGHT_INCHES = 3.3, 2.4
"""Of a sample, and of what is known."""


def draw_retrievals(
    dataset: xr.Dataset,
    reference: Mapping[str, Mapping[str, float]] | None = None,
    prefixes: Sequence[str] = ("",),
) -> Figure:
    """Draw a row for some samples, and what was found of all against what is known.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.experiments.run_retrieve.together` returns it.
    reference : mapping, optional
        Values by parameter and sample that were found otherwise.
    prefixes : sequence of str
        How names of samples begin that have a panel of what is known together.
    """
    every = dataset.sample.values
    reference = {
        name: values
        for name, values in (reference or {}).items()
        if select_referenced_samples(dataset, values, "")
    }
    most = min(len(every), MAX_ROWS - bool(reference))
    some = np.unique(np.linspace(0, len(every) - 1, most).round().astype(int))
    samples = every[some]
    rows = len(samples) + bool(reference)
    with use_style():
        heights = [_SAMPLE_HEIGHT_INCHES] * len(samples) + [_REFERENCE_HEIGHT_INCHES] * bool(
            reference
        )
        figure = OffscreenFigure(TWO_COLUMNS_INCHES, sum(heights))
        grid = figure.add_gridspec(
            rows, 3, width_ratios=[1.3, 1.6, 0.6], height_ratios=heights
        )  # fmt: skip
        tops = []
        for row, sample in enumerate(samples):
            part = dataset.sel(sample=sample)
            tops.append(_draw_spectrum(figure, grid[row, 0], part, format_value(sample, "sample")))
            _draw_corner(figure, grid[row, 1], part)
            _draw_averaging_kernel(figure.add_subplot(grid[row, 2]), part)
        several = False
        if reference:
            panels = [
                (name, group) for name, values in reference.items() for group in prefixes
                if select_referenced_samples(dataset, values, group)
            ]  # fmt: skip
            below = grid[rows - 1, :].subgridspec(1, max(2, len(panels)))
            several = any(
                len(select_referenced_samples(dataset, reference[name], g)) >= MIN_SLOPE_SAMPLES
                for name, g in panels
            )
            for column, (name, group) in enumerate(panels):
                axes = figure.add_subplot(below[column])
                tops.append(draw_against_reference(axes, dataset, name, reference[name], group))
        note = _make_note(dataset, len(samples), several)
        return annotate_figure(figure, tops, note)


def _make_note(dataset: xr.Dataset, rows: int, several: bool) -> str:
    """Return what the foot of the figure says."""
    note = (
        "Bands: two standard errors, of the measurement (grey) and of the table (in colour). "
        "Dots: draws from what the spectrum allows"
    )
    if rows < dataset.sizes["sample"]:
        note = f"{rows} of {dataset.sizes['sample']} samples, evenly among all. " + note
    if dataset.sizes["model"] == 1:
        return note + "; lines: 16, 50 and 84 %."
    note += f". Averaging kernels: {format_value(str(dataset.model.values[0]), 'model')}."
    if several and np.isfinite(dataset.chi2_at_reference).any():
        note += " Beside what is known: χ² with that held, of what is expected."
    return note


def _insert_gaps(x: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Return rows with a gap wherever wavelengths were left out."""
    steps = np.diff(x)
    usual = np.median(steps) if steps.size else 0.0
    gaps = np.flatnonzero(steps > GAP_STEP_RATIO * usual) + 1
    return [np.insert(row.astype(float), gaps, np.nan) for row in (x, *rows)]


def _draw_spectrum(figure: Figure, place: SubplotSpec, part: xr.Dataset, title: str) -> Axes:
    """Draw measured and fitted reflectance, and their difference below; return the upper panel."""
    inner = place.subgridspec(2, 1, height_ratios=[2.0, 1.0])
    top = figure.add_subplot(inner[0])
    bottom = figure.add_subplot(inner[1], sharex=top)
    highest = 0.0
    for number, (model, colour) in enumerate(get_model_colours(part)):
        own = part.sel(model=model)
        x, measured, noise, fitted, error = _insert_gaps(
            own.wavelength.values, own.measured.values, own.measured_stderr.values,
            own.fitted.values, own.fitted_stderr.values,
        )  # fmt: skip
        if number == 0:
            top.plot(x, measured, color="black", lw=1.0, label="measured")
            for axes, middle in ((top, measured), (bottom, np.zeros_like(measured))):
                low, high = middle - BAND_SIGMA * noise, middle + BAND_SIGMA * noise
                axes.fill_between(x, low, high, color="0.8", lw=0)
        label = f"{format_value(model, 'model') if model else 'table'}, χ² {float(own.chi2):.0f}"
        if part.sizes["model"] == 1:
            label += f" of {float(own.chi2_expected):.0f}"
        top.plot(x, fitted, color=colour, lw=1.0, ls="--", label=label)
        off = fitted - measured
        bottom.plot(x, off, color=colour, lw=0.8)
        bottom.fill_between(
            x, off - BAND_SIGMA * error, off + BAND_SIGMA * error, color=colour, alpha=0.25, lw=0
        )
        highest = max(highest, float(np.nanmax([measured, fitted])))
    bottom.axhline(0.0, color="black", lw=0.6)
    expected = float(part.chi2_expected.isel(model=0))
    top.set_title(title if part.sizes["model"] == 1 else f"{title} (χ² expected: {expected:.0f})")
    top.set_ylabel("reflectance")
    # Room above for a legend of several lines.
    several = part.sizes["model"] > 1
    top.set_ylim(0.0, (1.35 + 0.13 * part.sizes["model"] if several else 1.1) * highest)
    top.tick_params(labelbottom=False)
    bottom.set_ylabel("difference")
    bottom.set_xlabel("wavelength (nm)")
    top.legend(frameon=False, fontsize=SMALL_FONT_PT, loc="upper right" if several else "best",
               handlelength=1.2, borderaxespad=0.0)  # fmt: skip
    for axes in (top, bottom):
        axes.spines[["top", "right"]].set_visible(False)
    return top


def _draw_corner(figure: Figure, place: SubplotSpec, part: xr.Dataset) -> None:
    """Draw the draws: each parameter, and every two of them."""
    names = list(map(str, part.parameter.values))
    inner = place.subgridspec(len(names), len(names), wspace=0.04, hspace=0.04)
    draws = part.draws.transpose("model", "draw", "parameter").values
    some = draws[:, :: max(1, len(draws) * draws.shape[1] // MAX_DRAWS_SHOWN)]
    shares = [0.16, 0.5, 0.84]
    marks = part.quantiles.sel(quantile=shares).transpose("model", "quantile", "parameter").values
    shades = [colour for _, colour in get_model_colours(part)]
    # A law that does not know of a parameter has no draws of it.
    low, high = np.nanquantile(draws, [0.002, 0.998], axis=(0, 1))
    for i in range(len(names)):
        for j in range(i + 1):
            axes = figure.add_subplot(inner[i, j])
            for number, colour in enumerate(shades):
                if i == j:
                    own = draws[number, np.isfinite(draws[number, :, i]), i]
                    axes.hist(own, bins=N_HISTOGRAM_BINS, color=colour, alpha=0.6)
                    for mark in marks[number, :, i] if len(shades) == 1 else ():
                        axes.axvline(mark, color="black", lw=0.6)
                else:
                    axes.plot(some[number, :, j], some[number, :, i], ".", ms=1.0, color=colour,
                              alpha=0.4, rasterized=True)  # fmt: skip
            if i == j:
                axes.set_yticks([])
                axes.spines[["top", "right", "left"]].set_visible(False)
            axes.set_xlim(low[j], high[j])
            _label_corner_axes(axes, names, (i, j))


def _label_corner_axes(axes: Axes, names: list[str], place: tuple[int, int]) -> None:
    """Label a panel of the corner at its outer edges only."""
    i, j = place
    axes.locator_params(nbins=3, axis="x")
    if i != j:
        axes.locator_params(nbins=3, axis="y")
        axes.ticklabel_format(axis="y", style="plain")
    for axis in (axes.xaxis, axes.yaxis):
        if max(axis.get_view_interval()) >= ENGINEERING_TICKS_FROM:
            axis.set_major_formatter(EngFormatter(sep=""))
    axes.tick_params(labelsize=SMALL_FONT_PT)
    if i == len(names) - 1:
        axes.set_xlabel(_get_short_label(names[j]), fontsize=SMALL_FONT_PT)
        axes.tick_params(axis="x", labelrotation=45)
    else:
        axes.tick_params(labelbottom=False)
    if j == 0 and i > 0:
        axes.set_ylabel(_get_short_label(names[i]), fontsize=SMALL_FONT_PT)
    elif i != j:
        axes.tick_params(labelleft=False)


def _get_short_label(name: str) -> str:
    """Return a short label of a parameter, on two lines where it has a unit."""
    return SHORT_LABELS.get(name, format_parameter(name)).replace(" (", "\n(")


def _draw_averaging_kernel(axes: Axes, part: xr.Dataset) -> None:
    """Draw the averaging kernel as numbers on shades."""
    part = part.isel(model=0)
    names = [_get_short_label(str(n)).partition("\n")[0] for n in part.parameter.values]
    kernel = part.averaging_kernel.values
    axes.imshow(kernel, cmap="RdBu", vmin=-1.5, vmax=1.5)
    for i, j in np.ndindex(kernel.shape):
        told = f"{kernel[i, j]:.2f}".replace("-0.00", "0.00").replace("-", "−")
        colour = "white" if abs(kernel[i, j]) > 1.05 else "black"
        size = SMALL_FONT_PT * min(1.0, MAX_KERNEL_PARAMETERS / len(names))
        axes.text(j, i, told, ha="center", va="center", fontsize=size, color=colour)
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=SMALL_FONT_PT)
    axes.set_yticks(range(len(names)), names, fontsize=SMALL_FONT_PT)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    freedom = float(part.degrees_of_freedom)
    axes.set_title(f"averaging kernel\n{freedom:.2f} degrees of freedom", fontsize=SMALL_FONT_PT)
