"""Sections `medium` and `grid` of an experiment file: layers, tables, values and their labels."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import PurePath
from typing import Any

import numpy as np

from splits.core.spacing import GEOMSPACE_KEY, STEP_KEYS, expand_spacing
from splits.core.validation import (
    MAX_LABEL_CHARS,
    check_number,
    check_text,
    expand_path,
    format_key,
    invalid,
    join_names,
    key_prefix,
    unknown_key,
)
from splits.materials.csv_table import is_csv_path
from splits.media.interpretations import merge_interpretations
from splits.media.kinds import LAYERS_KEY, iter_layers
from splits.media.parameters import (
    describe_parameter,
    get_parameter_quantity,
    get_quantity,
    override_keywords,
    parse_impurity_parameter,
    parse_layer_parameter,
)
from splits.media.snow_pack_files import read_snow_packs
from splits.media.snow_packs import SnowPacks

SAMPLE_KEY = "medium"
"""Grid dimension whose values are media: their settings replace those of the base medium."""
PACKS_KIND = "snow_packs"
"""Kind of the medium of a file of snowpacks."""
PACKS_PER_BLOCK, BLOCKS_PER_PART = 50, 10


def apply_paths(settings: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a stack with values of its layers replaced by their paths."""
    paths = {name: parse_layer_parameter(name) for name in values}
    merged = override_keywords(settings, {k: v for k, v in values.items() if paths[k] is None})
    if any(paths.values()):
        if LAYERS_KEY not in merged:
            raise unknown_key(next(name for name, path in paths.items() if path), settings)
        given = iter_layers(LAYERS_KEY, merged[LAYERS_KEY])
        merged[LAYERS_KEY] = [dict(layer) for _, layer in given]
    for parameter, path in paths.items():
        if path is None:
            continue
        (number, key), layers = path, merged[LAYERS_KEY]
        if number >= len(layers):
            allowed = f"0 to {len(layers) - 1}"
            raise invalid(parameter, f"layer {number}", allowed, "counted from the top")
        parts = [one[key] for one in (layers[number], {key: values[parameter]}) if key in one]
        layers[number] = override_keywords(layers[number], {key: merge_values(key, parts)})
    return merged


def is_merged(key: str) -> bool:
    """Return whether values of a grid are merged into those of the medium: those of mappings."""
    return key == "interpretation" or get_quantity(key).is_mapping


def merge_values(key: str, given: list[Any]) -> Any:
    """Return the value of a keyword given in sequence: mappings are merged, others replaced."""
    if key == "interpretation":
        return merge_interpretations(given)
    if is_merged(key) and all(isinstance(value, Mapping) for value in given):
        return {k: v for value in given for k, v in value.items()}
    return given[-1]


PATH_KEYWORDS = ("file", "scattering_matrix", "impurities_ng_g")
"""Keywords in whose values every text is the path of a file."""
NAME_OR_PATH_KEYWORDS = ("ground", "refractive_index")
"""Keywords in whose values a text is a name, or the path of a CSV file."""


def is_table_path(keyword: str, value: Any) -> bool:
    """Return whether a value of a keyword of a medium is the path of a file that is then read."""
    if not isinstance(value, str):
        return False
    is_csv = keyword in NAME_OR_PATH_KEYWORDS and is_csv_path(value)
    return is_csv or keyword in PATH_KEYWORDS


def get_keyword(parameter: str) -> str:
    """Return the keyword of a medium that a parameter of a grid sets, perhaps for a layer."""
    impurity, layer = parse_impurity_parameter(parameter), parse_layer_parameter(parameter)
    return impurity[0] if impurity else layer[1] if layer else parameter


def replace_table_paths(
    settings: Mapping[str, Any], replace: Callable[[str], str]
) -> dict[str, Any]:
    """Return settings with the path of every file that their media read replaced.

    Parameters
    ----------
    settings : mapping
        Content of the file of an experiment or medium, or keywords of a medium.
    replace : callable
        From a path to its replacement.
    """

    def replace_in(keyword: str, value: Any) -> Any:
        if isinstance(value, Mapping) and keyword in (SAMPLE_KEY, LAYERS_KEY):
            return replace_table_paths(value, replace)
        if isinstance(value, Mapping):
            return {key: replace_in(keyword, one) for key, one in value.items()}
        if isinstance(value, (list, tuple)):
            return [replace_in(keyword, one) for one in value]
        return replace(value) if is_table_path(keyword, value) else value

    def replace_in_grid(parameter: str, values: Any) -> Any:
        keyword = get_keyword(parameter)
        if isinstance(values, Mapping):
            return {label: replace_in(keyword, value) for label, value in values.items()}
        return replace_in(keyword, values)

    replaced = {key: replace_in(key, value) for key, value in settings.items() if key != "grid"}
    if "grid" in settings:
        grid = settings["grid"].items()
        replaced["grid"] = {name: replace_in_grid(name, values) for name, values in grid}
    return replaced


def identify_by_content(path: str) -> str:
    """Return the file name and the SHA-256 of a table.

    A table that every point of a grid replaces need not exist.
    """
    file = expand_path(path)
    digest = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else "unused"
    return f"{file.name} sha256:{digest}"


def list_table_paths(settings: Mapping[str, Any]) -> list[str]:
    """Return the paths of all files that the media of settings read, see `replace_table_paths`."""
    paths: set[str] = set()

    def collect(path: str) -> str:
        paths.add(path)
        return path

    replace_table_paths(settings, collect)
    return sorted(paths)


Coordinate = tuple[str, np.ndarray, dict[str, str]]
"""Dimension, values and attributes of a coordinate of `xarray.Dataset`."""


def make_grid_coordinates(
    grid: Mapping[str, Mapping[str, Any]],
) -> dict[str, Coordinate]:
    """Return the coordinates of an experiment's grid, the values of its parameters by label.

    They are numbers with their unit if all values are numbers, otherwise labels with the unit in
    their long name.  Labels of ranges and distributions have additional coordinates ``…_mean``,
    which allow interpolation.
    """
    coordinates = {}
    for parameter, choices in grid.items():
        long_name, units = describe_parameter(parameter)
        values = to_coordinate_values(choices)
        attributes = {"long_name": long_name, "units": units}
        if values.dtype.kind != "f":
            attributes = {"long_name": long_name if units == "1" else f"{long_name} ({units})"}
        coordinates[parameter] = (parameter, values, attributes)
        quantity = get_parameter_quantity(parameter)
        are_lists = all(isinstance(value, (list, tuple)) for value in choices.values())
        if quantity.mean is not None and are_lists:
            means = np.array([float(quantity.compute_mean(one)) for one in choices.values()])
            attributes = {"long_name": f"mean of: {long_name}", "units": units}
            coordinates[f"{parameter}_mean"] = (parameter, means, attributes)
    return coordinates


def to_coordinate_values(choices: Mapping[str, Any]) -> np.ndarray:
    """Return numbers where all grid values are numbers, and labels otherwise."""
    if all(map(_is_number, choices.values())):
        return np.array([float(v) for v in choices.values()])
    return np.array(list(choices), dtype=object).astype(str)


MAX_GRID_POINTS = 10_000
"""Largest number of points of a grid."""
SPACING_KEYS = {
    *STEP_KEYS, GEOMSPACE_KEY, "end", "also", "num", "number", "linspace", "logspace",
}  # fmt: skip
"""Keys of which two, or `start` or `geomspace` alone, are no labels."""


def label_grid(grid: Any) -> dict[str, dict[str, Any]]:
    """Return the grid of an experiment file with a label for every value.

    Parameters
    ----------
    grid : mapping
        From parameters to lists of values, mappings from labels to values,
        ``{start, stop, step}``, or ``{geomspace: [first, last, number]}``.

    Raises
    ------
    ValueError
        For a parameter without values, repeated values, and labels that cannot be printed.
    """
    if not isinstance(grid, Mapping):
        raise invalid("grid", grid, "a mapping from parameters to lists of values")
    return {str(parameter): _label_values(str(parameter), v) for parameter, v in grid.items()}


def _label_values(parameter: str, values: Any) -> dict[str, Any]:
    """Return the values of a parameter by label."""
    key = f"grid.{format_key(parameter)}"
    if not isinstance(values, (list, tuple, Mapping)) or not values:
        raise invalid(key, values, "a list of at least one value")
    if isinstance(values, Mapping) and _is_spacing(values):
        values = expand_spacing(key, values).tolist()
    if not isinstance(values, Mapping):
        # Files are labelled by their name, without the folder.
        keyword = get_keyword(parameter)
        names = [PurePath(v).name if is_table_path(keyword, v) else v for v in values]
        labels = [make_label(key, name) for name in names]
        if len(set(labels)) < len(labels):
            raise invalid(key, values, "different values", "or name them")
        values = dict(zip(labels, values, strict=True))
    numbers = [v for v in values.values() if _is_number(v)]
    if len(set(numbers)) < len(numbers):
        raise invalid(key, dict(values), "different values")
    for label in values:
        check_text(f"{key} (label)", str(label), MAX_LABEL_CHARS)
    return {str(label): value for label, value in values.items()}


def _is_spacing(values: Mapping[Any, Any]) -> bool:
    """Return whether a mapping is, or resembles, the form of evenly or geometrically spaced values.

    Values that are all texts or mappings, such as media, have labels.
    """
    if all(isinstance(value, (str, Mapping)) for value in values.values()):
        return False
    return bool({"start", GEOMSPACE_KEY} & set(values)) or len(SPACING_KEYS & set(values)) > 1


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def make_label(key: str, value: Any) -> str:
    """Return a short label for a grid value: "300-750" for a range, the mean of a distribution."""
    if isinstance(value, (list, tuple)):
        if len(value) == 4:
            return _format_label(key, value[2])
        return "-".join(_format_label(key, v) for v in value)
    if isinstance(value, dict):
        raise invalid(key, value, "named: use a mapping from labels to values")
    return _format_label(key, value)


def _format_label(key: str, value: Any) -> str:
    if not _is_number(value):
        return str(value)
    return f"{value:g}" if isinstance(value, float) else f"{check_number(key, value):g}"


def find_label(parameter: str, values: Mapping[str, Any], given: float | str) -> str:
    """Return the label of the value at which a figure fixes a parameter.

    `values` are those of the parameter by label.  A given text is a label or a text value; a number
    is a value, or the number shown in the label of a range or distribution, such as its mean.
    """
    if isinstance(given, str) and given in values:
        return given
    scalars = {k: v for k, v in values.items() if isinstance(v, str) or _is_number(v)}
    matches = [label for label, value in scalars.items() if value == given]
    if matches:
        return matches[0]
    text = str(given) if isinstance(given, str) else f"{given:g}"
    if text in values and not _is_number(values[text]):
        return text
    allowed = f"one of {join_names(map(format_key, values))}"
    raise invalid(f"figure.select.{format_key(parameter)}", given, allowed)


def load_packs(settings: Mapping[str, Any]) -> SnowPacks:
    """Return the snowpacks of the keywords of a medium; the last files are kept in memory."""
    if "file" not in settings:
        raise invalid("medium.file", None, "given", "the file of the snowpacks")
    files = [expand_path(path) for path in list_table_paths(settings)]
    states = [(one.stat().st_mtime_ns, one.stat().st_size) for one in files if one.is_file()]
    with key_prefix("medium"):
        return _load_packs(json.dumps(settings), tuple(states))


@lru_cache(maxsize=2)
def _load_packs(settings: str, states: tuple[tuple[int, int], ...]) -> SnowPacks:
    """Return the snowpacks of settings as JSON, for a state of their files."""
    return read_snow_packs(**json.loads(settings))


def count_pack_parts(packs: SnowPacks) -> int:
    """Return the number of parts of an experiment on snowpacks, each simulated by one job."""
    return -(-len(packs) // (PACKS_PER_BLOCK * BLOCKS_PER_PART))
