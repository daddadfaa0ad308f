"""Kinds of media: construction of a medium from its kind and keywords."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from splits.core.keywords import declare_function
from splits.core.optional import import_optional
from splits.core.validation import check_choice, expand_path, format_limit, invalid, key_prefix
from splits.media.formatting import NAMED_MEDIA, NAMED_MEDIA_FOLDER, suggest_medium
from splits.media.medium import Medium
from splits.media.parameters import MEDIA, override_keywords
from splits.media.particle_layer import ParticleLayer
from splits.media.sand import Sand
from splits.media.snow import Snow
from splits.media.snow_packs import SnowPacks
from splits.media.stack import Stack

# --------------------------------------------------------------------------------------------------
# Checks of media that users give to instruments.


def list_media_names(kind: type[Any] = Medium) -> list[str]:
    """Return the names of the media of a class, for messages."""
    return [one.__name__ for one in MEDIA if issubclass(one, kind)]


def check_medium(
    medium: Any, kind: type[Any] = Medium, *, allow_semi_infinite: bool = False,
    key: str = "medium",
) -> None:  # fmt: skip
    """Check that a medium is of an allowed class, by default of any.

    Parameters
    ----------
    medium : object
    kind : type
        Base class of the allowed media.
    allow_semi_infinite : bool
        Whether infinite layers of grains are allowed; those of particles always are.
    key : str
        Key in error messages.
    """
    if isinstance(medium, kind):
        largest = medium.largest_grain_m
        if medium.depth_m <= largest:
            hint = "such a grain must fit between the boundaries"
            allowed = f"more than the largest grain, {format_limit(largest, medium.depth_m)} m"
            raise invalid("depth_m", medium.depth_m, allowed, hint)
        is_traceable = not (medium.is_semi_infinite and medium.lowest_layer.has_grains)
        if not (is_traceable or allow_semi_infinite):
            hint = (
                "give depth_m; infinite depth is for estimator spectral, albedos, profiles and "
                "delays, and with solver discrete_ordinates (natural snow, point grains) for BRDFs "
                "and HDRFs"
            )
            raise invalid("depth_m", math.inf, "finite", hint)
        return
    names = list_media_names(kind)
    if isinstance(medium, SnowPacks):
        more = "" if kind is Medium else ", and its layers are media"
        hint = f"packs.make_stack(label) returns one of the snowpacks{more}"
        raise invalid(key, medium, "one medium", hint)
    kind_name = medium if callable(medium) else getattr(medium, "kind", medium)
    allowed = " or ".join(f"splits.{name}(...)" for name in names)
    raise invalid(key, kind_name, allowed, suggest_medium(medium, names))


# --------------------------------------------------------------------------------------------------
# Kinds of media: construction of a medium from its kind and keywords.

LAYERS_KEY = "layers"
MEDIUM_CLASSES: dict[str, Any] = {
    "snow": Snow,
    "natural_snow": Snow,
    "sand": Sand,
    "particle_layer": ParticleLayer,
    "stack": Stack,
}
LAYER_KINDS = [kind for kind, one in MEDIUM_CLASSES.items() if one is not Stack]
"""Kinds of the media that a stack may hold."""
MEDIUM_FACTORIES: dict[str, Callable[..., Medium]] = MEDIUM_CLASSES | {"natural_snow": Snow.natural}
"""Functions that make a medium from its keywords, by kind."""


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
    if kind in LAYER_KINDS:
        return MEDIUM_FACTORIES[kind](**keywords)
    media = []
    for key, layer in iter_layers(LAYERS_KEY, keywords.get(LAYERS_KEY)):
        with key_prefix(key):
            kind = check_choice("kind", get_kind(layer), LAYER_KINDS)
            settings = {name: value for name, value in layer.items() if name != "kind"}
            media.append(make_medium(kind, settings))
    return Stack(**{**keywords, LAYERS_KEY: tuple(media)})


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


# --------------------------------------------------------------------------------------------------
# Named media of the package, in the files ``named/NAME.toml``, and media in files of users.


def list_media() -> dict[str, str]:
    """Return the named media with a description of each.

    Examples
    --------
    >>> import splits
    >>> splits.list_media()["red_dune"]
    'Red dune sand, coloured by hematite'
    """
    return {name: _read_named_file(name)["description"] for name in NAMED_MEDIA}


@declare_function
def load_medium(name: str | Path, **keywords: Any) -> Medium:
    """Return a named medium, or the medium of a YAML file.

    Parameters
    ----------
    name : str or path
        Name of a medium, see `splits.list_media`, or path of a file that ends in ``.yaml`` or
        ``.yml``, as for ``medium: {base: NAME}`` in experiments: ``kind``, by default snow, and
        keywords of that kind.  A YAML file requires the extra ``experiments``.
    **keywords
        Keywords of the medium that replace those of its file.

    Raises
    ------
    ValueError
        For an unknown name, an invalid file, or a value outside its range.
    TypeError
        For an unknown keyword.

    Examples
    --------
    >>> import splits
    >>> splits.load_medium("wet_beach").saturation
    0.9
    >>> splits.load_medium("wet_beach", saturation=0).saturation
    0.0
    """
    if isinstance(name, str | Path) and str(name).endswith((".yaml", ".yml")):
        import_optional("yaml", "experiments", "medium files need")
        from splits.core.yaml import read_yaml

        content = read_yaml(expand_path(name, "name"))
    else:
        content = read_named_medium(name)
    kind = get_kind(content)
    settings = {key: value for key, value in content.items() if key != "kind"}
    return make_medium(kind, override_keywords(settings, keywords))


def read_named_medium(name: Any) -> dict[str, Any]:
    """Return the kind and the keywords of a named medium.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    content = _read_named_file(check_choice("name", name, NAMED_MEDIA))
    # The others are not keywords of a medium.
    return {key: value for key, value in content.items() if key not in ("description", "source")}


def _read_named_file(name: str) -> dict[str, Any]:
    return tomllib.loads((NAMED_MEDIA_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
