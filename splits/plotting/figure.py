"""Figure of a dataset according to the figure section of an experiment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from splits.core.validation import check_choice, invalid, unknown_key
from splits.plotting.annotations import add_notes
from splits.plotting.beam_spread import draw_beam_spread
from splits.plotting.colour import draw_swatches
from splits.plotting.direction_axes import QUANTITY_LABELS
from splits.plotting.hemispheres import draw_hemispheres
from splits.plotting.lobes import draw_lobes
from splits.plotting.points import draw_points, draw_summary
from splits.plotting.polarization import draw_polarization
from splits.plotting.principal_plane import draw_bin_sizes, draw_principal_planes
from splits.plotting.rough_surface import draw_lens, draw_surface
from splits.plotting.sand_fit import draw_fits
from splits.plotting.season import draw_season
from splits.plotting.spectra import draw_refractive_indices, draw_spectra
from splits.plotting.style import use_style
from splits.plotting.time_of_flight import draw_range_bias, draw_returns

SINGLE_POINT_FUNCTIONS = {
    "lobes": draw_lobes,
    "bins": draw_bin_sizes,
    "spread": draw_beam_spread,
    "surface": draw_surface,
    "lens": draw_lens,
}
"""Functions that draw the kinds of figures of a single point of a grid."""
QUANTITY_KINDS = ("spectra", "points", "summary")
"""Kinds of figures of any quantities of the dataset."""
KINDS = (
    *QUANTITY_KINDS, *SINGLE_POINT_FUNCTIONS, "refractive_index", "fit", "return", "range_bias",
    "season", "swatches", "hemisphere", "principal_plane", "polarization",
)  # fmt: skip
DEFAULTS: dict[str, Any] = {
    "kind": "spectra", "quantity": ("reflectance",), "select": {}, "wavelength_nm": None,
    "legend": None, "ylim": None, "note": None,
}  # fmt: skip
"""Settings that are left out."""


def draw(
    dataset: xr.Dataset, section: Mapping[str, Any], measured: pd.DataFrame | None = None
) -> Figure:
    """Draw a dataset according to the figure section of an experiment.

    Parameters
    ----------
    dataset : xarray.Dataset
    section : mapping
        See `splits.experiments.config.figure.FigureSection`; by default spectra of reflectance.
    measured : pandas.DataFrame, optional
        Measured values to show together with spectra.

    Raises
    ------
    ValueError
        For a section that draws nothing, or more than a figure can show.
    """
    if not isinstance(dataset, xr.Dataset):
        raise invalid("dataset", type(dataset).__name__, "an xarray.Dataset")
    if not isinstance(section, Mapping):
        raise invalid("figure", section, "a mapping of settings")
    for key in section:
        if key not in (*DEFAULTS, "measured"):
            raise unknown_key(f"figure.{key}", [*DEFAULTS])
    section = {**DEFAULTS, **{key: value for key, value in section.items() if value is not None}}
    if isinstance(section["quantity"], str):
        section["quantity"] = (section["quantity"],)
    check_choice("figure.kind", section["kind"], KINDS)
    if section["kind"] in QUANTITY_KINDS:
        names = [str(name) for name in dataset.data_vars]
        for name in section["quantity"]:
            check_choice("figure.quantity", name, names)
    figure = _draw_kind(dataset, section, measured)
    with use_style():
        add_notes(figure, section.get("note") or "")
    return figure


def _draw_kind(
    dataset: xr.Dataset, section: Mapping[str, Any], measured: pd.DataFrame | None
) -> Figure:
    """Draw a dataset; see `draw`."""
    if section["kind"] == "refractive_index":
        return draw_refractive_indices(dataset)
    if section["kind"] == "points":
        return draw_points(dataset, section["quantity"], section["select"], section["legend"])
    if section["kind"] == "summary":
        return draw_summary(dataset, section["quantity"], section["select"], section["legend"])
    if section["kind"] == "fit":
        return draw_fits(dataset, section["select"], section["legend"])
    if section["kind"] == "return":
        return draw_returns(dataset, section["select"], section["legend"])
    if section["kind"] == "range_bias":
        return draw_range_bias(dataset, section["select"], section["legend"])
    if section["kind"] == "season":
        return draw_season(dataset, section["quantity"])
    if section["kind"] == "swatches":
        return draw_swatches(dataset, section["select"])
    quantity = [name for name in section["quantity"] if name in QUANTITY_LABELS] or ["brdf"]
    if section["kind"] == "hemisphere":
        return draw_hemispheres(dataset, quantity, section["select"], section["legend"])
    if section["kind"] == "principal_plane":
        return draw_principal_planes(
            dataset, quantity, section["select"], section["legend"], section["ylim"]
        )
    if section["kind"] == "polarization":
        return draw_polarization(dataset, section["select"], section["legend"])
    if section["kind"] in SINGLE_POINT_FUNCTIONS:
        return SINGLE_POINT_FUNCTIONS[section["kind"]](dataset, section["select"])
    return draw_spectra(
        dataset,
        section["quantity"],
        section["wavelength_nm"],
        section["select"],
        measured,
        section["legend"],
        section["ylim"],
    )
