"""Registry of the kinds of figures, and the figure of any dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity, list_inputs
from splits.core.inputs import check_dataset
from splits.core.keywords import declare_function
from splits.core.validation import check_choice, invalid, join_names, unknown_key
from splits.plotting.directions import draw_hemispheres, draw_lobes
from splits.plotting.grammar import Figure, add_notes
from splits.plotting.points import draw_points, draw_summary, draw_swatches
from splits.plotting.principal_plane import draw_bin_sizes, draw_polarization, draw_principal_planes
from splits.plotting.retrieval import draw_retrieval_map, draw_retrievals
from splits.plotting.settings import Note, can_map_hemisphere
from splits.plotting.space_and_time import (
    draw_beam_spread,
    draw_lens,
    draw_range_bias,
    draw_returns,
    draw_surface,
    find_bias_axis,
)
from splits.plotting.spectra import (
    draw_refractive_indices,
    draw_season,
    draw_spectra,
    list_spectral_quantities,
)


class FigureType(NamedTuple):
    """A kind of figure.

    Attributes
    ----------
    draw : callable
        Function that draws it; its declared inputs are the settings of the kind.
    instruments : tuple of str
        Instruments whose experiments may have it, by default the first one of each instrument.
    needs : tuple of str
        Variables and coordinates that a dataset must have for it.
    fits : callable
        Whether a dataset that has these fits.
    """

    draw: Callable[..., Figure]
    instruments: tuple[str, ...]
    needs: tuple[str, ...]
    fits: Callable[[xr.Dataset], object] = lambda dataset: True


def _covers_hemisphere(dataset: xr.Dataset) -> bool:
    return can_map_hemisphere(dataset.polar_deg.values, dataset.azimuth_deg.values)


def _has_spectra(dataset: xr.Dataset) -> bool:
    names = list_spectral_quantities(dataset)
    return any("polar_deg" not in dataset[name].dims for name in names)


_SPECTRAL, _DIRECTIONAL = ("spectrophotometer",), ("goniophotometer",)
_PULSED, _ANGLES = ("time_of_flight", "return_table"), ("polar_deg", "azimuth_deg")
FIGURES = {
    "retrieval": FigureType(draw_retrievals, (), ("averaging_kernel", "draws", "fitted")),
    "retrieval_map": FigureType(
        draw_retrieval_map, (), ("chi2", "quality_flag"), lambda data: "expected" in data.chi2.attrs
    ),
    "refractive_index": FigureType(
        draw_refractive_indices, ("refractive_index",), ("n", "k", "material")
    ),
    "principal_plane": FigureType(
        draw_principal_planes, _DIRECTIONAL, ("brdf",),
        lambda data: "angle" in data or {0.0, 180.0} <= {*data.azimuth_deg.values.round(6)},
    ),
    "hemisphere": FigureType(
        draw_hemispheres, _DIRECTIONAL, ("brdf", *_ANGLES), _covers_hemisphere
    ),
    "lobes": FigureType(draw_lobes, _DIRECTIONAL, ("brdf", *_ANGLES), _covers_hemisphere),
    "bins": FigureType(
        draw_bin_sizes, _DIRECTIONAL, ("brdf", *_ANGLES),
        lambda data: data.attrs.get("estimator") == "bins",
    ),
    "polarization": FigureType(
        draw_polarization, _DIRECTIONAL, ("brdf",), lambda data: "brdf_dolp" in data
    ),
    "spread": FigureType(draw_beam_spread, ("beam_spread",), ("profile", "profile_map")),
    "return": FigureType(draw_returns, _PULSED, ("return_rate", "delay_bounds")),
    "range_bias": FigureType(draw_range_bias, _PULSED, ("mean_delay",), find_bias_axis),
    "surface": FigureType(draw_surface, ("surface_map",), ("height", "rms_slope")),
    "lens": FigureType(draw_lens, ("lens",), ("screen_depth", "concentration")),
    "spectra": FigureType(
        draw_spectra, _SPECTRAL, ("wavelength",),
        lambda data: data.sizes.get("wavelength", 0) > 1 and _has_spectra(data),
    ),
    "points": FigureType(draw_points, _SPECTRAL, ("wavelength",), _has_spectra),
    "swatches": FigureType(
        draw_swatches, _SPECTRAL, ("reflectance", "wavelength"),
        lambda data: data.reflectance.ndim in (2, 3) and np.ptp(data.wavelength.values) >= 380.0,
    ),
    "summary": FigureType(draw_summary, ("table",), ("wavelength",), list_spectral_quantities),
    "season": FigureType(
        draw_season, (*_SPECTRAL, "albedo"), ("quality_flag",),
        lambda data: "band_albedo" in data or list_spectral_quantities(data),
    ),
}  # fmt: skip
"""Kinds of figures by name."""
FigureKind = Annotated[
    str | None,
    Quantity(
        "kind of the figure, see the instruments above; by default the first one of the "
        "instrument, or `points` for a grid at one wavelength; `none` for no figure",
        check=lambda _, value: value,
        schema={
            "type": "string",
            "enum": [*(kind for kind, one in FIGURES.items() if one.instruments), "none"],
        },
    ),
]
Drawable = Annotated[
    Any,
    Quantity(
        "dataset, or result of a retrieval",
        check=lambda key, value: check_dataset(key, getattr(value, "dataset", value)),
    ),
]


def list_instrument_figures(instrument: str) -> list[str]:
    """Return the kinds of figures of an instrument, the default first."""
    return [kind for kind, one in FIGURES.items() if instrument in one.instruments]


def list_figures(dataset: xr.Dataset) -> list[str]:
    """Return the kinds of figures that fit a dataset, the default first."""
    own = list_instrument_figures(str(dataset.attrs.get("instrument")))
    names = dataset.variables.keys()
    kinds = [k for k, one in FIGURES.items() if {*one.needs} <= names and one.fits(dataset)]
    return sorted(kinds, key=lambda kind: (kind != "season", kind not in own))


@declare_function
def draw(
    dataset: Drawable, kind: FigureKind = None, *, note: Note = None, **settings: Any
) -> Figure:
    """Draw a dataset.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of an instrument, of an experiment, or of a retrieval.
    kind : str, optional
        Kind of the figure, by default the first one that fits the dataset.
    note : str, optional
        A sentence below the figure; may contain formulas between dollar signs.
    **settings
        Settings of the kind, such as ``quantity`` and ``select``: the keys of the section `figure`
        of experiments, see docs/reference/configuration.md.  ``measured`` is a table of measured
        values (`pandas.DataFrame`) to show together with spectra.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For a kind that does not fit the dataset, for settings that the kind does not have, or for
        more than a figure can show.
    """
    # What a kind needs besides variables, it explains itself.
    if kind not in FIGURES or not {*FIGURES[kind].needs} <= dataset.variables.keys():
        kinds = list_figures(dataset)
        if not kinds:
            names = join_names(map(str, dataset.variables))
            raise invalid("dataset", f"with {names}", "one that a kind of figure shows")
        kind = kinds[0] if kind is None else check_choice("kind", kind, kinds)
    # An empty selection selects nothing.
    given = {
        k: one for k, one in settings.items() if one is not None and (k, one) != ("select", {})
    }
    check_settings(kind, given)
    figure = FIGURES[kind].draw(dataset, **given)
    add_notes(figure, note or "")
    return figure


def check_settings(kind: str, settings: Mapping[str, Any]) -> None:
    """Reject settings of a figure that its kind, or a figure left out, does not have."""
    for key, value in settings.items():
        owners = [name for name, one in FIGURES.items() if key in list_inputs(one.draw)]
        if not owners:
            known = {name for one in FIGURES.values() for name in list_inputs(one.draw)}
            raise unknown_key(key, sorted({"kind", "note"} | known))
        if kind not in owners:
            allowed, hint = f"left out for kind {kind}", f"it belongs to {', '.join(owners)}"
            raise invalid(key, value, allowed, hint)
