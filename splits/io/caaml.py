"""Snow pits in CAAML files, version 6 of the snow profile of the IACS (XML).

Layers and profiles are read with their units (``uom``); without one, the unit is that of the
schema.  Sources: schema SnowProfileIACS v6.0 (http://caaml.org/Schemas/SnowProfileIACS), and the
International Classification for Seasonal Snow on the Ground (Fierz et al. 2009).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
import pandas as pd

from splits.core.paths import expand_path
from splits.core.units import convert_units
from splits.core.validation import InvalidValue, invalid
from splits.io.layer_profiles import DepthProfile

MAX_BYTES = 50_000_000
"""Largest size of a file."""
ROOT_PATTERN = re.compile(r"(?:\{.*/SnowProfileIACS/v6[.\d]*\})?SnowProfile")
GAP_WORDS = {"", "inapplicable", "missing", "template", "unknown", "withheld"}
"""Texts in place of a number that is not known."""
TOLERANCE_M = 1e-3
"""Distance between layers, and length of their overlap, that are due to rounding."""
TOP_DOWN = "top down"


class ProfileKind(NamedTuple):
    """Profile in a file: its element, that of a value, its unit in the schema and in `splits`."""

    profile: str
    value: str
    schema_unit: str
    unit: str


PROFILE_KINDS = {
    "density_kg_m3": ProfileKind("densityProfile", "density", "kgm-3", "kg m-3"),
    "specific_surface_area_m2_kg": ProfileKind(
        "specSurfAreaProfile", "specSurfArea", "m2kg-1", "m2 kg-1"
    ),
    "liquid_water_content": ProfileKind("lwcProfile", "lwc", "% by Vol", "1"),
    "temperature_c": ProfileKind("tempProfile", "snowTemp", "degC", "degC"),
}
"""Profiles by name of the variable."""


class SnowPit(NamedTuple):
    """Snow pit.

    Attributes
    ----------
    time : pandas.Timestamp
        Time of the observation in UTC, without time zone.
    top_m, thickness_m : float, shape (layers,)
        Depth of the top of each layer below the surface, in increasing order, and its thickness,
        NaN if unknown.
    is_gap : bool, shape (layers,)
        Whether the file does not describe the layer, which fills the gap between two others.
    profiles : dict of DepthProfile
        Measured profiles by name of the variable; those not in the file are left out.
    """

    time: pd.Timestamp
    top_m: np.ndarray
    thickness_m: np.ndarray
    is_gap: np.ndarray
    profiles: dict[str, DepthProfile]


def read_snow_pit(path: str | Path) -> SnowPit:
    """Return the snow pit of a CAAML file; see `splits.read_caaml` for the rules and errors."""
    path = expand_path(path)
    root = _parse_xml(path)
    measurements = root.find("snowProfileResultsOf/SnowProfileMeasurements")
    if measurements is None:
        raise invalid(f"{path.name}: SnowProfileMeasurements", None, "an element of the file")
    direction = measurements.get("dir", TOP_DOWN)
    if direction != TOP_DOWN:
        hint = "depths are counted from the surface"
        raise invalid(f"{path.name}: dir", direction, TOP_DOWN, hint)
    profiles = {}
    for name, kind in PROFILE_KINDS.items():
        rows = [
            row
            for profile in measurements.findall(kind.profile)
            for row in (*_list_intervals(path, profile, kind), *_list_points(path, profile, kind))
        ]
        if rows:
            profiles[name] = DepthProfile(*np.array(rows, dtype=float).T)
    layers = [
        (_read_depth(path, layer, "depthTop"), _read_depth(path, layer, "thickness"))
        for layer in measurements.findall("stratProfile/Layer")
    ]
    top_m, thickness_m = _order_layers(path, layers or _list_interval_layers(profiles))
    return SnowPit(_read_time(path, root), *_insert_gaps(top_m, thickness_m), profiles)


def _parse_xml(path: Path) -> ElementTree.Element:
    """Return the root of a file, with tags without namespaces.

    Document types, which may define entities that expand without limit, are rejected.
    """

    def reject_document_type(*_: Any) -> None:
        hint = "it may define entities; CAAML needs none"
        raise invalid(f"{path.name}: DOCTYPE", "given", "left out", hint)

    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise invalid("path", path.name, f"a file of at most {MAX_BYTES / 1e6:g} MB")
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = reject_document_type
    try:
        parser.Parse(content, True)
        root = ElementTree.fromstring(content)
    except InvalidValue:
        raise
    # Unknown encodings and those of several bytes are a LookupError or a ValueError.
    except (expat.ExpatError, ElementTree.ParseError, LookupError, ValueError) as error:
        raise invalid("path", path.name, "an XML file of CAAML", str(error)) from None
    if not ROOT_PATTERN.fullmatch(root.tag):
        allowed = "a SnowProfile of SnowProfileIACS, version 6"
        raise invalid(f"{path.name}: root element", root.tag, allowed)
    for element in root.iter():
        if isinstance(element.tag, str):
            element.tag = element.tag.rpartition("}")[2]
    return root


def _read_time(path: Path, root: ElementTree.Element) -> pd.Timestamp:
    """Return the time of the observation in UTC; a time without zone is taken as UTC."""
    start = "timeRef/recordTime"
    text = root.findtext(f"{start}/TimeInstant/timePosition") or root.findtext(
        f"{start}/TimePeriod/beginPosition"
    )
    try:
        time = pd.Timestamp((text or "").strip())
    except ValueError:
        time = pd.NaT
    if time is pd.NaT:
        raise invalid(f"{path.name}: timePosition", text, "a time, such as 2024-01-31T10:00:00Z")
    return time if time.tzinfo is None else time.tz_convert("UTC").tz_localize(None)


def _read_number(
    path: Path, element: ElementTree.Element | None, schema_unit: str, unit: str
) -> float:
    """Return the number of an element in a unit, or NaN if it is not known."""
    text = "" if element is None else (element.text or "").strip()
    if element is None or text.lower() in GAP_WORDS:
        return np.nan
    return _convert(path, element.tag, text, element.get("uom", schema_unit), unit)


def _convert(path: Path, name: str, text: str, given_unit: str, unit: str) -> float:
    """Return the number of a text in a unit."""
    key = f"{path.name}: {name}"
    try:
        number = float(text)
    except ValueError:
        raise invalid(key, text, "a number") from None
    return float(convert_units(key, np.array(number), given_unit, unit))


def _read_depth(path: Path, parent: ElementTree.Element, tag: str) -> float:
    """Return a depth or thickness of a layer (m), or NaN."""
    return _read_number(path, parent.find(tag), "cm", "m")


def _list_intervals(
    path: Path, profile: ElementTree.Element, kind: ProfileKind
) -> Iterator[tuple[float, float, float]]:
    """Yield top, thickness and value of the layers and observations of a profile."""
    for row in (*profile.findall("Layer"), *profile.findall("Obs")):
        value = _read_number(path, row.find(kind.value), kind.schema_unit, kind.unit)
        if row.tag == "Obs":
            yield _read_depth(path, row, "depth"), 0.0, value
        else:
            yield _read_depth(path, row, "depthTop"), _read_depth(path, row, "thickness"), value


def _list_points(
    path: Path, profile: ElementTree.Element, kind: ProfileKind
) -> Iterator[tuple[float, float, float]]:
    """Yield depth, 0 and value of the points ``depth,value depth,value`` of a profile."""
    units = {}
    for tag, unit in (("depth", "cm"), (kind.value, kind.schema_unit)):
        component = profile.find(f"MeasurementComponents/{tag}")
        units[tag] = unit if component is None else component.get("uom", unit)
    for point in profile.findtext("Measurements/tupleList", "").split():
        depth, comma, value = point.partition(",")
        if not comma:
            raise invalid(f"{path.name}: tupleList", point, "pairs of depth,value")
        yield (
            _convert(path, "depth", depth, units["depth"], "m"),
            0.0,
            _convert(path, kind.value, value, units[kind.value], kind.unit),
        )


def _list_interval_layers(profiles: dict[str, DepthProfile]) -> list[tuple[float, float]]:
    """Return top and thickness of layers between all limits of measured intervals."""
    limits = [np.zeros(1)]
    for profile in profiles.values():
        is_interval = profile.thickness_m > 0.0
        top_m = profile.top_m[is_interval]
        limits += [top_m, top_m + profile.thickness_m[is_interval]]
    # Limits that differ by rounding are one.
    depths_m = np.unique(np.round(np.concatenate(limits), 4))
    depths_m = depths_m[np.isfinite(depths_m)]
    return list(zip(depths_m[:-1].tolist(), np.diff(depths_m).tolist(), strict=True))


def _order_layers(path: Path, layers: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return top and thickness of layers from the surface down.

    An unknown thickness of a layer above another one is the distance of their tops.
    """
    table = np.array(layers, dtype=float).reshape(-1, 2)
    top_m, thickness_m = table[np.argsort(table[:, 0], kind="stable")].T.copy()
    key = f"{path.name}: depthTop"
    if not np.isfinite(top_m).all() or (top_m < 0.0).any():
        raise invalid(key, top_m.tolist(), "a depth of at least 0 for each layer")
    distance_m = np.diff(top_m)
    thickness_m[:-1] = np.where(np.isnan(thickness_m[:-1]), distance_m, thickness_m[:-1])
    overlaps = np.flatnonzero(thickness_m[:-1] > distance_m + TOLERANCE_M)
    if overlaps.size:
        i = overlaps[0]
        hint = f"a layer from {top_m[i]:g} m is {thickness_m[i]:g} m thick"
        raise invalid(key, float(top_m[i + 1]), "below the layer above it, in metres", hint)
    return top_m, thickness_m


def _insert_gaps(
    top_m: np.ndarray, thickness_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return tops and thicknesses with layers that fill gaps, and whether each is such a layer."""
    bottom_m = np.concatenate([[0.0], top_m + thickness_m])[: top_m.size]
    has_gap = top_m - bottom_m > TOLERANCE_M
    positions = np.flatnonzero(has_gap)
    is_gap = np.insert(np.zeros(top_m.size, dtype=bool), positions, True)
    gap_m = (top_m - bottom_m)[positions]
    return (
        np.insert(top_m, positions, bottom_m[positions]),
        np.insert(thickness_m, positions, gap_m),
        is_gap,
    )
