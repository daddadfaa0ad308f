"""Stacks in experiment files: layers by their settings, and paths to one setting of a layer.

Users' own tables of indices, grounds and impurities that an experiment's settings name.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from splits.core.parameter_names import parse_layer_parameter
from splits.core.paths import expand_path
from splits.core.validation import (
    check_choice,
    format_key,
    invalid,
    key_prefix,
    list_keywords,
    unknown_key,
)
from splits.media import ParticleLayer, Sand, Snow, Stack
from splits.media.interpretations import merge_interpretations
from splits.media.measured_inputs import override_keywords

LAYERS_KEY = "layers"
MERGED_KEYWORDS = (
    "interpretation",
    "refractive_index",
    "pores",
    "impurities_ng_g",
    "algae_cells_ml",
)
"""Keywords that are mappings: a grid's values add to those of the medium."""
LAYER_CLASSES: dict[str, Any] = {
    "snow": Snow,
    "natural_snow": Snow,
    "sand": Sand,
    "particle_layer": ParticleLayer,
}
"""Media that a stack may hold."""
MEDIUM_FACTORIES: dict[str, Callable[..., Any]] = LAYER_CLASSES | {"natural_snow": Snow.natural}
"""What makes a medium of a kind of its settings."""
STACK_EXCLUDED_KEYWORDS = ("ground", "bottom_albedo", "polarized", "max_polarization", "opaque")
"""Keywords that these have by themselves, but not in a stack."""


def get_kind(layer: Mapping[str, Any]) -> str:
    """Return the kind of a layer, as its settings say it."""
    return str(layer.get("kind", "snow"))


def list_layer_keywords(layer: Mapping[str, Any], is_top: bool) -> list[str]:
    """Return the keywords that a layer of this kind has in a stack, as its top or below."""
    left_out = STACK_EXCLUDED_KEYWORDS if is_top else (*STACK_EXCLUDED_KEYWORDS, "surface")
    return [name for name in list_keywords(LAYER_CLASSES[get_kind(layer)]) if name not in left_out]


def iter_layers(key: str, layers: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the place and the settings of every layer, or refuse what are none."""
    if not isinstance(layers, (list, tuple)) or not layers:
        raise invalid(f"{key}.{LAYERS_KEY}", layers, "a list of layers, top first")
    for number, layer in enumerate(layers):
        here = f"{key}.{LAYERS_KEY}.{number}"
        if not isinstance(layer, Mapping):
            raise invalid(here, layer, "a mapping of a medium's keywords")
        yield here, layer


def check_layers(place: str, layers: Any) -> None:
    """Refuse layers of a kind, or with a keyword, that does not exist."""
    for here, layer in iter_layers(place, layers):
        check_choice(f"{here}.kind", get_kind(layer), LAYER_CLASSES)
        known = list_layer_keywords(layer, here.endswith(".0"))
        for key in layer:
            if key == "ground":
                hint = "give it to the stack"
                raise invalid(f"{here}.ground", layer[key], "left out", hint)
            if key not in (*known, "kind"):
                raise unknown_key(f"{here}.{format_key(key)}", known)


def check_grid_layers(
    base: Mapping[str, Any], grid: Mapping[str, Mapping[str, Any]], sample: str
) -> None:
    """Refuse layers, and paths to them, that do not exist at some point of a grid.

    Parameters
    ----------
    base : mapping
        The stack.
    grid : mapping
        Per parameter its values by label.
    sample : str
        Parameter whose values are settings of whole stacks.
    """
    stacks = [base[LAYERS_KEY]]
    for label, layers in grid.get(LAYERS_KEY, {}).items():
        check_layers(f"grid.{LAYERS_KEY}.{format_key(label)}", layers)
        stacks.append(layers)
    stacks += [one[LAYERS_KEY] for one in grid.get(sample, {}).values() if LAYERS_KEY in one]
    for parameter in grid:
        for layers in stacks:
            check_parameter_path(parameter, layers)


def check_parameter_path(parameter: str, layers: list[Mapping[str, Any]]) -> bool:
    """Tell whether a parameter of a grid is a path, and refuse one that leads nowhere."""
    path = parse_layer_parameter(parameter)
    if path is None:
        return False
    number, key = path
    if number >= len(layers):
        raise invalid(
            f"grid.{parameter}",
            f"layer {number}",
            f"0 to {len(layers) - 1}",
            "counted from the top",
        )
    known = list_layer_keywords(layers[number], number == 0)
    if key not in known:
        raise unknown_key(f"grid.{parameter}", [f"{LAYERS_KEY}.{number}.{one}" for one in known])
    return True


def apply_paths(settings: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stack's settings with the values that paths name put in their places."""
    found = override_keywords(
        settings, {k: value for k, value in values.items() if parse_layer_parameter(k) is None}
    )
    paths = {key: value for key, value in values.items() if parse_layer_parameter(key) is not None}
    if paths:
        found[LAYERS_KEY] = copy.deepcopy(found[LAYERS_KEY])
    for parameter, value in paths.items():
        number, key = parse_layer_parameter(parameter) or (0, "")
        layer = found[LAYERS_KEY][number]
        both = isinstance(value, Mapping) and isinstance(layer.get(key), Mapping)
        new = {**layer[key], **value} if both and key in MERGED_KEYWORDS else value
        if key == "interpretation" and key in layer:
            new = merge_interpretations([layer[key], value])
        found[LAYERS_KEY][number] = override_keywords(layer, {key: new})
    return found


def apply_bases(key: str, medium: Any, apply_base: Callable[[Any, str], Any]) -> Any:
    """Return a stack's settings with those of its layers complete.

    Parameters
    ----------
    key : str
        Of the stack, for messages.
    medium : mapping
    apply_base : callable
        Takes the settings and the place of a layer, and returns them on top of those of its base.
    """
    if not isinstance(medium, Mapping) or LAYERS_KEY not in medium:
        return medium
    layers = [apply_base(layer, here) for here, layer in iter_layers(key, medium[LAYERS_KEY])]
    return {**medium, LAYERS_KEY: layers}


def make_stack(layers: Any, ground: Any = None, interpretation: Any = None) -> Stack:
    """Return the stack that settings describe; refusals name the layer."""
    media = []
    for number, layer in enumerate(layers):
        with key_prefix(f"{LAYERS_KEY}.{number}"):
            kind, settings = get_kind(layer), {k: v for k, v in layer.items() if k != "kind"}
            # Below all layers is the stack's ground.
            bottom = {"bottom_albedo": None} if kind == "particle_layer" else {}
            media.append(MEDIUM_FACTORIES[kind](**settings, **bottom))
    return Stack(tuple(media), ground, interpretation)


TABLE_KEYS = ("refractive_index", "ground", "impurities_ng_g")


def replace_table_paths(settings: Any, replace: Callable[[str], str], inside: bool = False) -> Any:
    """Return settings with the path of every user's table replaced.

    Parameters
    ----------
    settings : mapping, list or value
        An experiment or medium, or a part of it, as YAML gives it.
    replace : callable
        Takes a path, returns what stands in its place.
    inside : bool
        Whether `settings` stands below one of `TABLE_KEYS`.
    """
    if isinstance(settings, dict):
        return {
            k: replace_table_paths(v, replace, inside or _is_table_key(k))
            for k, v in settings.items()
        }
    if isinstance(settings, (list, tuple)):
        return [replace_table_paths(value, replace, inside) for value in settings]
    if inside and isinstance(settings, str) and settings.endswith(".csv"):
        return replace(settings)
    return settings


def _is_table_key(key: Any) -> bool:
    """Tell whether a key, or the last part of a path, is one of `TABLE_KEYS`."""
    return str(key).rpartition(".")[2] in TABLE_KEYS


def identify_by_content(path: str) -> str:
    """Return the name of a table without its folder, and the SHA-256 of its content.

    A medium's table that every point of a grid replaces need not exist.
    """
    file = expand_path(path)
    digest = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else "unused"
    return f"{file.name} sha256:{digest}"


def list_table_paths(settings: Any) -> list[str]:
    """Return the paths of all users' tables that settings name."""
    found: set[str] = set()

    def note(path: str) -> str:
        found.add(path)
        return path

    replace_table_paths(settings, note)
    return sorted(found)
