"""Figure of retrievals: fitted spectrum or return, posterior, averaging kernel, references."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import EngFormatter, MaxNLocator

from splits.analysis.measured import fit_proportional
from splits.core.escaping import escape_mathtext
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    OffscreenFigure,
    annotate_figure,
    draw_band,
    draw_curve,
    format_parameter,
    format_value,
    pick_colours,
    use_style,
)

GAP_STEP_RATIO = 2.0
"""Ratio of a gap in the wavelengths to the median step above which lines are interrupted."""
N_HISTOGRAM_BINS = 30
MAX_DRAWS_SHOWN = 400
"""Largest number of draws shown as dots, for all models together."""
SHORT_LABELS = {
    "optical_radius_um": "radius (µm)",
    "specific_surface_area_m2_kg": "area (m²/kg)",
    "density_kg_m3": "density (kg/m³)",
    "liquid_water_content": "water",
    "saturation": "water",
    "iron_oxide": "iron oxide",
    "hematite_ratio": "hematite",
    "magnetite": "magnetite",
}
"""Short labels of parameters for corner plots and kernels."""
ENGINEERING_TICKS_FROM = 1e4
"""Values from which ticks of corner plots use k for a thousand."""
SPECTRUM_NOTE = (
    "Bands: two standard errors, of the measurement (grey) and of the table (in colour). "
    "Dots: draws from the posterior"
)
"""Note on the figure of retrievals from spectra."""
MAX_ROWS = 3
"""Largest number of rows: evenly selected samples, and reference values."""
MAX_KERNEL_PARAMETERS = 4
"""Largest number of parameters of an averaging kernel with text of normal size."""
_SAMPLE_HEIGHT_INCHES, _REFERENCE_HEIGHT_INCHES = 3.3, 2.4
"""Heights of the rows of samples and of reference values."""


@use_style()
def draw_retrievals(
    dataset: xr.Dataset,
    reference: Mapping[str, Mapping[str, float]] | None = None,
    prefixes: Sequence[str] = ("",),
) -> Figure:
    """Draw a row for some samples, and retrieved against reference values of all.

    Parameters
    ----------
    dataset : xarray.Dataset
        Output of `splits.experiments.run_retrieve.combine_samples`.
    reference : mapping, optional
        Independent values by parameter and sample.
    prefixes : sequence of str
        Prefixes of the names of samples that have a common panel of reference values.
    """
    all_samples = dataset.sample.values
    is_return = "delay_s" in dataset.dims
    known = reference or {}
    # Corner plots of returns show reference values.
    reference = {
        name: values
        for name, values in ({} if is_return else known).items()
        if select_referenced_samples(dataset, values, "")
    }
    max_samples = min(len(all_samples), MAX_ROWS - bool(reference))
    indices = np.unique(np.linspace(0, len(all_samples) - 1, max_samples).round().astype(int))
    samples = all_samples[indices]
    rows = len(samples) + bool(reference)
    heights = [_SAMPLE_HEIGHT_INCHES] * len(samples) + [_REFERENCE_HEIGHT_INCHES] * bool(reference)
    figure = OffscreenFigure(TWO_COLUMNS_INCHES, sum(heights))
    grid = figure.add_gridspec(
        rows, 3, width_ratios=[1.3, 1.6, 0.6], height_ratios=heights
    )  # fmt: skip
    title_axes = []
    for row, sample in enumerate(samples):
        part = dataset.sel(sample=sample)
        draw_fit = draw_return_fit if is_return else _draw_spectrum
        title = format_value(sample, "sample")
        title_axes.append(draw_fit(figure, grid[row, 0], part, title))
        marks = {name: values.get(sample) for name, values in known.items()}
        _draw_corner(figure, grid[row, 1], part, marks if is_return else {})
        _draw_averaging_kernel(figure.add_subplot(grid[row, 2]), part)
    has_slopes = False
    if reference:
        panels = [
            (name, group) for name, values in reference.items() for group in prefixes
            if select_referenced_samples(dataset, values, group)
        ]  # fmt: skip
        reference_cells = grid[rows - 1, :].subgridspec(1, max(2, len(panels)))
        has_slopes = any(
            len(select_referenced_samples(dataset, reference[name], prefix)) >= MIN_SLOPE_SAMPLES
            for name, prefix in panels
        )
        for column, (name, group) in enumerate(panels):
            axes = figure.add_subplot(reference_cells[column])
            title_axes.append(draw_against_reference(axes, dataset, name, reference[name], group))
    note = _make_note(dataset, len(samples), has_slopes)
    return annotate_figure(figure, title_axes, note)


def _make_note(dataset: xr.Dataset, rows: int, several: bool) -> str:
    """Return the note at the foot of the figure."""
    note = RETURN_NOTE if "delay_s" in dataset.dims else SPECTRUM_NOTE
    if rows < dataset.sizes["sample"]:
        note = f"{rows} of {dataset.sizes['sample']} samples, evenly among all. " + note
    if dataset.sizes["model"] == 1:
        return note + "; lines: 16, 50 and 84 %."
    note += f". Averaging kernels: {format_value(str(dataset.model.values[0]), 'model')}."
    if several and np.isfinite(dataset.chi2_at_reference).any():
        note += " Against reference values: χ² with these fixed, and its expectation."
    return note


def _insert_gaps(x: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Return rows with NaN inserted at gaps of the wavelengths."""
    steps = np.diff(x)
    median_step = np.median(steps) if steps.size else 0.0
    gaps = np.flatnonzero(steps > GAP_STEP_RATIO * median_step) + 1
    return [np.insert(row.astype(float), gaps, np.nan) for row in (x, *rows)]


def _draw_spectrum(figure: Figure, cell: SubplotSpec, part: xr.Dataset, title: str) -> Axes:
    """Draw measured and fitted reflectance and their difference; return the upper panel."""
    inner = cell.subgridspec(2, 1, height_ratios=[2.0, 1.0])
    top = figure.add_subplot(inner[0])
    bottom = figure.add_subplot(inner[1], sharex=top)
    highest = 0.0
    for number, (model, colour) in enumerate(get_model_colours(part)):
        part_of_model = part.sel(model=model)
        x, measured, noise, fitted, error = _insert_gaps(
            part_of_model.wavelength.values,
            part_of_model.measured.values,
            part_of_model.measured_stderr.values,
            part_of_model.fitted.values,
            part_of_model.fitted_stderr.values,
        )
        if number == 0:
            top.plot(x, measured, color="black", lw=1.0, label="measured")
            draw_band(top, x, measured, noise, color="0.8")
            draw_band(bottom, x, np.zeros_like(measured), noise, color="0.8")
        chi2 = float(part_of_model.chi2)
        label = f"{format_value(model, 'model') if model else 'table'}, χ² {chi2:.0f}"
        if part.sizes["model"] == 1:
            label += f" of {float(part_of_model.chi2_expected):.0f}"
        top.plot(x, fitted, color=colour, lw=1.0, ls="--", label=label)
        draw_curve(bottom, x, fitted - measured, error, alpha=0.25, color=colour, lw=0.8)
        highest = max(highest, float(np.nanmax([measured, fitted])))
    bottom.axhline(0.0, color="black", lw=0.6)
    expected = float(part.chi2_expected.isel(model=0))
    top.set_title(title if part.sizes["model"] == 1 else f"{title}\n(χ² expected: {expected:.0f})")
    top.set_ylabel(format_value(str(part.attrs.get("quantity", "reflectance"))))
    # Room for a legend of several lines.
    several = part.sizes["model"] > 1
    top.set_ylim(0.0, (1.35 + 0.13 * part.sizes["model"] if several else 1.1) * highest)
    top.tick_params(labelbottom=False)
    bottom.set(xlabel="wavelength (nm)", ylabel="difference")
    top.legend(frameon=False, fontsize=SMALL_FONT_PT, loc="upper right" if several else "best",
               handlelength=1.2, borderaxespad=0.0)  # fmt: skip
    return top


def _draw_corner(
    figure: Figure, cell: SubplotSpec, part: xr.Dataset, known: Mapping[str, float | None]
) -> None:
    """Draw the posterior draws: histograms, and all pairs of parameters, with known values."""
    names = list(map(str, part.parameter.values))
    inner = cell.subgridspec(len(names), len(names), wspace=0.04, hspace=0.04)
    draws = part.draws.transpose("model", "draw", "parameter").values
    shown_draws = draws[:, :: max(1, len(draws) * draws.shape[1] // MAX_DRAWS_SHOWN)]
    probabilities = [0.16, 0.5, 0.84]
    quantiles = (
        part.quantiles.sel(quantile=probabilities)
        .transpose("model", "quantile", "parameter")
        .values
    )
    colours = [colour for _, colour in get_model_colours(part)]
    # A law has no draws of parameters that it does not contain.
    low, high = np.nanquantile(draws, [0.002, 0.998], axis=(0, 1))
    for i in range(len(names)):
        for j in range(i + 1):
            axes = figure.add_subplot(inner[i, j])
            for number, colour in enumerate(colours):
                if i == j:
                    finite_draws = draws[number, np.isfinite(draws[number, :, i]), i]
                    axes.hist(finite_draws, bins=N_HISTOGRAM_BINS, color=colour, alpha=0.6)
                    for quantile in quantiles[number, :, i] if len(colours) == 1 else ():
                        axes.axvline(quantile, color="black", lw=0.6)
                else:
                    axes.plot(
                        shown_draws[number, :, j],
                        shown_draws[number, :, i],
                        ".",
                        ms=1.0,
                        color=colour,
                        alpha=0.4,
                        rasterized=True,
                    )
            if i == j:
                axes.set_yticks([])
                axes.spines["left"].set_visible(False)
            else:
                axes.spines[:].set_visible(True)
            axes.set_xlim(low[j], high[j])
            # Known values, if they are inside the panel.
            x, y = known.get(names[j]), known.get(names[i]) if i != j else None
            if x is not None and y is not None:
                axes.plot([x], [y], "x", color=KNOWN_COLOUR, ms=5, mew=1.2)
            elif x is not None and axes.get_xlim()[0] <= x <= axes.get_xlim()[1]:
                axes.axvline(x, color=KNOWN_COLOUR, lw=1.2, ls=":")
            axes.locator_params(nbins=3, axis="x")
            if i != j:
                axes.locator_params(nbins=3, axis="y")
                axes.ticklabel_format(axis="y", style="plain")
            for axis in (axes.xaxis, axes.yaxis):
                if max(axis.get_view_interval()) >= ENGINEERING_TICKS_FROM:
                    axis.set_major_formatter(EngFormatter(sep=""))
            axes.tick_params(labelsize=SMALL_FONT_PT)
            # Labels at the outer edges only.
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
    """Return a short label of a parameter, on two lines if it has a unit."""
    return SHORT_LABELS.get(name, format_parameter(name)).replace(" (", "\n(")


def _draw_averaging_kernel(axes: Axes, part: xr.Dataset) -> None:
    """Draw the averaging kernel as a coloured table of numbers."""
    part = part.isel(model=0)
    names = [_get_short_label(str(n)).partition("\n")[0] for n in part.parameter.values]
    kernel = part.averaging_kernel.values
    axes.imshow(kernel, cmap="RdBu", vmin=-1.5, vmax=1.5)
    for i, j in np.ndindex(kernel.shape):
        text = f"{kernel[i, j]:.2f}".replace("-0.00", "0.00").replace("-", "−")
        colour = "white" if abs(kernel[i, j]) > 1.05 else "black"
        size = SMALL_FONT_PT * min(1.0, MAX_KERNEL_PARAMETERS / len(names))
        axes.text(j, i, text, ha="center", va="center", fontsize=size, color=colour)
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=SMALL_FONT_PT)
    axes.set_yticks(range(len(names)), names, fontsize=SMALL_FONT_PT)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    degrees_of_freedom = float(part.degrees_of_freedom)
    axes.set_title(
        f"averaging kernel\n{degrees_of_freedom:.2f} degrees of freedom", fontsize=SMALL_FONT_PT
    )


MIN_SLOPE_SAMPLES = 3
"""Smallest number of samples for a fitted slope."""
MODEL_MARKERS = "os^D"
"""Markers of models."""
MODEL_OFFSET = 0.012
"""Horizontal offset between the points of models, relative to the axis."""


def draw_against_reference(
    axes: Axes, dataset: xr.Dataset, name: str, reference: Mapping[str, float], prefix: str
) -> Axes:
    """Draw retrieved values of a parameter against reference values, for all models."""
    samples = select_referenced_samples(dataset, reference, prefix)
    x = np.array([reference[s] for s in samples])
    top = highest = float(x.max())
    models = get_model_colours(dataset)
    for number, (model, colour) in enumerate(models):
        part_of_model = dataset.sel(model=model, sample=samples)
        shifted = x + (number - 0.5 * (len(models) - 1)) * MODEL_OFFSET * top
        quantiles = part_of_model.quantiles.sel(parameter=name).transpose("quantile", "sample")
        lowest_value, low, y, high, highest_value = quantiles.values
        if not np.isfinite(y).all():
            continue
        for limits, width in (((lowest_value, highest_value), 0.6), ((low, high), 2.0)):
            axes.vlines(shifted, *limits, color=colour, lw=width)
        labels = [format_value(model, "model")] if model else []
        if len(samples) >= MIN_SLOPE_SAMPLES:
            line = fit_proportional(x, y)
            labels.append(f"slope {line.slope:.2f} ± {line.stderr:.2f}")
            labels.append(f"scatter {line.scatter:.2g}")
            misfit = part_of_model.chi2_at_reference.values
            if model and np.isfinite(misfit).all():
                expected = float(part_of_model.chi2_expected.sum())
                labels.append(f"χ² {misfit.sum():.0f} of {expected:.0f}")
        marker = MODEL_MARKERS[number % len(MODEL_MARKERS)]
        axes.plot(shifted, y, marker, color=colour, ms=3, label="\n".join(labels) or None)
        highest = max(highest, float(highest_value.max()))
    top = 1.08 * highest
    axes.plot([0.0, top], [0.0, top], color="black", lw=0.6)
    axes.set_title(escape_mathtext(prefix.strip()) or "against reference values")
    label = format_parameter(name)
    axes.set(xlabel=f"{label}, reference", ylabel=f"{label}, retrieved")
    axes.set(xlim=(0.0, top), ylim=(0.0, top))
    axes.set_aspect("equal", anchor="W")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    if any(not str(handle.get_label()).startswith("_") for handle in axes.get_lines()):
        axes.legend(
            frameon=False, fontsize=SMALL_FONT_PT, loc="upper left", bbox_to_anchor=(1.0, 1.0)
        )
    return axes


def select_referenced_samples(
    dataset: xr.Dataset, reference: Mapping[str, float], prefix: str
) -> list[str]:
    """Return the samples with a prefix that have reference values."""
    return [s for s in reference if s in dataset.sample.values and s.startswith(prefix)]


def get_model_colours(dataset: xr.Dataset) -> list[tuple[str, Any]]:
    """Return the names of the models, with their colours."""
    names = list(map(str, dataset.model.values))
    colours = pick_colours(len(names), "medium" if len(names) > 1 else None)
    return list(zip(names, colours, strict=True))


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
    delay = 1e9 * part.delay_s.values
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
        draw_curve(top, delay, fitted, error, alpha=0.25, color=colour, lw=1.0, ls="--")
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
    return top
