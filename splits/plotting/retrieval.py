"""Figures of retrievals: fits, posterior, averaging kernel, reference values, and maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from splits.analysis.measured import fit_proportional
from splits.core.escaping import escape_mathtext
from splits.core.validation import invalid
from splits.io.netcdf import select_points
from splits.plotting.grammar import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    Axes,
    Figure,
    annotate_figure,
    declare_figure,
    describe_conditions,
    draw_band,
    draw_curve,
    format_parameter,
    format_value,
    make_figure,
    make_subplots,
    pick_colours,
    select_evenly,
    start_at_zero,
)
from splits.plotting.settings import Selection

if TYPE_CHECKING:
    from matplotlib.gridspec import SubplotSpec

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
SPECTRUM_NOTE = (
    "Bands: two standard errors, of the measurement (grey) and of the table (in colour). "
    "Dots: draws from the posterior"
)
RETURN_NOTE = (
    "Return: two standard errors of the measurement (bars) and of the table (bands); below, "
    "the difference from the fit in standard errors of the measurement. Dots: draws from the "
    "posterior; crosses and dotted lines: reference values"
)
"""Notes on the figures of retrievals from spectra and from returns."""


@declare_figure
def draw_retrievals(
    dataset: xr.Dataset,
    reference: Mapping[str, Mapping[str, float]] | None = None,
    prefixes: Sequence[str] = ("",),
) -> Figure:
    """Draw a row for some samples, and retrieved against reference values of all.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of `splits.retrieve` or `splits.retrieve_return`, or of
        `splits.experiments.run_retrieve.combine_samples`.
    reference : mapping, optional
        Independent values by parameter and sample.
    prefixes : sequence of str
        Prefixes of the names of samples that have a common panel of reference values.
    """
    state = ""
    if "sample" not in dataset.dims:
        state = describe_state(dataset)
        names = ("chi2", "chi2_expected", "degrees_of_freedom")
        single = {name: dataset.attrs[name] for name in names} | {"chi2_at_reference": np.nan}
        dataset = dataset.assign(single).expand_dims(model=[""], sample=[""])
    all_samples = dataset.sample.values
    is_return = "delay_s" in dataset.dims
    known = reference or {}
    # Corner plots of returns show reference values.
    reference = {
        name: values
        for name, values in ({} if is_return else known).items()
        if select_referenced_samples(dataset, values, "")
    }
    # Up to three rows: evenly selected samples, and reference values.
    samples = all_samples[select_evenly(len(all_samples), 3 - bool(reference))]
    heights = [3.3] * len(samples) + [2.4] * bool(reference)
    figure = make_figure(TWO_COLUMNS_INCHES, sum(heights))
    grid = figure.add_gridspec(len(heights), 3, width_ratios=[1.3, 1.6, 0.6], height_ratios=heights)
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
        reference_cells = grid[len(heights) - 1, :].subgridspec(1, max(2, len(panels)))
        has_slopes = any(
            len(select_referenced_samples(dataset, reference[name], prefix)) >= MIN_SLOPE_SAMPLES
            for name, prefix in panels
        )
        for column, (name, group) in enumerate(panels):
            axes = figure.add_subplot(reference_cells[column])
            title_axes.append(draw_against_reference(axes, dataset, name, reference[name], group))
    return annotate_figure(figure, title_axes, state, _make_note(dataset, len(samples), has_slopes))


def describe_state(dataset: xr.Dataset) -> str:
    """Return the medians of the retrieved parameters, with the other conditions, as one line."""
    medians = dataset.quantiles.sel(quantile=0.5).to_series()
    state: dict[str, Any] = {str(name): float(f"{value:.4g}") for name, value in medians.items()}
    state |= {
        key.removeprefix("fixed_"): value
        for key, value in dataset.attrs.items() if key.startswith("fixed_")
    }  # fmt: skip
    text = describe_conditions(dataset, state, "") or ", ".join(
        f"{format_parameter(name)}: {format_value(value, name)}" for name, value in state.items()
    )
    return f"Retrieved: {text[:1].lower()}{text[1:]}"


@declare_figure
def draw_retrieval_map(dataset: xr.Dataset, select: Selection = None) -> Figure:
    """Draw each retrieved parameter over the pixels of an image, and the misfit.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of `splits.retrieve_map` over one dimension, whose values are lines with bands of
        errors, or over two, whose values are maps.
    select : mapping, optional
        Values at which other dimensions are fixed.
    """
    dataset = select_points(dataset, select or {})
    dims = [str(d) for d in dataset.chi2.dims]
    if not 1 <= len(dims) <= 2:
        allowed = "with values of enough dimensions to leave one or two"
        raise invalid("select", dict(select or {}), f"{allowed} of {', '.join(dims)}")
    names = [*(str(name) for name in dataset if f"{name}_stderr" in dataset), "chi2"]
    is_map = len(dims) == 2
    figure, panels = make_subplots(
        -(-len(names) // 2), 2, width=TWO_COLUMNS_INCHES, height=0.3 + 2.3 * -(-len(names) // 2),
        squeeze=False,
    )  # fmt: skip
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    for axes, name in zip(panels.flat, names, strict=False):
        label = "χ²" if name == "chi2" else format_parameter(name)
        x, values = dataset[dims[-1]].values, dataset[name].values
        axes.set_xlabel(format_parameter(dims[-1]))
        if is_map:
            image = axes.pcolormesh(x, dataset[dims[0]].values, values, rasterized=True)
            figure.colorbar(image, ax=axes, label=label)
            axes.set_ylabel(format_parameter(dims[0]))
        else:
            error = dataset[f"{name}_stderr"].values if name != "chi2" else np.zeros(x.size)
            draw_curve(axes, x, values, error, 0.0, color=pick_colours(1)[0])
            axes.set_ylabel(label)
            start_at_zero(axes)
    flags, known = dataset.quality_flag.values, dataset.quality_flag.attrs
    counts = {
        name: int(np.count_nonzero(flags & mask))
        for name, mask in zip(known["flag_meanings"].split(), known["flag_masks"], strict=True)
    }
    marked = [f"{name.replace('_', ' ')} {count}" for name, count in counts.items() if count]
    notes = (
        "" if is_map else "Bands: two standard errors",
        f"expected χ²: {float(dataset.chi2.attrs['expected']):.0f}",
        f"of {flags.size} pixels: {', '.join(marked)}" if marked else "",
    )
    return annotate_figure(figure, panels.flat, "; ".join(filter(None, notes)))


def _make_note(dataset: xr.Dataset, rows: int, several: bool) -> str:
    """Return the note at the foot of the figure."""
    note = RETURN_NOTE if "delay_s" in dataset.dims else SPECTRUM_NOTE
    if "medium" in dataset.attrs:
        note = note.replace("the table", "the model")
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
    gaps = np.flatnonzero(steps > 2.0 * (np.median(steps) if steps.size else 0.0)) + 1
    return [np.insert(row.astype(float), gaps, np.nan) for row in (x, *rows)]


def _draw_spectrum(figure: Figure, cell: SubplotSpec, part: xr.Dataset, title: str) -> Axes:
    """Draw measured and fitted reflectance and their difference; return the upper panel."""
    inner = cell.subgridspec(2, 1, height_ratios=[2.0, 1.0])
    top = figure.add_subplot(inner[0])
    bottom = figure.add_subplot(inner[1], sharex=top)
    highest = 0.0
    for number, (model, colour) in enumerate(get_model_colours(part)):
        part_of_model = part.sel(model=model)
        names = ("wavelength", "measured", "measured_stderr", "fitted", "fitted_stderr")
        x, measured, noise, fitted, error = _insert_gaps(
            *(part_of_model[name].values for name in names)
        )
        if number == 0:
            top.plot(x, measured, color="black", lw=1.0, label="measured")
            draw_band(top, x, measured, noise, color="0.8")
            draw_band(bottom, x, np.zeros_like(measured), noise, color="0.8")
        chi2 = float(part_of_model.chi2)
        unnamed = "model" if "medium" in part.attrs else "table"
        label = f"{format_value(model, 'model') if model else unnamed}, χ² {chi2:.0f}"
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
    from matplotlib.ticker import EngFormatter

    names = list(map(str, part.parameter.values))
    inner = cell.subgridspec(len(names), len(names), wspace=0.04, hspace=0.04)
    draws = part.draws.transpose("model", "draw", "parameter").values
    # Up to 400 draws are dots, for all models together.
    shown_draws = draws[:, :: max(1, len(draws) * draws.shape[1] // 400)]
    quantiles = part.quantiles.sel(quantile=[0.16, 0.5, 0.84])
    quantiles = quantiles.transpose("model", "quantile", "parameter").values
    colours = [colour for _, colour in get_model_colours(part)]
    # A law has no draws of parameters that it does not contain.
    low, high = np.nanquantile(draws, [0.002, 0.998], axis=(0, 1))
    pairs = [(row, column) for row in range(len(names)) for column in range(row + 1)]
    for i, j in pairs:
        axes = figure.add_subplot(inner[i, j])
        axes.set_xlim(low[j], high[j])
        axes.tick_params(labelsize=SMALL_FONT_PT, labelbottom=i == len(names) - 1)
        x, y = known.get(names[j]), known.get(names[i])
        if i == j:
            for number, colour in enumerate(colours):
                finite_draws = draws[number, np.isfinite(draws[number, :, i]), i]
                axes.hist(finite_draws, bins=30, color=colour, alpha=0.6)
            for quantile in quantiles[0, :, i] if len(colours) == 1 else ():
                axes.axvline(quantile, color="black", lw=0.6)
            axes.set_yticks([])
            axes.spines["left"].set_visible(False)
        else:
            for points, colour in zip(shown_draws, colours, strict=True):
                axes.plot(
                    points[:, j], points[:, i], ".", ms=1.0, color=colour, alpha=0.4,
                    rasterized=True,
                )  # fmt: skip
            axes.spines[:].set_visible(True)
            axes.locator_params(nbins=3, axis="y")
            axes.ticklabel_format(axis="y", style="plain")
            axes.tick_params(labelleft=j == 0)
            if j == 0:
                axes.set_ylabel(_get_short_label(names[i]), fontsize=SMALL_FONT_PT)
        # Known values, if they are inside the panel.
        if i != j and x is not None and y is not None:
            axes.plot([x], [y], "x", color=KNOWN_COLOUR, ms=5, mew=1.2)
        elif x is not None and low[j] <= x <= high[j]:
            axes.axvline(x, color=KNOWN_COLOUR, lw=1.2, ls=":")
        axes.locator_params(nbins=3, axis="x")
        for axis in (axes.xaxis, axes.yaxis):
            if max(axis.get_view_interval()) >= 1e4:
                axis.set_major_formatter(EngFormatter(sep=""))
        if i == len(names) - 1:
            axes.set_xlabel(_get_short_label(names[j]), fontsize=SMALL_FONT_PT)
            axes.tick_params(axis="x", labelrotation=45)


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
        size = SMALL_FONT_PT * min(1.0, 4.0 / len(names))
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


def draw_against_reference(
    axes: Axes, dataset: xr.Dataset, name: str, reference: Mapping[str, float], prefix: str
) -> Axes:
    """Draw retrieved values of a parameter against reference values, for all models."""
    from matplotlib.ticker import MaxNLocator

    samples = select_referenced_samples(dataset, reference, prefix)
    x = np.array([reference[s] for s in samples])
    top = highest = float(x.max())
    models = get_model_colours(dataset)
    for number, (model, colour) in enumerate(models):
        part_of_model = dataset.sel(model=model, sample=samples)
        # The points of models are beside each other.
        shifted = x + (number - 0.5 * (len(models) - 1)) * 0.012 * top
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
        axes.plot(
            shifted, y, "os^D"[number % 4], color=colour, ms=3, label="\n".join(labels) or None
        )
        highest = max(highest, float(highest_value.max()))
    top = 1.08 * highest
    axes.plot([0.0, top], [0.0, top], color="black", lw=0.6)
    axes.set_title(escape_mathtext(prefix.strip()) or "against reference values")
    label = format_parameter(name)
    axes.set(
        xlabel=f"{label}, reference", ylabel=f"{label}, retrieved", xlim=(0.0, top),
        ylim=(0.0, top),
    )  # fmt: skip
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


KNOWN_COLOUR = "crimson"
"""Colour of known values of parameters."""


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
        top.set_ylim(bottom=0.3 * lowest)
    limit = max(3.0, 1.1 * float(np.abs(bottom.dataLim.intervaly).max()))
    bottom.set_ylim(-limit, limit)
    bottom.axhspan(-BAND_SIGMA, BAND_SIGMA, color="0.85", lw=0, zorder=0)
    bottom.axhline(0.0, color="black", lw=0.6)
    bottom.set(xlabel="delay (ns)", ylabel="difference / error")
    top.tick_params(labelbottom=False)
    top.legend(frameon=False, fontsize=SMALL_FONT_PT, handlelength=1.2, borderaxespad=0.0)
    return top
