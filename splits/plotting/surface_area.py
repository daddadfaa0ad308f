"""Figures of the surface area of snow: fitted spectra, and reflectance at 1310 nm."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from splits.core.escaping import escape_mathtext
from splits.plotting.annotations import annotate_figure
from splits.plotting.style import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    make_subplots,
    pick_colours,
    start_at_zero,
    use_style,
)

_LAW_DASHES = ("--", ":", "-.")
GALLET_2009_RANGE = (0.15, 0.50)
"""Reflectances at 1310 nm that Gallet et al. (2009) give for surface areas below 60 m²/kg."""


def draw_fitted_spectra(table: pd.DataFrame, note: str = "") -> Figure:
    """Draw measured and fitted spectra of snow, and their differences.

    Parameters
    ----------
    table : pandas.DataFrame
        See `splits.analysis.surface_area.make_overlay_table`.
    note : str
        Note for the foot, see `splits.plotting.annotations.describe_conditions`.
    """
    groups = list(table.groupby("spectrum", sort=False))
    with use_style():
        figure, panels = make_subplots(
            2, 1, height=4.0, sharex=True, gridspec_kw={"height_ratios": [2.2, 1]}
        )
        top, bottom = panels
        for (spectrum, rows), colour in zip(groups, pick_colours(len(groups)), strict=True):
            x = rows.wavelength_nm
            top.plot(x, rows.measured, ".", ms=2.5, color=colour)
            top.plot(x, rows.model, color=colour,
                     label=_format_spectrum_name(spectrum, rows.area.iloc[0]))  # fmt: skip
            low, high = rows.model - BAND_SIGMA * rows.stderr, rows.model + BAND_SIGMA * rows.stderr
            top.fill_between(x, low, high, color=colour, alpha=0.3, lw=0)
            bottom.plot(x, rows.difference.where(rows.fitted), color=colour)
            bottom.plot(x, rows.difference, color=colour, lw=0.6, ls=":")
        top.plot([], [], ".", ms=2.5, color="0.4", label="measured")
        start_at_zero(top, "reflectance")
        top.set_ylabel("reflectance")
        top.legend(frameon=False)
        bottom.axhline(0, color="black", lw=0.6)
        bottom.set_ylabel("model − measured")
        bottom.set_xlabel("wavelength (nm); dotted: not fitted")
        for axes in panels:
            axes.spines[["top", "right"]].set_visible(False)
        return annotate_figure(figure, panels, note)


def _format_spectrum_name(column: str, area: float) -> str:
    """Return the legend entry of a spectrum, such as ``ID2081@47.66``."""
    name, _, angle = column.partition("@")
    return f"{escape_mathtext(f'{name}, {angle}')}°: {area:.1f} m²/kg"


def draw_area_law(table: pd.DataFrame, note: str = "") -> Figure:
    """Draw modelled and published reflectance at 1310 nm against surface area.

    Parameters
    ----------
    table : pandas.DataFrame
        See `splits.analysis.surface_area.make_field_table`.
    note : str
        Note for the foot, see `splits.plotting.annotations.describe_conditions`.
    """
    ours = table[table.stderr.notna()]
    groups = list(ours.groupby("snow", sort=False))
    laws = list(table[table.stderr.isna()].groupby("snow", sort=False))
    with use_style():
        figure, axes = make_subplots(height=2.9)
        for (snow, rows), colour in zip(groups, pick_colours(len(groups)), strict=True):
            axes.errorbar(rows.area, rows.reflectance, BAND_SIGMA * rows.stderr, color=colour,
                          marker="o", ms=2.5, label=escape_mathtext(str(snow)))  # fmt: skip
        for (law, rows), dashes in zip(laws, _LAW_DASHES, strict=False):
            axes.plot(
                rows.area,
                rows.reflectance,
                ls=dashes,
                color="0.35",
                label=escape_mathtext(str(law)),
            )
        axes.axhspan(*GALLET_2009_RANGE, color="0.92", zorder=0,
                     label="below 60 m²/kg (Gallet et al. 2009)")  # fmt: skip
        axes.set_xlim(left=0)
        axes.set_ylim(0, 0.8)
        axes.set_xlabel("specific surface area (m²/kg)")
        axes.set_ylabel("reflectance at 1310 nm")
        axes.legend(frameon=False, loc="upper left", fontsize=SMALL_FONT_PT)
        axes.spines[["top", "right"]].set_visible(False)
        return annotate_figure(figure, [axes], note)
