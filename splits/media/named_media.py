"""Named media of the package, in the files ``named/NAME.toml``, and media in files of users."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from splits.core.keywords import reject_unknown_arguments
from splits.core.optional import import_optional
from splits.core.paths import expand_path
from splits.core.validation import check_choice
from splits.media.kinds import get_kind, make_medium
from splits.media.measured_inputs import override_keywords
from splits.media.medium import Medium
from splits.media.suggestions import NAMED_MEDIA, NAMED_MEDIA_FOLDER

DOCUMENTATION_KEYS = ("description", "source")
"""Keys of the files of named media that are not keywords of a medium."""


def list_media() -> dict[str, str]:
    """Return the named media with a description of each.

    Examples
    --------
    >>> import splits
    >>> splits.list_media()["red_dune"]
    'Red dune sand, coloured by hematite'
    """
    return {name: _read_named_file(name)["description"] for name in NAMED_MEDIA}


@reject_unknown_arguments
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
    content = _read_yaml_file(name) if _is_yaml_file(name) else read_named_medium(name)
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
    return {key: value for key, value in content.items() if key not in DOCUMENTATION_KEYS}


def _read_named_file(name: str) -> dict[str, Any]:
    return tomllib.loads((NAMED_MEDIA_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))


def _is_yaml_file(name: object) -> bool:
    return isinstance(name, str | Path) and str(name).endswith((".yaml", ".yml"))


def _read_yaml_file(path: str | Path) -> dict[str, Any]:
    import_optional("ruamel.yaml", "experiments", "medium files need")
    from splits.core.yaml import read_yaml

    return read_yaml(expand_path(path, "name"))
