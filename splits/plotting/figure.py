"""Figure of a dataset according to the figure section of an experiment."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from splits.core.inputs import ResultDataset
from splits.core.keywords import declare_function
from splits.core.validation import check_choice, invalid, unknown_key
from splits.media.snow_pack_input import FLAG_NAME
from splits.plotting.directions import QUANTITY_LABELS, draw_hemispheres, draw_lobes
from splits.plotting.panels import FIGURE_SETTINGS, INSTRUMENT_FIGURES, check_settings
from splits.plotting.points import draw_points, draw_summary, draw_swatches
from splits.plotting.principal_plane import draw_bin_sizes, draw_polarization, draw_principal_planes
from splits.plotting.rough_surface import draw_lens, draw_surface
from splits.plotting.spectra import draw_refractive_indices, draw_season, draw_spectra
from splits.plotting.style import add_notes, use_style
from splits.plotting.time_of_flight import draw_beam_spread, draw_range_bias, draw_returns

FUNCTIONS: dict[str, Callable[..., Figure]] = {
    "spectra": draw_spectra,
    "points": draw_points,
    "summary": draw_summary,
    "hemisphere": draw_hemispheres,
    "principal_plane": draw_principal_planes,
    "polarization": draw_polarization,
    "lobes": draw_lobes,
    "bins": draw_bin_sizes,
    "spread": draw_beam_spread,
    "surface": draw_surface,
    "lens": draw_lens,
    "return": draw_returns,
    "range_bias": draw_range_bias,
    "refractive_index": draw_refractive_indices,
    "swatches": draw_swatches,
    "season": draw_season,
}
"""Functions that draw the kinds of figures; their arguments are `FIGURE_SETTINGS`."""
POINT_KINDS = ("lobes", "bins", "spread", "surface", "lens")
"""Kinds of figures of one point of a grid; for lobes, one parameter may vary."""
OTHER_SETTINGS = ("kind", "note", "measured")


@declare_function
@use_style()
def draw(
    dataset: ResultDataset,
    section: Mapping[str, Any] = MappingProxyType({}),
    measured: pd.DataFrame | None = None,
) -> Figure:
    """Draw a dataset according to the figure section of an experiment.

    Parameters
    ----------
    dataset : xarray.Dataset
    section : mapping, optional
        Settings: ``kind`` of the figure, by default the first one of the instrument, ``quantity``
        or several, and others of the kind, see docs/reference/configuration.md.
    measured : pandas.DataFrame, optional
        Measured values to show together with spectra.

    Raises
    ------
    ValueError
        For a section that draws nothing, or more than a figure can show.
    """
    if not isinstance(section, Mapping):
        raise invalid("figure", section, "a mapping of settings")
    known = {*OTHER_SETTINGS}.union(*FIGURE_SETTINGS.values())
    for key in section:
        if key not in known:
            raise unknown_key(f"figure.{key}", sorted(known))
    kinds = INSTRUMENT_FIGURES.get(str(dataset.attrs.get("instrument")), ("spectra",))
    default_kind = kinds[0] if kinds[0] != "season" else "spectra"
    kind = section.get("kind") or ("season" if FLAG_NAME in dataset else default_kind)
    check_choice("figure.kind", kind, FUNCTIONS)
    check_settings(kind, section)
    settings = {key: value for key, value in section.items() if value and key not in OTHER_SETTINGS}
    if isinstance(settings.get("quantity"), str):
        settings["quantity"] = (settings["quantity"],)
    of_directions = kind in ("hemisphere", "principal_plane")
    names = [str(name) for name in dataset if name in QUANTITY_LABELS or not of_directions]
    if kind == "spectra":
        names = [name for name in names if "wavelength" in dataset[name].dims]
        shown = next((name for name in names if f"{name}_stderr" in dataset), "reflectance")
        settings.setdefault("quantity", ("reflectance" if "reflectance" in names else shown,))
        if dataset.sizes.get("wavelength") == 1:
            hint = "kind='points' shows single wavelengths over a grid"
            raise invalid("wavelength", dataset.wavelength.values.tolist(), "at least two", hint)
    for name in settings.get("quantity", ()) if "band_albedo" not in names else ():
        check_choice("figure.quantity", name, names)
    if kind in POINT_KINDS:
        select = settings.get("select", {})
        grid = json.loads(dataset.attrs.get("configuration", "{}")).get("grid", {})
        free = [name for name in grid if name in dataset.dims and name not in select]
        if len(free) > (kind == "lobes"):
            allowed = f"with a value of {', '.join(free)} for a figure of kind {kind}"
            hint = "it shows one point of the grid; the dataset holds all"
            raise invalid("figure.select", dict(select), allowed, hint)
    if measured is not None:
        settings["measured"] = measured
    figure = FUNCTIONS[kind](dataset, **settings)
    add_notes(figure, section.get("note") or "")
    return figure
