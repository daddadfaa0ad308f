"""Annotations of figures: conditions of the simulation, panel letters and notes at the foot."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from splits.core.incident_stokes import UNPOLARIZED_LIGHT, get_incident_stokes
from splits.media.formatting import count_digits
from splits.plotting.style import BAND_SIGMA, SMALL_FONT_PT, format_parameter, format_value

Attributes = Mapping[str, Any]


def _make_formatter(label: str, unit: str = "") -> Callable[[Any], str]:
    """Return a function that formats a value with a label and a unit."""

    def format_quantity(value: Any) -> str:
        values = np.atleast_1d(value)
        if values.dtype.kind in "if":
            text = "–".join(format_value(float(f"{x:.4g}")) for x in values)
        else:
            text = format_value(str(value))
        return f"{label} {text} {'' if text == '∞' else unit}".strip()

    return format_quantity


def _format_saturation(value: Any) -> str:
    return "dry" if str(value) in ("0", "0.0") else _make_formatter("water saturation")(value)


def _format_ground(value: Any) -> str:
    return "" if str(value) in ("open", "none") else _make_formatter("ground:")(value)


_COMMON_FORMATTERS: dict[str, Callable[[Any], str]] = {
    "depth_m": _make_formatter("depth", "m"),
    "ground": _format_ground,
}
FORMATTERS: dict[str, dict[str, Callable[[Any], str]]] = {
    "snow": {
        "specific_surface_area_m2_kg": _make_formatter("specific surface area", "m²/kg"),
        "optical_radius_um": _make_formatter("optical radius", "µm"),
        "grain_size_um": _make_formatter("grains", "µm"),
        "density_kg_m3": _make_formatter("density", "kg m⁻³"),
        "saturation": _format_saturation,
        "liquid_water_content": _make_formatter("liquid water content"),
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
"""Formatters of the keywords that figures show, by kind of medium."""
_EQUIVALENT_KEYS = (
    ("specific_surface_area_m2_kg", "optical_radius_um", "grain_size_um"),
    ("saturation", "liquid_water_content"),
)
"""Keywords that state the same quantity."""
_INTERIOR_KEYS = ("optical_thickness", "single_scattering_albedo", "bottom_albedo")
"""Keywords of a layer without effect below an opaque surface."""
_SURFACE_INSTRUMENTS = ("surface_map", "lens")
"""Instruments that measure a rough surface only."""


def describe_conditions(
    dataset: xr.Dataset, select: Mapping[str, float | str] | None = None, band: str = "bands"
) -> str:
    """Return the fixed conditions of a dataset and the error reached, as one line.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset shown, with the attributes of an instrument or an experiment.
    select : mapping, optional
        Labels of the grid at which the dataset was selected.
    band : str
        Name of the graphical element for errors; "" for none.

    Returns
    -------
    str
        Items contain no line breaks.  Empty for a dataset without attributes.
    """
    items = [
        *_describe_medium(dataset.attrs, dict(select or {})),
        _describe_light(dataset, dict(select or {})),
    ]
    if dataset.sizes.get("wavelength") == 1:
        items.append(f"{float(dataset.wavelength.values[0]):g} nm")
    items.append(_describe_error(dataset, band))
    text = ", ".join(item.replace(" ", "\u00a0").replace(";\u00a0", "; ") for item in items if item)
    text = text if dataset.attrs.get("medium") else ""
    return text[:1].upper() + text[1:]


def _describe_medium(attributes: Attributes, select: dict[str, Any]) -> list[str]:
    """Return the descriptions of the medium and of the fixed labels."""
    kind = str(attributes.get("medium", ""))
    if kind not in FORMATTERS:
        return []
    values = {
        key: attributes[f"{kind}_{key}"]
        for key in FORMATTERS[kind]
        if f"{kind}_{key}" in attributes
    } | select
    for keys in _EQUIVALENT_KEYS:
        # The selected one, or the one with the fewest digits, which is the one that was written.
        given = [key for key in keys if key in values]
        shown = [key for key in given if key in select] or sorted(
            given, key=lambda key: count_digits(values[key])
        )
        values = {key: v for key, v in values.items() if key not in given or key == shown[0]}
    opaque = attributes.get(f"{kind}_opaque") == "true"
    has_no_interior = opaque or attributes.get("instrument") in _SURFACE_INSTRUMENTS
    items = [kind.replace("_", " ")]
    for key, formatter in FORMATTERS[kind].items():
        if key in values and not (has_no_interior and key in _INTERIOR_KEYS):
            items.append(formatter(values.pop(key)))
    if opaque:
        items.append("nothing below the surface")
    values = {
        key: value for key, value in values.items() if key in select and key != "incidence_deg"
    }
    items += [f"{format_parameter(key)}: {format_value(v, key)}" for key, v in values.items()]
    return items


def _describe_light(dataset: xr.Dataset, select: Mapping[str, Any]) -> str:
    incidence = select.get("incidence_deg", dataset.attrs.get("incidence_deg"))
    if incidence is None:
        return ""
    if str(incidence) == "diffuse":
        return "diffuse light"
    text = f"incidence {format_value(incidence)}" + ("" if isinstance(incidence, str) else "°")
    stokes = get_incident_stokes(dataset.attrs)
    if stokes == UNPOLARIZED_LIGHT:
        return text
    return f"{text}, Stokes vector ({', '.join(f'{value:g}' for value in stokes)})"


def _describe_error(dataset: xr.Dataset, band: str) -> str:
    """Return the meaning of the bands, and the error reached."""
    for key, description in (
        ("max_stderr_reached", "standard error"),
        ("relative_stderr_reached", "relative standard error"),
    ):
        reached = dataset[key].max() if key in dataset else dataset.attrs.get(key)
        if reached is not None:
            text = f"{description} ≤ {format_value(float(f'{float(reached):.1g}'))}"
            return f"{band}: {BAND_SIGMA:g} standard errors; {text}" if band else text
    return f"{band}: {BAND_SIGMA:g} standard errors" if band else ""


_MARGIN_INCHES = 0.05
_LINE_SPACING = 1.25
"""Line spacing of notes."""
NOTES_GID = "foot"
"""Identifier of the text of notes in a figure."""


def annotate_figure(figure: Figure, panels: Iterable[Axes], *notes: str) -> Figure:
    """Label the panels of a figure with letters, and write notes at its foot.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With constrained layout.  Its height increases by that of the notes.
    panels : iterable of matplotlib.axes.Axes
        In reading order.  The letter precedes the title of a panel.
    *notes : str
        Paragraphs, wrapped at spaces; empty ones are skipped.

    Returns
    -------
    matplotlib.figure.Figure
        The same figure.
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
    """Write notes below the panels and earlier notes; the figure height increases accordingly."""
    inches, dpi = figure.get_figwidth(), figure.dpi
    if not any(notes):
        return
    text = next((item for item in figure.texts if item.get_gid() == NOTES_GID), None)
    height, previous = figure.get_figheight(), ""
    if text is None:
        text = figure.text(
            _MARGIN_INCHES / inches, 0.0, "", va="bottom", ha="left", fontsize=SMALL_FONT_PT,
            color="0.3", linespacing=_LINE_SPACING, gid=NOTES_GID,
        )  # fmt: skip
        # The layout would otherwise reserve room inside the axes.
        text.set_in_layout(False)
    else:
        previous = text.get_text() + "\n"
        height -= text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    max_width_px = (inches - 2.0 * _MARGIN_INCHES) * dpi
    lines = [line for note in notes if note for line in _wrap_note(text, note, max_width_px)]
    text.set_text(previous + "\n".join(lines))
    notes_height = text.get_window_extent().height / dpi + 2.0 * _MARGIN_INCHES
    figure.set_figheight(height + notes_height)
    fraction = notes_height / (height + notes_height)
    text.set_y(_MARGIN_INCHES / (height + notes_height))
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0.0, fraction, 1.0, 1.0 - fraction))  # type: ignore[call-arg]


def _wrap_note(text: Text, note: str, max_width_px: float) -> list[str]:
    """Return a note wrapped to a width in pixels."""
    lines = [""]
    for word in note.split(" "):
        candidate = f"{lines[-1]} {word}".strip(" ")
        text.set_text(candidate)
        if lines[-1] and text.get_window_extent().width > max_width_px:
            lines.append(word)
        else:
            lines[-1] = candidate
    return lines
