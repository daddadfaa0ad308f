"""Parameters of a medium by name, as derivatives take them: what absorbs, and how much of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from splits.checks import one_of, refuse, under
from splits.materials.impurities import ALGAE, kinds
from splits.media.stack import Stack

AMOUNTS = {"impurities_ng_g": "(ng/g)-1", "algae_cells_ml": "ml"}
"""Keywords that are mappings of amounts, and the unit of a derivative to one."""
_PATH = re.compile(r"(?:layers\.(?P<layer>\d+)\.)?(?P<key>\w+)\.(?P<name>.+)")


def moved(medium: Any, parameter: str, by: float) -> Any:
    """Return a medium with a parameter moved.

    Parameters
    ----------
    medium : GranularMedium or Stack
    parameter : str
        Such as ``impurities_ng_g.black_carbon``, ``algae_cells_ml.snow_algae``, or with
        ``layers.0.`` before it, that of a stack's layer.
    by : float

    Raises
    ------
    ValueError
        For a parameter that the medium does not have.
    """
    found = _PATH.fullmatch(parameter) if isinstance(parameter, str) else None
    if found is None or found["key"] not in AMOUNTS:
        allowed = "a kind of impurity or of algae"
        raise refuse("jacobian", parameter, allowed, "such as impurities_ng_g.black_carbon")
    key, name = found["key"], found["name"]
    if not isinstance(medium, Stack):
        if found["layer"] is not None:
            raise refuse("jacobian", parameter, "without layers: this medium is no stack")
        return _more(medium, parameter, key, name, by)
    number = -1 if found["layer"] is None else int(found["layer"])
    if not 0 <= number < len(medium.layers):
        last = len(medium.layers) - 1
        raise refuse("jacobian", parameter, f"of one of layers.0 to layers.{last}")
    layers: list[Any] = list(medium.layers)
    with under(f"layers.{number}"):
        layers[number] = _more(layers[number], parameter, key, name, by)
    return replace(medium, layers=tuple(layers))


def unit_of(parameter: str) -> str:
    """Return the unit of a derivative to a parameter."""
    found = _PATH.fullmatch(parameter)
    return AMOUNTS[found["key"]] if found else "1"


def _more(medium: Any, parameter: str, key: str, name: str, by: float) -> Any:
    if not hasattr(medium, key):
        raise refuse("jacobian", parameter, "of a medium that takes impurities: snow")
    amounts = dict(getattr(medium, key))
    if name not in amounts:
        one_of(f"jacobian: {key}", name, ALGAE if key == "algae_cells_ml" else kinds())
    given = amounts.get(name, 0.0)
    own = isinstance(given, Mapping)
    amount = (given["ng_g"] if own else given) + by
    amounts[name] = {**given, "ng_g": amount} if own else amount
    return replace(medium, **{key: amounts})
