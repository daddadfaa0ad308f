"""Layers and profiles of snow pits: CAAML files, and measured profiles assigned to layers.

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
from splits.core.validation import InvalidValue, expand_path, invalid

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


class FileQuantity(NamedTuple):
    """Number in a file: its unit in the schema and in `splits`, and where others are stated.

    Attributes
    ----------
    schema_unit, unit : str
    unit_attributes : tuple of str
        Attributes of elements around the number that state its unit, in lower case; the first one
        that is given holds.
    lowest : float
        Smallest value that the schema allows.
    """

    schema_unit: str
    unit: str
    unit_attributes: tuple[str, ...]
    lowest: float = 0.0


QUANTITIES = {
    "depth": FileQuantity("cm", "m", ("uomdepth",)),
    "depthTop": FileQuantity("cm", "m", ("uomdepthtop", "uomdepth")),
    "thickness": FileQuantity("cm", "m", ("uomthickness", "uomdepth")),
    "density": FileQuantity("kgm-3", "kg m-3", ("uomdensity",)),
    "specSurfArea": FileQuantity("m2kg-1", "m2 kg-1", ("uomspecsurfarea",)),
    "lwc": FileQuantity("% by Vol", "1", ("uomlwc",)),
    "snowTemp": FileQuantity("degC", "degC", ("uomsnowtemp", "uomtemp"), -np.inf),
}
"""Numbers by the name of their element."""
PROFILES = {
    "density_kg_m3": ("densityProfile", "density"),
    "specific_surface_area_m2_kg": ("specSurfAreaProfile", "specSurfArea"),
    "liquid_water_content": ("lwcProfile", "lwc"),
    "temperature_c": ("tempProfile", "snowTemp"),
}
"""Elements of a profile and of its values by name of the variable."""


class SnowPit(NamedTuple):
    """Snow pit.

    Attributes
    ----------
    time : pandas.Timestamp
        Time of the observation in UTC, without time zone; NaT if it was not asked for.
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


def read_snow_pit(path: str | Path, *, with_time: bool = True) -> SnowPit:
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
    layers, soil_m = _read_stratigraphy(path, measurements)
    profiles = {}
    for name, (profile_tag, value_tag) in PROFILES.items():
        rows = [
            row
            for profile in measurements.findall(profile_tag)
            for list_rows in (_list_intervals, _list_points)
            for row in list_rows(path, profile, value_tag, soil_m)
        ]
        if rows:
            profiles[name] = DepthProfile(*np.array(rows, dtype=float).T)
    top_m, thickness_m = _order_layers(path, layers or _list_interval_layers(profiles))
    time = _read_time(path, root) if with_time else pd.NaT
    return SnowPit(time, *_insert_gaps(top_m, thickness_m), profiles)


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


def _read_time(path: Path, root: ElementTree.Element) -> pd.Timestamp:
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
        raise invalid(f"{path.name}: timePosition", text, allowed, "label='file' needs no time")
    return time if time.tzinfo is None else time.tz_convert("UTC").tz_localize(None)


def _read_stratigraphy(
    path: Path, measurements: ElementTree.Element
) -> tuple[list[tuple[float, float]], float]:
    """Return top and thickness of the layers of snow, and the depth of the soil below them.

    The model SNOWPACK adds layers of soil, with a fraction of soil (``phiSoil``) above 0.
    """
    layers, soil_m = [], np.inf
    for profile in measurements.findall("stratProfile"):
        for layer in profile.findall("Layer"):
            top_m, thickness_m = (
                _read_child(path, tag, layer, profile) for tag in ("depthTop", "thickness")
            )
            layers.append((top_m, thickness_m))
            key = f"{path.name}: phiSoil"
            if any(_parse_number(key, one.text) > 0.0 for one in layer.iterfind(".//{*}phiSoil")):
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
    path: Path, tag: str, text: str | None, own_unit: str | None, *around: ElementTree.Element
) -> float:
    """Return a number in the unit of `splits`, or NaN if it is not known.

    Parameters
    ----------
    tag : str
        Key of `QUANTITIES`.
    text, own_unit : str or None
        Number, and the unit stated with it; an empty text states none.
    around : Element
        Elements around the number, which may state its unit, from the nearest one outwards.
    """
    quantity, key = QUANTITIES[tag], f"{path.name}: {tag}"
    given = [own_unit, *(one.get(name) for one in around for name in quantity.unit_attributes)]
    unit = next((one for one in given if one and one.strip()), quantity.schema_unit)
    for one in around:
        if (one.get("uom") or "").strip():
            hint = "it does not say of what; write uomDepth, uomDensity, …"
            raise invalid(f"{path.name}: {one.tag}.uom", one.get("uom"), "left out", hint)
    value = float(convert_units(key, np.array(_parse_number(key, text)), unit, quantity.unit))
    if value < quantity.lowest:
        raise invalid(key, text, f"at least {quantity.lowest:g}", "write missing for a gap")
    return value


def _read_child(
    path: Path, tag: str, row: ElementTree.Element, profile: ElementTree.Element
) -> float:
    """Return the number of an element of a layer or observation, NaN if it is not known."""
    child = row.find(tag)
    if child is None:
        return np.nan
    return _convert(path, tag, child.text, child.get("uom"), row, profile)


def _list_intervals(
    path: Path, profile: ElementTree.Element, value_tag: str, soil_m: float
) -> Iterator[tuple[float, float, float]]:
    """Yield top, thickness and value of the layers and observations of a profile above the soil."""
    for layer in profile.findall("Layer"):
        top_m = _read_child(path, "depthTop", layer, profile)
        if not top_m >= soil_m - TOLERANCE_M:
            thickness_m = _read_child(path, "thickness", layer, profile)
            yield top_m, thickness_m, _read_child(path, value_tag, layer, profile)
    for point in profile.findall("Obs"):
        depth_m = _read_child(path, "depth", point, profile)
        if not depth_m > soil_m + TOLERANCE_M:
            yield depth_m, 0.0, _read_child(path, value_tag, point, profile)


def _list_points(
    path: Path, profile: ElementTree.Element, value_tag: str, soil_m: float
) -> Iterator[tuple[float, float, float]]:
    """Yield depth, 0 and value of the points ``depth,value depth,value`` of a profile.

    ``MeasurementComponents`` names the numbers of a point in their order, and their units.  Lists
    follow GML (CoordinatesType): ``cs`` separates the numbers of a point, ``ts`` the points.
    """
    components = profile.find("MeasurementComponents")
    around = (profile,) if components is None else (components, profile)
    names = [] if components is None else [one.tag for one in components]
    if not {"depth", value_tag} <= {*names}:
        names = ["depth", value_tag]
    units = {} if components is None else {one.tag: one.get("uom") for one in components}
    for points in profile.iterfind("Measurements/tupleList"):
        comma, blank, decimal = (
            points.get(name) or usual
            for name, usual in (("cs", ","), ("ts", " "), ("decimal", "."))
        )
        text = re.sub(rf"\s*{re.escape(comma)}\s*", comma, points.text or "")
        for point in filter(None, text.split(blank.strip() or None)):
            numbers = [one.replace(decimal, ".") for one in point.strip().split(comma)]
            if len(numbers) != len(names):
                allowed = f"tuples of {comma.join(names)}"
                raise invalid(f"{path.name}: tupleList", point, allowed)
            texts = dict(zip(names, numbers, strict=True))
            depth_m = _convert(path, "depth", texts["depth"], units.get("depth"), *around)
            if not depth_m > soil_m + TOLERANCE_M:
                text, unit = texts[value_tag], units.get(value_tag)
                yield depth_m, 0.0, _convert(path, value_tag, text, unit, *around)


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


def _order_layers(path: Path, layers: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return top and thickness of layers from the surface down.

    An unknown thickness of a layer above another one is the distance of their tops.
    """
    table = np.array(layers, dtype=float).reshape(-1, 2)
    top_m, thickness_m = table[np.argsort(table[:, 0], kind="stable")].T.copy()
    key = f"{path.name}: depthTop"
    if np.isnan(top_m).any():
        raise invalid(key, top_m.tolist(), "a depth for each layer")
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
    gap_m = top_m - bottom_m
    positions = np.flatnonzero(gap_m > TOLERANCE_M)
    return (
        np.insert(top_m, positions, bottom_m[positions]),
        np.insert(thickness_m, positions, gap_m[positions]),
        np.insert(np.zeros(top_m.size, dtype=bool), positions, True),
    )
