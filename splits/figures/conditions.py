"""The line of a figure that says under which conditions its values hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.figures.style import BAND, parameter_label, value_label

Facts = Mapping[str, Any]


def _quantity(label: str, unit: str = "") -> Callable[[Any], str]:
    """Return how a value is said: the words before it and the unit behind."""

    def said(value: Any) -> str:
        values = np.atleast_1d(value)
        if values.dtype.kind in "if":
            text = "–".join(value_label(float(f"{x:.4g}")) for x in values)
        else:
            text = value_label(str(value))
        return f"{label} {text} {'' if text == '∞' else unit}".strip()

    return said


def _water(value: Any) -> str:
    return "dry" if str(value) in ("0", "0.0") else _quantity("water saturation")(value)


def _ground(value: Any) -> str:
    return "" if str(value) in ("open", "none") else _quantity("ground:")(value)


_COMMON: dict[str, Callable[[Any], str]] = {
    "depth_m": _quantity("depth", "m"),
    "ground": _ground,
}
_GRAINS = {"density_kg_m3": _quantity("density", "kg m⁻³"), "saturation": _water}
SAID: dict[str, dict[str, Callable[[Any], str]]] = {
    "snow": {"grain_size_um": _quantity("grains", "µm"), **_GRAINS, **_COMMON},
    "natural_snow": {
        "specific_surface_area_m2_kg": _quantity("surface area", "m²/kg"), **_GRAINS, **_COMMON,
    },
    "sand": {"porosity": _quantity("porosity"), "saturation": _water, **_COMMON},
    "layer": {
        "refractive_index": _quantity("index"),
        "optical_thickness": _quantity("optical thickness"),
        "single_scattering_albedo": _quantity("single-scattering albedo"),
        "bottom_albedo": lambda value: (
            "" if str(value) in ("none", "None") else _quantity("bottom albedo")(value)
        ),
        "surface_rms_slope": lambda value: (
            "slopes without finite rms" if str(value) == "inf" else _quantity("rms slope")(value)
        ),
    },
    "stack": {**_COMMON},
}  # fmt: skip
"""What figures say of a medium, by its kind, and how."""
_BELOW = ("optical_thickness", "single_scattering_albedo", "bottom_albedo")
"""What counts for nothing where nothing comes back from below a layer's surface."""
_SURFACES = ("surface", "lens")
"""Instruments that look at a rough surface alone."""


def conditions(
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
    items = [*_of_medium(dataset.attrs, dict(at or {})), _light(dataset, dict(at or {}))]
    if dataset.sizes.get("wavelength") == 1:
        items.append(f"{float(dataset.wavelength.values[0]):g} nm")
    items.append(_error(dataset, band))
    told = ", ".join(item.replace(" ", "\u00a0").replace(";\u00a0", "; ") for item in items if item)
    told = told if dataset.attrs.get("medium") else ""
    return told[:1].upper() + told[1:]


def _of_medium(attributes: Facts, at: dict[str, Any]) -> list[str]:
    """Return what is said of the medium, and of the labels held fixed."""
    kind = str(attributes.get("medium", ""))
    if kind not in SAID:
        return []
    own = {key: attributes[f"{kind}_{key}"] for key in SAID[kind] if f"{kind}_{key}" in attributes} | at
    opaque = attributes.get(f"{kind}_opaque") == "true"
    alone = opaque or attributes.get("instrument") in _SURFACES
    items = [kind.replace("_", " ")]
    for key, said in SAID[kind].items():
        if key in own and not (alone and key in _BELOW):
            items.append(said(own.pop(key)))
    if opaque:
        items.append("nothing below the surface")
    own = {key: value for key, value in own.items() if key in at and key != "incidence_deg"}
    items += [f"{parameter_label(key)}: {value_label(v, key)}" for key, v in own.items()]
    return items


def _light(dataset: xr.Dataset, at: Mapping[str, Any]) -> str:
    given = at.get("incidence_deg", dataset.attrs.get("incidence_deg"))
    if given is None:
        return ""
    if str(given) == "diffuse":
        return "diffuse light"
    return f"incidence {value_label(given)}" + ("" if isinstance(given, str) else "°")


def _error(dataset: xr.Dataset, band: str) -> str:
    """Return what the bands are, and how large an error is reached."""
    for key, words in (
        ("max_stderr_reached", "standard error"),
        ("relative_stderr_reached", "relative standard error"),
    ):
        reached = dataset[key].max() if key in dataset else dataset.attrs.get(key)
        if reached is not None:
            text = f"{words} ≤ {float(f'{float(reached):.1g}'):g}"
            return f"{band}: {BAND:g} standard errors; {text}" if band else text
    return f"{band}: {BAND:g} standard errors" if band else ""
