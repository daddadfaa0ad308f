"""Figures: a dataset in, a matplotlib figure out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from splits.checks import refuse
from splits.figures.bars import sensitivity_bars
from splits.figures.conditions import conditions
from splits.figures.directions import collectors, principal_planes
from splits.figures.fits import fits
from splits.figures.hemispheres import hemispheres
from splits.figures.lobes import lobes
from splits.figures.measured import measured_albedo
from splits.figures.notes import add_notes
from splits.figures.planes import NAMES
from splits.figures.points import points
from splits.figures.polarization import polarization
from splits.figures.readings import readings_shifts
from splits.figures.spectra import refractive_indices, spectra
from splits.figures.spread import spread
from splits.figures.style import save_figure, style
from splits.figures.summary import summary
from splits.figures.surface_area import area_law, fitted_spectra
from splits.figures.swatches import swatches
from splits.figures.waves import lens, surface

__all__ = [
    "area_law",
    "collectors",
    "conditions",
    "draw",
    "fits",
    "fitted_spectra",
    "hemispheres",
    "lens",
    "lobes",
    "measured_albedo",
    "points",
    "polarization",
    "principal_planes",
    "readings_shifts",
    "refractive_indices",
    "save_figure",
    "sensitivity_bars",
    "spectra",
    "spread",
    "summary",
    "surface",
    "swatches",
]


OF_DATASET = {
    "lobes": lobes, "cells": collectors, "spread": spread, "surface": surface, "lens": lens,
}  # fmt: skip
"""Kinds of figures that only need to know which point of a grid to show."""


def draw(
    dataset: xr.Dataset, section: Mapping[str, Any], measured: pd.DataFrame | None = None
) -> Figure:
    """Draw a dataset as an experiment's figure section says.

    Parameters
    ----------
    dataset : xarray.Dataset
    section : mapping
        See `splits.experiments.model.FigureSection`.
    measured : pandas.DataFrame, optional
        Measured values to show with spectra.

    Raises
    ------
    ValueError
        For a section that draws nothing, or more than can be shown.
    """
    if section["kind"] == "none":
        raise refuse("figure.kind", "none", "a kind of figure")
    figure = _drawn(dataset, section, measured)
    with style():
        add_notes(figure, section.get("note") or "")
    return figure


def _drawn(
    dataset: xr.Dataset, section: Mapping[str, Any], measured: pd.DataFrame | None
) -> Figure:
    """Draw a dataset; see `draw`."""
    if section["kind"] == "refractive_index":
        return refractive_indices(dataset)
    if section["kind"] == "points":
        return points(dataset, section["quantity"], section["at"], section["legend"])
    if section["kind"] == "summary":
        return summary(dataset, section["quantity"], section["at"], section["legend"])
    if section["kind"] == "fit":
        return fits(dataset, section["at"], section["legend"])
    if section["kind"] == "swatches":
        return swatches(dataset, section["at"])
    quantity = [name for name in section["quantity"] if name in NAMES] or ["brdf"]
    if section["kind"] == "hemisphere":
        return hemispheres(dataset, quantity, section["at"], section["legend"])
    if section["kind"] == "principal_plane":
        return principal_planes(
            dataset, quantity, section["at"], section["legend"], section["ylim"]
        )
    if section["kind"] == "polarization":
        return polarization(dataset, section["at"], section["legend"])
    if section["kind"] in OF_DATASET:
        return OF_DATASET[section["kind"]](dataset, section["at"])
    return spectra(
        dataset,
        section["quantity"],
        section["wavelength_nm"],
        section["at"],
        measured,
        section["legend"],
        section["ylim"],
    )
