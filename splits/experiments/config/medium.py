"""Section `medium` of an experiment file: kinds of media, layers of stacks, users' own tables."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Mapping
from typing import Any

from splits.core.keywords import list_keywords
from splits.core.parameter_names import parse_impurity_parameter, parse_layer_parameter
from splits.core.paths import expand_path
from splits.core.validation import check_choice, format_key, invalid, unknown_key
from splits.materials.csv_table import is_csv_path
from splits.media.interpretations import merge_interpretations
from splits.media.kinds import LAYER_CLASSES, LAYERS_KEY, get_kind, iter_layers
from splits.media.natural_snow import override_keywords

SAMPLE_KEY = "medium"
"""Grid dimension whose values are media: their settings replace those of the base medium."""
MERGED_KEYWORDS = (
    "interpretation",
    "refractive_index",
    "pores",
    "impurities_ng_g",
    "algae_cells_ml",
)
"""Keywords that are mappings: values of a grid are merged into those of the medium."""
STACK_EXCLUDED_KEYWORDS = ("ground", "bottom_albedo", "opaque")
"""Keywords that these media do not have as layers of a stack."""


def list_layer_keywords(layer: Mapping[str, Any], is_top: bool) -> list[str]:
    """Return the keywords of a layer of a stack; only the top layer has a surface."""
    excluded = STACK_EXCLUDED_KEYWORDS if is_top else (*STACK_EXCLUDED_KEYWORDS, "surface")
    return [name for name in list_keywords(LAYER_CLASSES[get_kind(layer)]) if name not in excluded]


def check_layers(prefix: str, layers: Any) -> None:
    """Reject layers of an unknown kind or with an unknown keyword."""
    for layer_key, layer in iter_layers(f"{prefix}.{LAYERS_KEY}", layers):
        check_choice(f"{layer_key}.kind", get_kind(layer), LAYER_CLASSES)
        keywords = list_layer_keywords(layer, layer_key.endswith(".0"))
        for key in layer:
            if key == "ground":
                hint = "give it to the stack"
                raise invalid(f"{layer_key}.ground", layer[key], "left out", hint)
            if key not in (*keywords, "kind"):
                raise unknown_key(f"{layer_key}.{format_key(key)}", keywords)


def check_grid_layers(base: Mapping[str, Any], grid: Mapping[str, Mapping[str, Any]]) -> None:
    """Reject invalid layers, and paths to missing ones, at any point of the grid of a stack."""
    stacks = [base[LAYERS_KEY]]
    for label, layers in grid.get(LAYERS_KEY, {}).items():
        check_layers(f"grid.{LAYERS_KEY}.{format_key(label)}", layers)
        stacks.append(layers)
    samples = grid.get(SAMPLE_KEY, {}).values()
    stacks += [settings[LAYERS_KEY] for settings in samples if LAYERS_KEY in settings]
    for parameter in grid:
        if path := parse_layer_parameter(parameter):
            for layers in stacks:
                _check_path(f"grid.{parameter}", *path, layers)


def _check_path(path: str, number: int, key: str, layers: list[Mapping[str, Any]]) -> None:
    """Reject a path to a missing layer, or to a keyword that a layer does not have."""
    if number >= len(layers):
        raise invalid(path, f"layer {number}", f"0 to {len(layers) - 1}", "counted from the top")
    keywords = list_layer_keywords(layers[number], number == 0)
    if key not in keywords:
        raise unknown_key(path, [f"{LAYERS_KEY}.{number}.{keyword}" for keyword in keywords])


def apply_paths(settings: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a stack with values of its layers replaced by their paths."""
    paths = {name: parse_layer_parameter(name) for name in values}
    merged = override_keywords(settings, {k: v for k, v in values.items() if paths[k] is None})
    if any(paths.values()):
        merged[LAYERS_KEY] = copy.deepcopy(merged[LAYERS_KEY])
    for parameter, path in paths.items():
        if path is None:
            continue
        (number, key), value = path, values[parameter]
        layer = merged[LAYERS_KEY][number]
        given = [layer[key], value] if key in layer else [value]
        merged[LAYERS_KEY][number] = override_keywords(layer, {key: merge_values(key, given)})
    return merged


def merge_values(key: str, given: list[Any]) -> Any:
    """Return the value of a keyword given in sequence: mappings are merged, others replaced."""
    if key == "interpretation":
        return merge_interpretations(given)
    if key in MERGED_KEYWORDS and all(isinstance(value, Mapping) for value in given):
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
