"""Parameters of a medium by name: what they are, and the medium with other ones.

A name is a keyword whose value is a number (``depth_m``, ``liquid_water_content``), one whose value
is a distribution (``facetness``), which moves as a whole, an amount
(``impurities_ng_g.black_carbon``), a share of a whole (``partition.coated``), beside which the
others keep their ratios, or one of these in a layer of a stack (``layers.0.depth_m``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, replace
from numbers import Real
from typing import Any, NamedTuple

from splits.core.parameter_names import IMPURITY_KEYWORDS, describe_parameter
from splits.core.validation import check_choice, check_range, invalid, unknown_key
from splits.materials.impurities import ALGAE_NAMES, list_impurities
from splits.media.ground import Ground
from splits.media.measured_inputs import LIQUID_WATER_KEY, OPTICAL_RADIUS_KEY, SURFACE_AREA_KEY
from splits.media.stack import Stack

SHIFTABLE_DISTRIBUTIONS = {"facetness": 3, "sphericity": 3, "roundness": 1}
"""Distributions, and how many of their first numbers move: the last is a standard deviation."""
FRACTION_PARAMETERS = {
    "partition": ("pure", "mixed", "coated"),
    "texture": ("clay", "silt", "sand"),
}
"""Shares that add up to 1."""
INCIDENCE_KEY = "incidence_deg"
_LAYER_PATTERN = re.compile(r"layers\.(\d+)\.(.+)")
_DERIVATIVE_UNITS = {
    "impurities_ng_g": "(ng/g)-1", "algae_cells_ml": "ml", "um": "um-1", "m": "m-1",
    "degree": "degree-1", "degC": "degC-1", "kg m-3": "m3 kg-1", "m2 kg-1": "kg m-2",
}  # fmt: skip
"""Units of derivatives, by keyword or by the unit of the parameter."""


class _ParameterLocation(NamedTuple):
    """Where a parameter is: of which layer, or of the medium; its keyword; its kind if any."""

    layer: int | None
    key: str
    component: str


def list_parameters(medium: Any) -> list[str]:
    """Return the parameters that a medium has, of each sort of amounts one kind."""
    if isinstance(medium, Stack):
        own = ["ground"] if _get_constant_albedo(medium) is not None else []
        return own + [
            f"layers.{i}.{n}" for i, one in enumerate(medium.layers) for n in list_parameters(one)
        ]
    found = [f.name for f in fields(medium) if _is_number(getattr(medium, f.name))]
    found += [name for name in SHIFTABLE_DISTRIBUTIONS if hasattr(medium, name)]
    found += [n for n in getattr(medium, "OTHER_KEYWORDS", ()) if hasattr(medium, n)]
    for key, kinds_of in FRACTION_PARAMETERS.items():
        if hasattr(medium, key):
            found += [f"{key}.{kind}" for kind in kinds_of]
    if _get_constant_albedo(medium) is not None:
        found.append("ground")
    examples = {"impurities_ng_g": "black_carbon", "algae_cells_ml": "snow_algae"}
    return found + [f"{key}.{kind}" for key, kind in examples.items() if hasattr(medium, key)]


def get_parameter(medium: Any, name: str) -> float:
    """Return the value of a parameter; of a distribution, its mean.

    Raises
    ------
    ValueError
        For a parameter that the medium does not have.
    """
    place = _locate_parameter(medium, name)
    owner = medium if place.layer is None else medium.layers[place.layer]
    if place.key in FRACTION_PARAMETERS:
        return float(
            getattr(owner, place.key)[FRACTION_PARAMETERS[place.key].index(place.component)]
        )
    if place.component:
        given = getattr(owner, place.key).get(place.component, 0.0)
        return float(given["ng_g"] if isinstance(given, Mapping) else given)
    if place.key == "ground":
        return float(owner.ground.albedo_values[0])
    value = getattr(owner, place.key)
    return float(
        value[SHIFTABLE_DISTRIBUTIONS[place.key] - 1]
        if place.key in SHIFTABLE_DISTRIBUTIONS
        else value
    )


def replace_parameter(medium: Any, name: str, value: float) -> Any:
    """Return a medium with another value of a parameter.

    Sizes keep the ratio that they have, and distributions their width.

    Parameters
    ----------
    medium : Snow, Sand, ParticleLayer or Stack
    name : str
    value : float

    Raises
    ------
    ValueError
        For a parameter that the medium does not have, or a value outside its range.
    """
    place = _locate_parameter(medium, name)
    if place.layer is None:
        return _replace_value(medium, place, float(value))
    layers = list(medium.layers)
    layers[place.layer] = _replace_value(layers[place.layer], place, float(value))
    return replace(medium, layers=tuple(layers))


def shift_parameter(medium: Any, name: str, shift: float) -> Any:
    """Return a medium with a parameter moved by so much, see `replace_parameter`."""
    return replace_parameter(medium, name, get_parameter(medium, name) + shift)


def get_derivative_unit(name: str) -> str:
    """Return the unit of a derivative to a parameter."""
    found = _LAYER_PATTERN.fullmatch(name)
    key = (found[2] if found else name).partition(".")[0]
    return _DERIVATIVE_UNITS.get(key) or _DERIVATIVE_UNITS.get(describe_parameter(key)[1], "1")


def _replace_value(owner: Any, location: _ParameterLocation, value: float) -> Any:
    key = location.key
    if key in FRACTION_PARAMETERS:
        return replace(owner, **{key: _rescale_fractions(owner, location, value)})
    if location.component:
        amounts = dict(getattr(owner, key))
        given = amounts.get(location.component)
        amounts[location.component] = (
            {**given, "ng_g": value} if isinstance(given, Mapping) else value
        )
        return replace(owner, **{key: amounts})
    if key in SHIFTABLE_DISTRIBUTIONS:
        before = getattr(owner, key)
        count = SHIFTABLE_DISTRIBUTIONS[key]
        by = value - before[count - 1]
        return replace(owner, **{key: (*(x + by for x in before[:count]), *before[count:])})
    if key in (SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY):
        if not 0.0 < value < float("inf"):
            raise invalid(key, value, "above 0")
        ratio = value / getattr(owner, key)
        factor = ratio if key == OPTICAL_RADIUS_KEY else 1.0 / ratio
        return replace(owner, grain_size_um=tuple(factor * x for x in owner.grain_size_um))
    if key == LIQUID_WATER_KEY:
        return replace(owner, saturation=value / owner.porosity)
    return replace(owner, **{key: value})


def _rescale_fractions(owner: Any, location: _ParameterLocation, value: float) -> tuple[float, ...]:
    """Return shares of which one has a value, and the others what is left in their ratios."""
    before, which = (
        getattr(owner, location.key),
        FRACTION_PARAMETERS[location.key].index(location.component),
    )
    value = check_range(f"{location.key}.{location.component}", value, 0.0, 1.0)
    rest = sum(share for i, share in enumerate(before) if i != which)
    if rest == 0.0:
        hint = f"which of the others grows is not known: give {location.key} with some of each"
        raise invalid(f"{location.key}.{location.component}", value, "below 1 to begin with", hint)
    factor = (1.0 - value) / rest
    return tuple(value if i == which else factor * share for i, share in enumerate(before))


def _locate_parameter(medium: Any, name: Any) -> _ParameterLocation:
    """Return where a parameter is, or refuse one that the medium does not have."""
    if not isinstance(name, str):
        raise invalid("parameter", name, "a name, such as depth_m")
    found = _LAYER_PATTERN.fullmatch(name)
    if not isinstance(medium, Stack):
        if found:
            raise invalid("parameter", name, "without layers: this medium is no stack")
        return _locate_own_parameter(medium, name, name, None)
    if name == "ground" and _get_constant_albedo(medium) is not None:
        return _ParameterLocation(None, "ground", "")
    number = int(found[1]) if found else -1
    if not found or not 0 <= number < len(medium.layers):
        last = len(medium.layers) - 1
        raise invalid("parameter", name, f"of one of layers.0 to layers.{last}")
    return _locate_own_parameter(medium.layers[number], found[2], name, number)


def _locate_own_parameter(
    owner: Any, own_name: str, name: str, layer: int | None
) -> _ParameterLocation:
    """Return where a parameter of a medium without layers is."""
    key, _, kind = own_name.partition(".")
    if kind and key in IMPURITY_KEYWORDS:
        if not hasattr(owner, key):
            raise invalid("parameter", name, "of a medium that takes impurities: snow")
        if kind not in getattr(owner, key):
            check_choice(
                f"parameter {key}",
                kind,
                ALGAE_NAMES if key == "algae_cells_ml" else list_impurities(),
            )
        return _ParameterLocation(layer, key, kind)
    if key in FRACTION_PARAMETERS and kind and hasattr(owner, key):
        return _ParameterLocation(
            layer, key, check_choice(f"parameter {key}", kind, FRACTION_PARAMETERS[key])
        )
    known = list_parameters(owner)
    if own_name not in known:
        raise unknown_key(f"parameter {name}", known)
    return _ParameterLocation(layer, own_name, "")


def _get_constant_albedo(medium: Any) -> float | None:
    """Return the albedo of a ground that is the same at all wavelengths, else None."""
    ground = getattr(medium, "ground", None)
    if not isinstance(ground, Ground) or ground.wavelength_nm is not None:
        return None
    return float(ground.albedo_values[0])


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
