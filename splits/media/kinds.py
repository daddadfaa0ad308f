"""Kinds of media: construction of a medium from its kind and keywords."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from splits.core.validation import check_choice, invalid, key_prefix
from splits.media.medium import Medium
from splits.media.particle_layer import ParticleLayer
from splits.media.sand import Sand
from splits.media.snow import Snow
from splits.media.stack import Stack

LAYERS_KEY = "layers"
LAYER_CLASSES: dict[str, Any] = {
    "snow": Snow,
    "natural_snow": Snow,
    "sand": Sand,
    "particle_layer": ParticleLayer,
}
"""Media that a stack may hold."""
MEDIUM_CLASSES: dict[str, Any] = {**LAYER_CLASSES, "stack": Stack}
MEDIUM_FACTORIES: dict[str, Callable[..., Any]] = LAYER_CLASSES | {"natural_snow": Snow.natural}
"""Functions that make a layer from its keywords, by kind."""


def get_kind(settings: Mapping[str, Any]) -> str:
    """Return the kind of a medium or a layer."""
    return str(settings.get("kind", "snow"))


def make_medium(kind: str, keywords: Mapping[str, Any]) -> Medium:
    """Return the medium of a kind; the layers of a stack are mappings of kind and keywords.

    Raises
    ------
    ValueError
        For an unknown kind or an invalid value; errors of a stack name the layer.
    TypeError
        For an unknown keyword.
    """
    check_choice("kind", kind, MEDIUM_CLASSES)
    medium: Medium = (
        _make_stack(keywords) if kind == "stack" else MEDIUM_FACTORIES[kind](**keywords)
    )
    return medium


def iter_layers(key: str, layers: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the key and the settings of every layer of a stack; reject invalid ones.

    Parameters
    ----------
    key : str
        Key of the list of layers.
    layers : list of mapping
    """
    if not isinstance(layers, (list, tuple)) or not layers:
        raise invalid(key, layers, "a list of layers, top first")
    for number, layer in enumerate(layers):
        layer_key = f"{key}.{number}"
        if not isinstance(layer, Mapping):
            raise invalid(layer_key, layer, "a mapping of a medium's keywords")
        yield layer_key, layer


def _make_stack(keywords: Mapping[str, Any]) -> Stack:
    media = []
    for key, layer in iter_layers(LAYERS_KEY, keywords.get(LAYERS_KEY)):
        with key_prefix(key):
            kind = check_choice("kind", get_kind(layer), LAYER_CLASSES)
            settings = {name: value for name, value in layer.items() if name != "kind"}
            if "bottom_albedo" in settings:
                given, hint = settings["bottom_albedo"], "give ground to the stack"
                raise invalid("bottom_albedo", given, "left out in a stack", hint)
            # Below all layers is the stack's ground.
            bottom = {"bottom_albedo": None} if kind == "particle_layer" else {}
            media.append(MEDIUM_FACTORIES[kind](**settings, **bottom))
    return Stack(**{**keywords, LAYERS_KEY: tuple(media)})
