"""Parameters of a medium by name: listing, reading and replacing.

A name denotes a numeric keyword (``depth_m``, ``liquid_water_content``); a distribution
(``facetness``), which is shifted as a whole; an amount (``impurities_ng_g.black_carbon``); a
fraction of a whole (``partition.coated``), where the other fractions keep their ratios; or one of
these in a layer of a stack (``layers.0.depth_m``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from numbers import Real
from typing import Any, NamedTuple

from splits.core.parameter_names import IMPURITY_KEYWORDS, describe_parameter
from splits.core.validation import check_choice, check_range, invalid, suggest_name, unknown_key
from splits.materials.impurities import ALGAE_NAMES, list_impurities
from splits.media.ground import Ground
from splits.media.snow import (
    GRAIN_SIZE_RANGE_UM,
    LIQUID_WATER_KEY,
    OPTICAL_RADIUS_KEY,
    SURFACE_AREA_KEY,
)
from splits.media.stack import Stack

SHIFTABLE_DISTRIBUTIONS = {"facetness": 3, "sphericity": 3, "roundness": 1}
"""Distributions, with the number of leading values that a shift moves.

The last value is a standard deviation.
"""
FRACTION_PARAMETERS = {
    "partition": ("pure", "mixed", "coated"),
    "texture": ("clay", "silt", "sand"),
}
"""Fractions that add up to 1, by keyword."""
INCIDENCE_KEY = "incidence_deg"
_LAYER_PATTERN = re.compile(r"layers\.(\d+)\.(.+)")
_DERIVATIVE_UNITS = {
    "impurities_ng_g": "(ng/g)-1", "algae_cells_ml": "ml", "um": "um-1", "m": "m-1",
    "degree": "degree-1", "degC": "degC-1", "kg m-3": "m3 kg-1", "m2 kg-1": "kg m-2",
}  # fmt: skip
"""Units of derivatives, by keyword or by unit of the parameter."""


_UNRELATED = {
    **dict.fromkeys(FRACTION_PARAMETERS, ()),
    **dict.fromkeys((SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY), (*IMPURITY_KEYWORDS, "saturation")),
    LIQUID_WATER_KEY: (*IMPURITY_KEYWORDS, "grain_size_um"),
}
"""Keywords on which parameters do not depend that are computed from other keywords."""


class _ParameterLocation(NamedTuple):
    """Location of a parameter: layer (None for the medium itself), keyword and component."""

    layer: int | None
    key: str
    component: str


def list_parameters(medium: Any) -> list[str]:
    """Return the names of the parameters of a medium, with one example for each amount."""
    if isinstance(medium, Stack):
        names = ["ground"] if _has_constant_albedo(medium) else []
        return names + [
            f"layers.{i}.{n}"
            for i, layer in enumerate(medium.layers)
            for n in list_parameters(layer)
        ]
    values = {f.name: getattr(medium, f.name) for f in fields(medium)}
    parameters = [n for n, v in values.items() if isinstance(v, Real) and not isinstance(v, bool)]
    parameters += [name for name in SHIFTABLE_DISTRIBUTIONS if hasattr(medium, name)]
    parameters += [n for n in getattr(medium, "OTHER_KEYWORDS", ()) if hasattr(medium, n)]
    for key, components in FRACTION_PARAMETERS.items():
        if hasattr(medium, key):
            parameters += [f"{key}.{component}" for component in components]
    if _has_constant_albedo(medium):
        parameters.append("ground")
    examples = {"impurities_ng_g": "black_carbon", "algae_cells_ml": "snow_algae"}
    return parameters + [
        f"{key}.{component}" for key, component in examples.items() if hasattr(medium, key)
    ]


def get_parameter(medium: Any, name: str, other_names: Sequence[str] = ()) -> float:
    """Return the value of a parameter, or the mean of a distribution.

    `other_names` are names besides those of the medium that messages list, such as the incidence.

    Raises
    ------
    ValueError
        For a parameter that the medium does not have.
    """
    location = _locate_parameter(medium, name, other_names)
    owner = medium if location.layer is None else medium.layers[location.layer]
    key, value = location.key, getattr(owner, location.key)
    if key in FRACTION_PARAMETERS:
        value = value[FRACTION_PARAMETERS[key].index(location.component)]
    elif location.component:
        amount = value.get(location.component, 0.0)
        value = amount["ng_g"] if isinstance(amount, Mapping) else amount
    elif key == "ground":
        value = value.albedo_values[0]
    elif key in SHIFTABLE_DISTRIBUTIONS:
        value = value[SHIFTABLE_DISTRIBUTIONS[key] - 1]
    return float(value)


def replace_parameter(medium: Any, name: str, value: float) -> Any:
    """Return a copy of a medium with a new value of a parameter.

    Grain sizes keep their ratio, and distributions keep their width.

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
    return replace_parameters(medium, {name: value})


def replace_parameters(medium: Any, values: Mapping[str, float]) -> Any:
    """Return a copy of a medium with new values of parameters, one after another.

    Parameters and errors are those of `replace_parameter`.  Media are made as rarely as possible,
    as they check all of their values.
    """
    layers = {None: medium} | dict(enumerate(getattr(medium, "layers", ())))
    pending: dict[int | None, dict[str, Any]] = {}
    for name, value in values.items():
        location = _locate_parameter(medium, name)
        layer, key = location.layer, location.key
        changes = pending.setdefault(layer, {})
        if any(other not in _UNRELATED.get(key, (other,)) for other in changes):
            layers[layer] = replace(layers[layer], **changes)
            changes.clear()
        changes |= _compute_change(layers[layer], location, float(value), changes)
    for layer, changes in pending.items():
        layers[layer] = replace(layers[layer], **changes)
    if len(layers) == 1:
        return layers[None]
    parts = tuple(one for number, one in layers.items() if number is not None)
    return replace(layers[None], layers=parts)


def shift_parameter(medium: Any, name: str, shift: float) -> Any:
    """Return a copy of a medium with a parameter shifted; see `replace_parameter`."""
    return replace_parameter(medium, name, get_parameter(medium, name) + shift)


def get_derivative_unit(name: str) -> str:
    """Return the unit of a derivative with respect to a parameter."""
    match = _LAYER_PATTERN.fullmatch(name)
    key = (match[2] if match else name).partition(".")[0]
    return _DERIVATIVE_UNITS.get(key) or _DERIVATIVE_UNITS.get(describe_parameter(key)[1], "1")


def _compute_change(
    owner: Any, location: _ParameterLocation, value: float, changes: Mapping[str, Any]
) -> dict[str, Any]:
    """Return new keywords of a medium for a value of a parameter, after other changes."""
    key = location.key
    if key in FRACTION_PARAMETERS:
        name, fractions = f"{key}.{location.component}", getattr(owner, key)
        index = FRACTION_PARAMETERS[key].index(location.component)
        value = check_range(name, value, 0.0, 1.0)
        # The other fractions keep their ratios.
        remainder = sum(fraction for i, fraction in enumerate(fractions) if i != index)
        if remainder == 0.0:
            hint = f"which of the others grows is not known: give {key} with some of each"
            raise invalid(name, value, "below 1 to begin with", hint)
        factor = (1.0 - value) / remainder
        return {key: tuple(value if i == index else factor * x for i, x in enumerate(fractions))}
    if location.component:
        amounts = dict(changes.get(key, getattr(owner, key)))
        amount = amounts.get(location.component)
        amounts[location.component] = (
            {**amount, "ng_g": value} if isinstance(amount, Mapping) else value
        )
        return {key: amounts}
    if key in SHIFTABLE_DISTRIBUTIONS:
        old_values = getattr(owner, key)
        n_shifted = SHIFTABLE_DISTRIBUTIONS[key]
        shift = value - old_values[n_shifted - 1]
        return {key: (*(x + shift for x in old_values[:n_shifted]), *old_values[n_shifted:])}
    if key in (SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY):
        (low, high), (smallest, largest) = GRAIN_SIZE_RANGE_UM, owner.grain_size_um
        old = getattr(owner, key)
        # Size is proportional to radius, and inversely proportional to surface area.
        if key == OPTICAL_RADIUS_KEY:
            limits = old * low / smallest, old * high / largest
            factor = check_range(key, value, *limits, "µm") / old
        else:
            limits = old * largest / high, old * smallest / low
            factor = old / check_range(key, value, *limits, "m2/kg")
        return {"grain_size_um": tuple(factor * x for x in owner.grain_size_um)}
    if key == LIQUID_WATER_KEY:
        return {"saturation": value / owner.porosity}
    return {key: value}


def _locate_parameter(
    medium: Any, name: Any, other_names: Sequence[str] = ()
) -> _ParameterLocation:
    """Return the location of a parameter; raise ValueError if the medium does not have it."""
    if not isinstance(name, str):
        raise invalid("parameter", name, "a name, such as depth_m")
    match = _LAYER_PATTERN.fullmatch(name)
    owner, own_name, layer = medium, name, None
    if isinstance(medium, Stack):
        if name == "ground" and _has_constant_albedo(medium):
            return _ParameterLocation(None, "ground", "")
        if not match or int(match[1]) >= len(medium.layers):
            last = len(medium.layers) - 1
            hint = suggest_name(name, [*list_parameters(medium), *other_names])
            raise invalid("parameter", name, f"of one of layers.0 to layers.{last}", hint)
        layer, own_name, other_names = int(match[1]), match[2], ()
        owner = medium.layers[layer]
    elif match:
        raise invalid("parameter", name, "without layers: this medium is not a stack")
    key, _, component = own_name.partition(".")
    if component and key in IMPURITY_KEYWORDS:
        if not hasattr(owner, key):
            raise invalid("parameter", name, "of a medium with impurities: snow")
        if component not in getattr(owner, key):
            kinds = ALGAE_NAMES if key == "algae_cells_ml" else list_impurities()
            check_choice(f"parameter {key}", component, kinds)
        return _ParameterLocation(layer, key, component)
    if key in FRACTION_PARAMETERS and component and hasattr(owner, key):
        check_choice(f"parameter {key}", component, FRACTION_PARAMETERS[key])
        return _ParameterLocation(layer, key, component)
    known = list_parameters(owner)
    if own_name not in known:
        raise unknown_key(f"parameter {name}", [*known, *other_names])
    return _ParameterLocation(layer, own_name, "")


def _has_constant_albedo(medium: Any) -> bool:
    """Return whether a medium lies over a ground that is the same at all wavelengths."""
    ground = getattr(medium, "ground", None)
    return isinstance(ground, Ground) and ground.wavelength_nm is None
