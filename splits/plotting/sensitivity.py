"""Figures of sensitivity: mean sensitivity indices, band selection and Sobol indices."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from splits.core.escaping import escape_mathtext
from splits.plotting.annotations import annotate_figure
from splits.plotting.style import (
    BAND_SIGMA,
    ONE_COLUMN_INCHES,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    format_parameter,
    make_subplots,
    pick_colours,
    start_at_zero,
    use_style,
)


def draw_sensitivity_bars(dataset: xr.Dataset, note: str = "") -> Figure:
    """Draw the mean sensitivity index of each parameter, with published values if available.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variables ``msi``, ``msi_stderr`` and optionally ``published`` over ``quantity`` and
        ``parameter``.
    note : str
        Note for the foot, such as `splits.experiments.papers.sensitivity_table.describe_ranges`.
    """
    with use_style():
        figure, axes = make_subplots(height=2.5)
        x = np.arange(dataset.sizes["parameter"])
        width = 0.36
        for i, quantity in enumerate(dataset.quantity.values):
            part = dataset.sel(quantity=quantity)
            positions = x + (i - 0.5) * width
            colour = pick_colours(2, "sample")[i]
            axes.bar(positions, part.msi, width, color=colour, alpha=0.85, label=str(quantity))
            axes.errorbar(
                positions,
                part.msi,
                BAND_SIGMA * part.msi_stderr,
                fmt="none",
                ecolor="black",
                elinewidth=0.8,
            )
            if "published" in part:
                axes.plot(
                    positions,
                    part.published,
                    "D",
                    color="white",
                    mec="black",
                    mew=0.7,
                    ms=4,
                    ls="none",
                    label="published" if i == 0 else None,
                )
        names = [str(p).replace("_", " ") for p in dataset.parameter.values]
        axes.set_xticks(x, list(map(escape_mathtext, names)))
        axes.set_ylabel("mean sensitivity index")
        axes.set_ylim(0, 1.05)
        axes.spines[["top", "right"]].set_visible(False)
        figure.legend(
            *axes.get_legend_handles_labels(), frameon=False, ncols=3, loc="outside upper center"
        )
        errors = f"Error bars: {BAND_SIGMA:g} standard errors."
        return annotate_figure(figure, [axes], " ".join([escape_mathtext(note), errors]).strip())


_BANDS_HEIGHT_INCHES = 4.2


def draw_band_selection(selections: Mapping[str, xr.Dataset], conditions: str = "") -> Figure:
    """Draw information and relative spread by the number of bands, a column per table.

    Parameters
    ----------
    selections : mapping
        Outputs of `splits.experiments.studies.information.select_bands` by the title of their
        column.
    conditions : str
        Noise and fixed values, for the foot.
    """
    with use_style():
        figure, panels = make_subplots(
            2,
            len(selections),
            width=TWO_COLUMNS_INCHES if len(selections) > 1 else ONE_COLUMN_INCHES,
            height=_BANDS_HEIGHT_INCHES,
            sharex="col",
            squeeze=False,
        )
        for column, (title, dataset) in enumerate(selections.items()):
            top, bottom = panels[:, column]
            x, information = dataset.step.values, dataset.information_bits.values
            (blue,) = pick_colours(1)
            top.bar(x, information, color=blue, alpha=0.5)
            top.errorbar(
                x,
                information,
                BAND_SIGMA * dataset.information_bits_stderr.values,
                fmt="none",
                color="black",
                lw=0.8,
            )
            top.set_title(escape_mathtext(title))
            names = list(map(str, dataset.parameter.values))
            for name, colour in zip(names, pick_colours(len(names), "medium"), strict=True):
                relative_spread = dataset.spread.sel(parameter=name).values
                bottom.plot(
                    x,
                    relative_spread,
                    "o-",
                    color=colour,
                    ms=3,
                    lw=1.0,
                    label=format_parameter(name),
                )
            bottom.set_ylim(0.0, 1.05)
            bands = [f"+ {escape_mathtext(str(band))}" for band in dataset.band.values]
            bottom.set_xticks(x, bands, rotation=45)
            for label in bottom.get_xticklabels():
                label.set_horizontalalignment("right")
            bottom.legend(frameon=False, fontsize=SMALL_FONT_PT)
            for axes in (top, bottom):
                axes.spines[["top", "right"]].set_visible(False)
        panels[0, 0].set_ylabel("information (bits)")
        panels[1, 0].set_ylabel("posterior / prior\nstandard deviation")
        note = (
            "Bands from left to right, each adding most information to those before it, as a mean "
            "over the ranges of the table. Error bars: two standard errors of that mean."
        )
        note += f" {escape_mathtext(conditions.replace('_', ' '))}." if conditions else ""
        return annotate_figure(figure, panels[0], note)


_SOBOL_HEIGHT_INCHES = 3.4


def draw_sobol_indices(indices: Mapping[str, xr.Dataset]) -> Figure:
    """Draw first-order and total Sobol indices and the standard deviation, a column per table.

    Parameters
    ----------
    indices : mapping
        Outputs of `splits.experiments.studies.information.compute_sobol_indices` by the title
        of their column.
    """
    with use_style():
        figure, panels = make_subplots(
            2,
            len(indices),
            width=TWO_COLUMNS_INCHES if len(indices) > 1 else ONE_COLUMN_INCHES,
            height=_SOBOL_HEIGHT_INCHES,
            sharex="col",
            squeeze=False,
            gridspec_kw={"height_ratios": [2.4, 1.0]},
        )
        for column, (title, dataset) in enumerate(indices.items()):
            top, bottom = panels[:, column]
            x = dataset.wavelength.values
            names = list(map(str, dataset.parameter.values))
            for name, colour in zip(names, pick_colours(len(names), "medium"), strict=True):
                part = dataset.sel(parameter=name)
                for key, dash in (("first_order", "-"), ("total", "--")):
                    value, error = part[key].values, BAND_SIGMA * part[f"{key}_stderr"].values
                    label = format_parameter(name) if dash == "-" else None
                    top.plot(x, value, color=colour, ls=dash, lw=1.1, label=label)
                    low, high = value - error, value + error
                    top.fill_between(x, low, high, color=colour, alpha=0.25, lw=0)
            bottom.plot(x, dataset.standard_deviation.values, color="black", lw=1.0)
            top.set_title(escape_mathtext(title))
            top.set_ylim(-0.03, 1.19)
            top.set_yticks(np.linspace(0.0, 1.0, 6))
            top.legend(frameon=False, fontsize=SMALL_FONT_PT, ncols=2, loc="upper center")
            start_at_zero(bottom)
            bottom.set_xlabel("wavelength (nm)")
            for axes in (top, bottom):
                axes.spines[["top", "right"]].set_visible(False)
        panels[0, 0].set_ylabel("fraction of the variance")
        panels[1, 0].set_ylabel("standard deviation\nof reflectance")
        note = (
            "Solid: a parameter alone (first-order Sobol index). Dashed: with its interactions "
            "with others (total index). Bands: two standard errors of sampling."
        )
        return annotate_figure(figure, panels[0], note)
