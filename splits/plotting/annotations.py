"""The line of a figure that says under which conditions its values hold.

What stands around the panels of a figure: their letters, and notes at the foot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from splits.plotting.style import BAND_SIGMA, SMALL_FONT_PT, format_parameter, format_value

Attributes = Mapping[str, Any]


def _make_formatter(label: str, unit: str = "") -> Callable[[Any], str]:
    """Return how a value is said: the words before it and the unit behind."""

    def said(value: Any) -> str:
        values = np.atleast_1d(value)
        if values.dtype.kind in "if":
            text = "–".join(format_value(float(f"{x:.4g}")) for x in values)
        else:
            text = format_value(str(value))
        return f"{label} {text} {'' if text == '∞' else unit}".strip()

    return said


def _format_saturation(value: Any) -> str:
    return "dry" if str(value) in ("0", "0.0") else _make_formatter("water saturation")(value)


def _format_ground(value: Any) -> str:
    return "" if str(value) in ("open", "none") else _make_formatter("ground:")(value)


_COMMON_FORMATTERS: dict[str, Callable[[Any], str]] = {
    "depth_m": _make_formatter("depth", "m"),
    "ground": _format_ground,
}
_GRAIN_FORMATTERS = {
    "density_kg_m3": _make_formatter("density", "kg m⁻³"),
    "saturation": _format_saturation,
}
FORMATTERS: dict[str, dict[str, Callable[[Any], str]]] = {
    "snow": {
        "grain_size_um": _make_formatter("grains", "µm"),
        **_GRAIN_FORMATTERS,
        **_COMMON_FORMATTERS,
    },
    "natural_snow": {
        "specific_surface_area_m2_kg": _make_formatter("surface area", "m²/kg"),
        **_GRAIN_FORMATTERS,
        **_COMMON_FORMATTERS,
    },
    "sand": {
        "porosity": _make_formatter("porosity"),
        "saturation": _format_saturation,
        **_COMMON_FORMATTERS,
    },
    "particle_layer": {
        "refractive_index": _make_formatter("index"),
        "optical_thickness": _make_formatter("optical thickness"),
        "single_scattering_albedo": _make_formatter("single-scattering albedo"),
        "bottom_albedo": lambda value: (
            "" if str(value) in ("none", "None") else _make_formatter("bottom albedo")(value)
        ),
        "surface_rms_slope": lambda value: (
            "slopes without finite rms"
            if str(value) == "inf"
            else _make_formatter("rms slope")(value)
        ),
    },
    "stack": {**_COMMON_FORMATTERS},
}
"""What figures say of a medium, by its kind, and how."""
_INTERIOR_KEYS = ("optical_thickness", "single_scattering_albedo", "bottom_albedo")
"""What counts for nothing where nothing comes back from below a layer's surface."""
_SURFACE_INSTRUMENTS = ("surface_map", "lens")
"""Instruments that look at a rough surface alone."""


def describe_conditions(
    dataset: xr.Dataset, at: Mapping[str, float | str] | None = None, band: str = "bands"
) -> str:
    """Return what is held fixed and matters, and the error reached, in one line.

    Parameters
    ----------
    dataset : xarray.Dataset
        What is shown, with the attributes of an instrument or an experiment.
    at : mapping, optional
        Labels of the grid at which the dataset was cut.
    band : str
        What shows the errors; "" for nothing.

    Returns
    -------
    str
        Items stay together where the line is broken.  Empty for a dataset without attributes.
    """
    items = [
        *_describe_medium(dataset.attrs, dict(at or {})),
        _describe_light(dataset, dict(at or {})),
    ]
    if dataset.sizes.get("wavelength") == 1:
        items.append(f"{float(dataset.wavelength.values[0]):g} nm")
    items.append(_describe_error(dataset, band))
    told = ", ".join(item.replace(" ", "\u00a0").replace(";\u00a0", "; ") for item in items if item)
    told = told if dataset.attrs.get("medium") else ""
    return told[:1].upper() + told[1:]


def _describe_medium(attributes: Attributes, at: dict[str, Any]) -> list[str]:
    """Return what is said of the medium, and of the labels held fixed."""
    kind = str(attributes.get("medium", ""))
    if kind not in FORMATTERS:
        return []
    own = {
        key: attributes[f"{kind}_{key}"]
        for key in FORMATTERS[kind]
        if f"{kind}_{key}" in attributes
    } | at
    opaque = attributes.get(f"{kind}_opaque") == "true"
    alone = opaque or attributes.get("instrument") in _SURFACE_INSTRUMENTS
    items = [kind.replace("_", " ")]
    for key, said in FORMATTERS[kind].items():
        if key in own and not (alone and key in _INTERIOR_KEYS):
            items.append(said(own.pop(key)))
    if opaque:
        items.append("nothing below the surface")
    own = {key: value for key, value in own.items() if key in at and key != "incidence_deg"}
    items += [f"{format_parameter(key)}: {format_value(v, key)}" for key, v in own.items()]
    return items


def _describe_light(dataset: xr.Dataset, at: Mapping[str, Any]) -> str:
    given = at.get("incidence_deg", dataset.attrs.get("incidence_deg"))
    if given is None:
        return ""
    if str(given) == "diffuse":
        return "diffuse light"
    return f"incidence {format_value(given)}" + ("" if isinstance(given, str) else "°")


def _describe_error(dataset: xr.Dataset, band: str) -> str:
    """Return what the bands are, and how large an error is reached."""
    for key, words in (
        ("max_stderr_reached", "standard error"),
        ("relative_stderr_reached", "relative standard error"),
    ):
        reached = dataset[key].max() if key in dataset else dataset.attrs.get(key)
        if reached is not None:
            text = f"{words} ≤ {float(f'{float(reached):.1g}'):g}"
            return f"{band}: {BAND_SIGMA:g} standard errors; {text}" if band else text
    return f"{band}: {BAND_SIGMA:g} standard errors" if band else ""


_MARGIN_INCHES = 0.05
_LINE_SPACING = 1.25
"""Line spacing of notes."""
NOTES_GID = "foot"
"""What the notes' text is called in a figure."""


def annotate_figure(figure: Figure, panels: Iterable[Axes], *notes: str) -> Figure:
    """Letter the panels of a figure that has several, and write notes at its foot.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout; it grows by the height of the notes.
    panels : iterable of matplotlib.axes.ParameterGrid
        In reading order; the letter stands before a panel's title.
    *notes : str
        A paragraph each, broken at spaces; empty ones are left out.

    Returns
    -------
    matplotlib.figure.Figure
        The figure given.
    """
    shown = [axes for axes in panels if axes.get_visible()]
    for number, axes in enumerate(shown if len(shown) > 1 else ()):
        title = axes.get_title()
        axes.set_title("")
        axes.set_title(f"({format_panel_letter(number)}) {title}".rstrip(), loc="left")
    add_notes(figure, *notes)
    return figure


def format_panel_letter(number: int) -> str:
    """Return the letter of a panel counted from 0: a to z, then aa, ab and so on."""
    rounds, rest = divmod(number, 26)
    return (format_panel_letter(rounds - 1) if rounds else "") + chr(ord("a") + rest)


def add_notes(figure: Figure, *notes: str) -> None:
    """Write notes below all else and below earlier ones; the figure grows by their height."""
    inches, dpi = figure.get_figwidth(), figure.dpi
    if not any(notes):
        return
    text = next((one for one in figure.texts if one.get_gid() == NOTES_GID), None)
    height, earlier = figure.get_figheight(), ""
    if text is None:
        text = figure.text(
            _MARGIN_INCHES / inches, 0.0, "", va="bottom", ha="left", fontsize=SMALL_FONT_PT,
            color="0.3", linespacing=_LINE_SPACING, gid=NOTES_GID,
        )  # fmt: skip
        # The layout would make room for it inside of the axes.
        text.set_in_layout(False)
    else:
        earlier = text.get_text() + "\n"
        height -= text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    widest = (inches - 2.0 * _MARGIN_INCHES) * dpi
    lines = [line for note in notes if note for line in _wrap_note(text, note, widest)]
    text.set_text(earlier + "\n".join(lines))
    grown = text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    figure.set_figheight(height + grown)
    share = grown / (height + grown)
    text.set_y(_MARGIN_INCHES / (height + grown))
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0.0, share, 1.0, 1.0 - share))  # type: ignore[call-arg]


def _wrap_note(text: Text, note: str, max_width_px: float) -> list[str]:
    """Return the lines of a note that are no wider than so many pixels."""
    lines = [""]
    for word in note.split(" "):
        longer = f"{lines[-1]} {word}".strip(" ")
        text.set_text(longer)
        if lines[-1] and text.get_window_extent().width > max_width_px:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
