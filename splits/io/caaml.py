"""Snow pits of CAAML files: layers, and measured profiles assigned to them.

The files are those of version 6 of the snow profile of the IACS (XML).  Layers and profiles are
read with their units: that of the value (``uom``), or else that of an element around it
(``uomDepth``, ``uomDensity``, …), or else that of the schema.  Sources: schema SnowProfileIACS v6.0
(http://caaml.org/Schemas/SnowProfileIACS), and the International Classification for Seasonal Snow
on the Ground (Fierz et al. 2009).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from splits.core.labels import convert_units
from splits.core.validation import InvalidValue, check_relations, expand_path, invalid

MIN_OVERLAP_M = 1e-6
"""Overlaps up to this length are due to rounding."""


class DepthProfile(NamedTuple):
    """Values measured over intervals of depth, or at points.

    Attributes
    ----------
    top_m, thickness_m, values : float, shape (n,)
        Depth of the top of each interval below the surface, its thickness, 0 for points, and the
        value measured.
    """

    top_m: np.ndarray
    thickness_m: np.ndarray
    values: np.ndarray

    def drop_gaps(self) -> DepthProfile:
        """Return the profile without missing values and depths, in the order of the depth."""
        thickness_m = np.where(np.isnan(self.thickness_m), 0.0, self.thickness_m)
        kept = np.isfinite(self.top_m) & np.isfinite(self.values)
        order = np.argsort((self.top_m + thickness_m / 2.0)[kept], kind="stable")
        return DepthProfile(
            self.top_m[kept][order], thickness_m[kept][order], self.values[kept][order]
        )


def average_over_layers(
    profile: DepthProfile, top_m: np.ndarray, thickness_m: np.ndarray, *, extend: bool
) -> np.ndarray:
    """Return the value of each layer, the mean of the intervals weighted by their overlap with it.

    Points in a layer that lie in no interval share the part of the layer that no interval covers,
    with equal weights.  A layer without overlap and points takes the value by linear interpolation
    to its middle between the middles of the intervals.

    Parameters
    ----------
    profile : DepthProfile
    top_m, thickness_m : float, shape (layers,)
    extend : bool
        Whether layers above the first or below the last middle that overlap no interval take the
        value of the nearest one; otherwise NaN.
    """
    profile = profile.drop_gaps()
    averages = interpolate_to_layers(profile, top_m, thickness_m, extend=extend)
    # Intervals in the order of their tops, before points at the same depth.
    order = np.lexsort((profile.thickness_m == 0.0, profile.top_m))
    top, thickness, values = (column[order] for column in profile)
    bottom = top + thickness
    deepest = np.maximum.accumulate(bottom)
    deepest_above = np.concatenate([[-np.inf], deepest[:-1]])
    for i, (layer_top, layer_bottom) in enumerate(zip(top_m, top_m + thickness_m, strict=True)):
        near = slice(np.searchsorted(deepest, layer_top), np.searchsorted(top, layer_bottom))
        first, last = np.maximum(layer_top, top[near]), np.minimum(layer_bottom, bottom[near])
        weights = np.where(last - first > MIN_OVERLAP_M, last - first, 0.0)
        # Intervals may overlap each other: what each one covers beyond those above it.
        covered = np.maximum(last - np.maximum(first, deepest_above[near]), 0.0).sum()
        is_free = (thickness[near] == 0.0) & (
            top[near] >= np.maximum(layer_top, deepest_above[near])
        )
        if is_free.any() and covered < layer_bottom - layer_top:
            weights *= covered / max(weights.sum(), MIN_OVERLAP_M)
            weights[is_free] = (layer_bottom - layer_top - covered) / is_free.sum()
        if weights.any():
            averages[i] = weights @ values[near] / weights.sum()
    return averages


def interpolate_to_layers(
    profile: DepthProfile, top_m: np.ndarray, thickness_m: np.ndarray, *, extend: bool
) -> np.ndarray:
    """Return the value at the middle of each layer, linear between the middles of the intervals.

    Parameters are those of `average_over_layers`.
    """
    profile = profile.drop_gaps()
    if not profile.values.size:
        return np.full(top_m.shape, np.nan)
    beyond = {} if extend else {"left": np.nan, "right": np.nan}
    middle_m, measured_m = top_m + thickness_m / 2.0, profile.top_m + profile.thickness_m / 2.0
    for end_m in measured_m[[0, -1]]:
        middle_m = np.where(np.abs(middle_m - end_m) <= MIN_OVERLAP_M, end_m, middle_m)
    return np.asarray(np.interp(middle_m, measured_m, profile.values, **beyond))


MAX_BYTES = 50_000_000
"""Largest size of a file."""
SCHEMA = r".*/SnowProfileIACS/v6[.\d]*"
ROOT_PATTERN = re.compile(rf"(?:{{{SCHEMA}}})?SnowProfile")
NAMESPACE_PATTERN = re.compile(rf"{{(?:{SCHEMA}|http://www\.opengis\.net/gml(?:/[.\d]+)?)}}")
"""Namespaces of the schema, of which GML is a part; elements of others are data of a program."""
GAP_WORDS = {"", "inapplicable", "missing", "template", "unknown", "withheld", "nan", "n/a"}
"""Texts in place of a number that is not known, as well as ``other:`` and a reason."""
NUMBER_PATTERN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
TIME_PATTERN = re.compile(
    r"\d{4}-\d\d-\d\d([T ]\d\d(:\d\d(:\d\d(\.\d+)?)?)?\s*(Z|[+-]\d\d(:?\d\d)?)?)?", re.ASCII
)
"""Dates of ISO 8601, with or without a time; no part of the date is left to the present."""
TOLERANCE_M = 1e-3
"""Distance between layers, and length of their overlap, that are due to rounding."""
LIMIT_TOLERANCE_M = 1e-4
"""Distance between limits of measured intervals that is due to rounding."""
TOP_DOWN = "top down"


WATER_DENSITY_KG_M3 = 1000.0
UNITS = {
    "depth": ("cm", "m", ("uomdepth",)),
    "depthTop": ("cm", "m", ("uomdepthtop", "uomdepth")),
    "thickness": ("cm", "m", ("uomthickness", "uomdepth")),
    "density": ("kgm-3", "kg m-3", ("uomdensity",)),
    "specSurfArea": ("m2kg-1", "m2 kg-1", ("uomspecsurfarea",)),
    "lwc": ("% by Vol", "1", ("uomlwc",)),
    "snowTemp": ("degC", "degC", ("uomsnowtemp", "uomtemp")),
}
"""Units of numbers by the name of their element: that of the schema, that of `splits`, and the
attributes of elements around the number that state another one, the first of which holds."""
TEMPERATURE_TAG = "snowTemp"
"""Element of the only number that may be negative."""
PROFILES = {
    "density_kg_m3": ("densityProfile", "density", np.nan),
    "specific_surface_area_m2_kg": ("specSurfAreaProfile", "specSurfArea", np.nan),
    "temperature_c": ("tempProfile", TEMPERATURE_TAG, -1.0),
    "liquid_water_content": ("lwcProfile", "lwc", 0.0),
}
"""Elements of a profile and of its values by name of the variable, and the value without them."""


def read_snow_pit(
    path: str | Path, *, extend: bool = True, with_time: bool = True
) -> tuple[pd.Timestamp, dict[str, np.ndarray]]:
    """Return the time of a CAAML file, and the layers of its snow pit.

    See `splits.read_caaml` for the rules and errors.

    Returns
    -------
    time : pandas.Timestamp
        In UTC, without time zone; NaT if it is not asked for.
    layers : dict of float, shape (layers,)
        Variables of `splits.SnowPacks` from the surface down.
    """
    path = expand_path(path)
    root = _parse_xml(path)
    try:
        return _read_time(root) if with_time else pd.NaT, _read_layers(root, extend)
    except InvalidValue as error:
        error.key = f"{path.name}: {error.key}"
        raise


def _read_layers(root: ElementTree.Element, extend: bool) -> dict[str, np.ndarray]:
    """Return the variables of the layers of a snow pit."""
    measurements = root.find("snowProfileResultsOf/SnowProfileMeasurements")
    if measurements is None:
        raise invalid("SnowProfileMeasurements", None, "an element of the file")
    direction = measurements.get("dir", TOP_DOWN)
    if direction != TOP_DOWN:
        raise invalid("dir", direction, TOP_DOWN, "depths are counted from the surface")
    layers, soil_m = _read_stratigraphy(measurements)
    profiles = {}
    for name, (profile_tag, value_tag, _) in PROFILES.items():
        rows = [
            row
            for profile in measurements.findall(profile_tag)
            for list_rows in (_list_intervals, _list_points)
            for row in list_rows(profile, value_tag, soil_m)
        ]
        if rows:
            profiles[name] = DepthProfile(*np.array(rows, dtype=float).T)
    top_m, thickness_m = _order_layers(layers or _list_interval_layers(profiles))
    # Layers that the file does not describe fill the gaps between others.
    bottom_m = np.concatenate([[0.0], top_m + thickness_m])[: top_m.size]
    positions = np.flatnonzero(top_m - bottom_m > TOLERANCE_M)
    is_gap = np.insert(np.zeros(top_m.size, dtype=bool), positions, True)
    thickness_m = np.insert(thickness_m, positions, (top_m - bottom_m)[positions])
    top_m = np.insert(top_m, positions, bottom_m[positions])
    values = {}
    for name, (_, value_tag, default) in PROFILES.items():
        values[name] = np.full(top_m.shape, default)
        if name in profiles:
            is_temperature = value_tag == TEMPERATURE_TAG
            assign = interpolate_to_layers if is_temperature else average_over_layers
            values[name] = assign(profiles[name], top_m, thickness_m, extend=extend)
    # Densities are measured with the water.
    values["density_kg_m3"] -= WATER_DENSITY_KG_M3 * values["liquid_water_content"]
    for name in ("density_kg_m3", "specific_surface_area_m2_kg"):
        values[name][is_gap] = np.nan
    return {"thickness_m": thickness_m, **values}


def _parse_xml(path: Path) -> ElementTree.Element:
    """Return the root of a file, with tags and attributes without the namespaces of the schema.

    Document types, which may define entities that expand without limit, are rejected.
    """

    class Builder(ElementTree.TreeBuilder):
        def doctype(self, *_: str | None) -> None:
            hint = "it may define entities; CAAML needs none"
            raise invalid(f"{path.name}: DOCTYPE", "given", "left out", hint)

    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise invalid("path", path.name, f"a file of at most {MAX_BYTES / 1e6:g} MB")
    parser = ElementTree.XMLParser(target=Builder())
    try:
        parser.feed(content)
        root = parser.close()
    except InvalidValue:
        raise
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        # An encoding that Python does not know, or cannot pass to the parser, is no ParseError.
        raise invalid("path", path.name, "an XML file of CAAML", str(error)) from None
    if not ROOT_PATTERN.fullmatch(root.tag):
        allowed = "a SnowProfile of SnowProfileIACS, version 6"
        raise invalid(f"{path.name}: root element", root.tag, allowed)
    for element in root.iter():
        element.tag = NAMESPACE_PATTERN.sub("", element.tag)
        element.attrib = {
            NAMESPACE_PATTERN.sub("", name).lower(): text for name, text in element.items()
        }
    return root


def _read_time(root: ElementTree.Element) -> pd.Timestamp:
    """Return the time of the observation in UTC; a time without zone is taken as UTC."""
    texts = [
        # GML says by an attribute that a time is only a limit, "before" or "after".
        f"{element.get('indeterminateposition', '')} {element.text or ''}".strip()
        for position in ("TimeInstant/timePosition", "TimePeriod/beginPosition")
        for element in root.iterfind(f"timeRef/recordTime/{position}")
    ]
    text = next(filter(None, texts), "")
    try:
        time = pd.Timestamp(text) if TIME_PATTERN.fullmatch(text) else pd.NaT
    except ValueError:
        time = pd.NaT
    if time is pd.NaT:
        allowed = "a date or time of ISO 8601, such as 2024-01-31T10:00:00Z"
        raise invalid("timePosition", text, allowed, "label='file' needs no time")
    return time if time.tzinfo is None else time.tz_convert("UTC").tz_localize(None)


def _read_stratigraphy(
    measurements: ElementTree.Element,
) -> tuple[list[tuple[float, float]], float]:
    """Return top and thickness of the layers of snow, and the depth of the soil below them.

    The model SNOWPACK adds layers of soil, with a fraction of soil (``phiSoil``) above 0.
    """
    layers, soil_m = [], np.inf
    for profile in measurements.findall("stratProfile"):
        for layer in profile.findall("Layer"):
            top_m, thickness_m = (
                _read_child(tag, layer, profile) for tag in ("depthTop", "thickness")
            )
            layers.append((top_m, thickness_m))
            soil = [_parse_number("phiSoil", one.text) for one in layer.iterfind(".//{*}phiSoil")]
            if any(fraction > 0.0 for fraction in soil):
                soil_m = min(soil_m, top_m)
    # A layer without a depth stays, for the error that names it.
    return [one for one in layers if not one[0] >= soil_m - TOLERANCE_M], soil_m


def _parse_number(key: str, text: str | None) -> float:
    """Return the number of a text, or NaN if it is not known."""
    word = (text or "").strip()
    if word.lower() in GAP_WORDS or word.lower().startswith("other:"):
        return np.nan
    number = float(word) if NUMBER_PATTERN.fullmatch(word) else np.inf
    if not np.isfinite(number):
        raise invalid(key, word, "a number, or a word such as missing")
    return number


def _convert(
    tag: str, text: str | None, own_unit: str | None, *around: ElementTree.Element
) -> float:
    """Return a number in the unit of `splits`, or NaN if it is not known.

    Parameters
    ----------
    tag : str
        Key of `UNITS`.
    text, own_unit : str or None
        Number, and the unit stated with it; an empty text states none.
    around : Element
        Elements around the number, which may state its unit, from the nearest one outwards.
    """
    hint = "it does not say of what; write uomDepth, uomDensity, …"
    units = [(f"{one.tag}.uom", one.get("uom")) for one in around]
    check_relations(*(
        (not (given or "").strip(), key, given, "left out", hint) for key, given in units
    ))  # fmt: skip
    schema_unit, unit, attributes = UNITS[tag]
    stated = [own_unit, *(one.get(name) for one in around for name in attributes)]
    given = next((one for one in stated if one and one.strip()), schema_unit)
    value = float(convert_units(tag, np.array(_parse_number(tag, text)), given, unit))
    if value < 0.0 and tag != TEMPERATURE_TAG:
        raise invalid(tag, text, "at least 0", "write missing for a gap")
    return value


def _read_child(tag: str, row: ElementTree.Element, profile: ElementTree.Element) -> float:
    """Return the number of an element of a layer or observation, NaN if it is not known."""
    child = row.find(tag)
    return np.nan if child is None else _convert(tag, child.text, child.get("uom"), row, profile)


def _list_intervals(
    profile: ElementTree.Element, value_tag: str, soil_m: float
) -> Iterator[tuple[float, float, float]]:
    """Yield top, thickness and value of the layers and observations of a profile above the soil."""
    for layer in profile.findall("Layer"):
        top_m = _read_child("depthTop", layer, profile)
        if not top_m >= soil_m - TOLERANCE_M:
            thickness_m = _read_child("thickness", layer, profile)
            yield top_m, thickness_m, _read_child(value_tag, layer, profile)
    for point in profile.findall("Obs"):
        depth_m = _read_child("depth", point, profile)
        if not depth_m > soil_m + TOLERANCE_M:
            yield depth_m, 0.0, _read_child(value_tag, point, profile)


def _list_points(
    profile: ElementTree.Element, value_tag: str, soil_m: float
) -> Iterator[tuple[float, float, float]]:
    """Yield depth, 0 and value of the points ``depth,value depth,value`` of a profile.

    ``MeasurementComponents`` names the numbers of a point in their order, and their units.  Lists
    follow GML (CoordinatesType): ``cs`` separates the numbers of a point, ``ts`` the points.
    """
    around = [*profile.findall("MeasurementComponents")[:1], profile]
    units = {one.tag: one.get("uom") for components in around[:-1] for one in components}
    names = [*units] if {"depth", value_tag} <= {*units} else ["depth", value_tag]
    for points in profile.iterfind("Measurements/tupleList"):
        comma, blank, decimal = (
            points.get(name) or usual
            for name, usual in (("cs", ","), ("ts", " "), ("decimal", "."))
        )
        text = re.sub(rf"\s*{re.escape(comma)}\s*", comma, points.text or "")
        for point in filter(None, text.split(blank.strip() or None)):
            numbers = [one.replace(decimal, ".") for one in point.strip().split(comma)]
            if len(numbers) != len(names):
                raise invalid("tupleList", point, f"tuples of {comma.join(names)}")
            texts = dict(zip(names, numbers, strict=True))
            depth_m = _convert("depth", texts["depth"], units.get("depth"), *around)
            if not depth_m > soil_m + TOLERANCE_M:
                value = _convert(value_tag, texts[value_tag], units.get(value_tag), *around)
                yield depth_m, 0.0, value


def _list_interval_layers(profiles: dict[str, DepthProfile]) -> list[tuple[float, float]]:
    """Return top and thickness of layers between all limits of measured intervals."""
    limits = [np.zeros(1)]
    for profile in profiles.values():
        is_interval = profile.thickness_m > 0.0
        top_m = profile.top_m[is_interval]
        limits += [top_m, top_m + profile.thickness_m[is_interval]]
    depths_m = np.unique(np.concatenate(limits))
    depths_m = depths_m[np.isfinite(depths_m)]
    # Limits that differ by rounding are one.
    depths_m = depths_m[np.diff(depths_m, prepend=-np.inf) > LIMIT_TOLERANCE_M]
    return list(zip(depths_m[:-1].tolist(), np.diff(depths_m).tolist(), strict=True))


def _order_layers(layers: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return top and thickness of layers from the surface down.

    An unknown thickness of a layer above another one is the distance of their tops.
    """
    table = np.array(layers, dtype=float).reshape(-1, 2)
    top_m, thickness_m = table[np.argsort(table[:, 0], kind="stable")].T.copy()
    distance_m = np.diff(top_m)
    thickness_m[:-1] = np.where(np.isnan(thickness_m[:-1]), distance_m, thickness_m[:-1])
    overlaps = np.flatnonzero(thickness_m[:-1] > distance_m + TOLERANCE_M)
    check_relations(
        (not np.isnan(top_m).any(), "depthTop", top_m.tolist(), "a depth for each layer"),
        *(
            (
                False, "depthTop", float(top_m[i + 1]), "below the layer above it, in metres",
                f"a layer from {top_m[i]:g} m is {thickness_m[i]:g} m thick",
            )
            for i in overlaps
        ),
    )  # fmt: skip
    return top_m, thickness_m
