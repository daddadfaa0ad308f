"""Stacks in experiment files: layers by their settings, and paths to one setting of a layer."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from splits.checks import keywords_taken, named, one_of, refuse, under, unknown_key
from splits.media import Layer, Sand, Snow, Stack
from splits.media.measured_inputs import on_top
from splits.media.readings import together
from splits.names import path_of

LAYERS = "layers"
MERGED = ("readings", "refractive_index", "pores", "impurities_ng_g", "algae_cells_ml")
"""Keywords that are mappings: a grid's values add to those of the medium."""
MEDIA: dict[str, Any] = {"snow": Snow, "natural_snow": Snow, "sand": Sand, "layer": Layer}
"""Media that a stack may hold."""
MAKERS: dict[str, Callable[..., Any]] = MEDIA | {"natural_snow": Snow.natural}
"""What makes a medium of a kind of its settings."""
NOT_IN_STACKS = ("ground", "bottom_albedo", "polarized", "max_polarization", "opaque")
"""Keywords that these have by themselves, but not in a stack."""


def kind_of(layer: Mapping[str, Any]) -> str:
    """Return the kind of a layer, as its settings say it."""
    return str(layer.get("kind", "snow"))


def keywords_of(layer: Mapping[str, Any], is_top: bool) -> list[str]:
    """Return the keywords that a layer of this kind has in a stack, as its top or below."""
    left_out = NOT_IN_STACKS if is_top else (*NOT_IN_STACKS, "surface")
    return [name for name in keywords_taken(MEDIA[kind_of(layer)]) if name not in left_out]


def each_layer(key: str, layers: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the place and the settings of every layer, or refuse what are none."""
    if not isinstance(layers, (list, tuple)) or not layers:
        raise refuse(f"{key}.{LAYERS}", layers, "a list of layers, top first")
    for number, layer in enumerate(layers):
        here = f"{key}.{LAYERS}.{number}"
        if not isinstance(layer, Mapping):
            raise refuse(here, layer, "a mapping of a medium's keywords")
        yield here, layer


def check_layers(place: str, layers: Any) -> None:
    """Refuse layers of a kind, or with a keyword, that does not exist."""
    for here, layer in each_layer(place, layers):
        one_of(f"{here}.kind", kind_of(layer), MEDIA)
        known = keywords_of(layer, here.endswith(".0"))
        for key in layer:
            if key == "ground":
                hint = "give it to the stack"
                raise refuse(f"{here}.ground", layer[key], "left out", hint)
            if key not in (*known, "kind"):
                raise unknown_key(f"{here}.{named(key)}", known)


def check_grid(base: Mapping[str, Any], grid: Mapping[str, Mapping[str, Any]], sample: str) -> None:
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
    stacks = [base[LAYERS]]
    for label, layers in grid.get(LAYERS, {}).items():
        check_layers(f"grid.{LAYERS}.{named(label)}", layers)
        stacks.append(layers)
    stacks += [one[LAYERS] for one in grid.get(sample, {}).values() if LAYERS in one]
    for parameter in grid:
        for layers in stacks:
            check_path(parameter, layers)


def check_path(parameter: str, layers: list[Mapping[str, Any]]) -> bool:
    """Tell whether a parameter of a grid is a path, and refuse one that leads nowhere."""
    path = path_of(parameter)
    if path is None:
        return False
    number, key = path
    if number >= len(layers):
        raise refuse(
            f"grid.{parameter}",
            f"layer {number}",
            f"0 to {len(layers) - 1}",
            "counted from the top",
        )
    known = keywords_of(layers[number], number == 0)
    if key not in known:
        raise unknown_key(f"grid.{parameter}", [f"{LAYERS}.{number}.{one}" for one in known])
    return True


def with_paths(settings: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stack's settings with the values that paths name put in their places."""
    found = on_top(settings, {k: value for k, value in values.items() if path_of(k) is None})
    paths = {key: value for key, value in values.items() if path_of(key) is not None}
    if paths:
        found[LAYERS] = copy.deepcopy(found[LAYERS])
    for parameter, value in paths.items():
        number, key = path_of(parameter) or (0, "")
        layer = found[LAYERS][number]
        both = isinstance(value, Mapping) and isinstance(layer.get(key), Mapping)
        new = {**layer[key], **value} if both and key in MERGED else value
        if key == "readings" and key in layer:
            new = together([layer[key], value])
        found[LAYERS][number] = on_top(layer, {key: new})
    return found


def with_bases(key: str, medium: Any, apply_base: Callable[[Any, str], Any]) -> Any:
    """Return a stack's settings with those of its layers complete.

    Parameters
    ----------
    place : str
        Of the stack, for messages.
    medium : mapping
    complete : callable
        Takes the settings and the place of a layer, and returns them on top of those of its base.
    """
    if not isinstance(medium, Mapping) or LAYERS not in medium:
        return medium
    layers = [apply_base(layer, here) for here, layer in each_layer(key, medium[LAYERS])]
    return {**medium, LAYERS: layers}


def stack_of(layers: Any, ground: Any = None, interpretation: Any = None) -> Stack:
    """Return the stack that settings describe; refusals name the layer."""
    media = []
    for number, layer in enumerate(layers):
        with under(f"{LAYERS}.{number}"):
            kind, settings = kind_of(layer), {k: v for k, v in layer.items() if k != "kind"}
            # Below all layers is the stack's ground.
            bottom = {"bottom_albedo": None} if kind == "layer" else {}
            media.append(MAKERS[kind](**settings, **bottom))
    return Stack(tuple(media), ground, interpretation)
