"""Parameters of a medium by name: meaning, listing, reading and replacing.

A name denotes a numeric keyword (``depth_m``, ``liquid_water_content``); a distribution
(``facetness``), which is shifted as a whole; an amount (``impurities_ng_g.black_carbon``); a
fraction of a whole (``partition.coated``), where the other fractions keep their ratios; or one of
these in a layer of a stack (``layers.0.depth_m``).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from numbers import Real
from typing import Any

from splits.core.declarations import Quantity, find_quantity, invert_unit, list_inputs
from splits.core.inputs import Incidence
from splits.core.validation import check_choice, check_range, invalid, suggest_name, unknown_key
from splits.media.ground import Ground
from splits.media.particle_layer import ParticleLayer
from splits.media.sand import Sand
from splits.media.snow import (
    GRAIN_SIZE_RANGE_UM,
    LIQUID_WATER_KEY,
    OPTICAL_RADIUS_KEY,
    SURFACE_AREA_KEY,
    Snow,
)
from splits.media.stack import Stack

# --------------------------------------------------------------------------------------------------
# Meaning of parameters, and of derived quantities that datasets hold as attributes.

MEDIA: tuple[Any, ...] = (Snow, Sand, Stack, ParticleLayer)
ALTERNATIVES: dict[str, str] = {n: key for one in MEDIA for n, key in one.ALTERNATIVES.items()}
"""Keyword replaced by each keyword that computes it."""
INCIDENCE_KEY = "incidence_deg"
DERIVED_QUANTITIES = {
    "absorption_enhancement_900nm_dry": Quantity("absorption enhancement of dry grains at 900 nm"),
    "asymmetry_parameter_900nm_dry": Quantity("asymmetry parameter of dry grains at 900 nm"),
    "extinction_per_m": Quantity("extinction coefficient", "m-1"),
    "mean_grain_distance_m": Quantity("mean distance between grains along a ray", "m"),
}
DEFAULT_SCALE = 0.04
"""Scale of a parameter without one where its value is 0."""
_LAYER_PATTERN = re.compile(r"layers\.(\d+)\.(.+)")


@cache
def list_declared_quantities() -> dict[str, Quantity]:
    """Return the meaning of the inputs of all media, of the light and of derived quantities."""
    quantities: dict[str, Quantity] = {}
    for medium in MEDIA:
        for name, one in list_inputs(medium).items():
            quantities.setdefault(name, one.quantity)
    incidence = find_quantity(Incidence)
    assert incidence is not None
    return {
        **quantities, INCIDENCE_KEY: incidence, "medium": Quantity("sample", label="sample"),
        **DERIVED_QUANTITIES,
    }  # fmt: skip


def get_quantity(key: str) -> Quantity:
    """Return the meaning of a keyword; an unknown one, of a user's function, means its name."""
    return list_declared_quantities().get(key) or Quantity(key.replace("_", " "))


def list_amounts() -> list[str]:
    """Return the keywords that are mappings of amounts by kind."""
    return [name for name, quantity in list_declared_quantities().items() if quantity.kinds]


def parse_layer_parameter(parameter: str) -> tuple[int, str] | None:
    """Return the layer number and the keyword of a path such as layers.0.depth_m, or None."""
    match = _LAYER_PATTERN.fullmatch(parameter)
    return (int(match[1]), match[2]) if match and "." not in match[2] else None


def parse_impurity_parameter(parameter: str) -> tuple[str, str] | None:
    """Return keyword and type of a name such as impurities_ng_g.black_carbon, or None."""
    key, _, kind = parameter.partition(".")
    return (key, kind) if key in list_amounts() and re.fullmatch(r"\w+", kind) else None


def find_whole(parameter: str) -> str:
    """Return the name of the whole that has a parameter as a part, such as partition, or ""."""
    whole = parameter.rpartition(".")[0]
    return whole if get_quantity(whole.rpartition(".")[2]).parts else ""


def check_single_parts(names: Iterable[str]) -> None:
    """Reject several parts of a whole, whose other parts keep their ratios."""
    first: dict[str, str] = {}
    for name in names:
        whole = find_whole(name)
        if whole and first.setdefault(whole, name) != name:
            hint = f"{first[whole]} is given, and the other parts keep their ratios"
            raise invalid(name, "given", "left out", hint)


def describe_parameter(parameter: str) -> tuple[str, str]:
    """Return the long name and units of a parameter, also for the path of one in a layer.

    An unknown parameter, such as one of a user's function, gets its own name.
    """
    match = _LAYER_PATTERN.fullmatch(parameter)
    if match:
        long_name, units = describe_parameter(match[2])
        return f"{long_name}, layer {match[1]}", units
    key, _, kind = parameter.partition(".")
    quantity = get_quantity(key)
    suffix = f": {kind.replace('_', ' ')}" if kind else ""
    return quantity.long_name + suffix, quantity.unit


def get_parameter_quantity(parameter: str) -> Quantity:
    """Return the meaning of the keyword of a parameter, also in a layer."""
    match = _LAYER_PATTERN.fullmatch(parameter)
    return get_quantity((match[2] if match else parameter).partition(".")[0])


def choose_step(parameter: str, value: float, fraction: float) -> float:
    """Return the step of a finite difference over a parameter.

    It is a fraction of the value, or of the scale that the parameter declares if this is larger.
    """
    scale = get_parameter_quantity(parameter).scale
    return fraction * (max(abs(value), scale) or DEFAULT_SCALE)


def get_derivative_unit(name: str) -> str:
    """Return the unit of a derivative with respect to a parameter."""
    return invert_unit(describe_parameter(name)[1])


def override_keywords(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` updated by `overrides`; keywords equivalent to overrides are removed."""
    overridden = {ALTERNATIVES.get(name, name) for name in overrides}
    kept = {n: v for n, v in base.items() if ALTERNATIVES.get(n, n) not in overridden}
    return {**kept, **overrides}


# --------------------------------------------------------------------------------------------------
# Values of parameters.


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
    quantities = {n: one for n, one in list_declared_quantities().items() if n in values}
    parameters = [n for n, v in values.items() if isinstance(v, Real) and not isinstance(v, bool)]
    parameters += [name for name, one in quantities.items() if one.is_distribution]
    parameters += getattr(medium, "ALTERNATIVES", ())
    parameters += [f"{name}.{part}" for name, one in quantities.items() for part in one.parts]
    if _has_constant_albedo(medium):
        parameters.append("ground")
    return parameters + [f"{n}.{one.kinds()[0]}" for n, one in quantities.items() if one.kinds]


def get_parameter(medium: Any, name: str, other_names: Sequence[str] = ()) -> float:
    """Return the value of a parameter, or the mean of a distribution.

    `other_names` are names besides those of the medium that messages list, such as the incidence.

    Raises
    ------
    ValueError
        For a parameter that the medium does not have.
    """
    layer, key, component = _locate_parameter(medium, name, other_names)
    value, quantity = (
        getattr(medium if layer is None else medium.layers[layer], key),
        get_quantity(key),
    )
    if quantity.parts:
        value = value[quantity.parts.index(component)]
    elif component:
        amount = value.get(component, 0.0)
        value = amount["ng_g"] if isinstance(amount, Mapping) else amount
    elif key == "ground":
        value = value.albedo_values[0]
    elif quantity.is_distribution:
        value = quantity.compute_mean(value)
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
        layer, key, component = _locate_parameter(medium, name)
        changes = pending.setdefault(layer, {})
        # A value of a fraction, or of an alternative, depends on other ones that have changed.
        replaced = ALTERNATIVES.get(key)
        unrelated = {*list_amounts(), *ALTERNATIVES.values()} - {replaced}
        is_related = replaced is not None and not changes.keys() <= unrelated
        if changes and (is_related or get_quantity(key).parts):
            layers[layer] = replace(layers[layer], **changes)
            changes.clear()
        changes |= _compute_change(layers[layer], key, component, float(value), changes)
    for layer, changes in pending.items():
        layers[layer] = replace(layers[layer], **changes)
    if len(layers) == 1:
        return layers[None]
    parts = tuple(one for number, one in layers.items() if number is not None)
    return replace(layers[None], layers=parts)


def shift_parameter(medium: Any, name: str, shift: float) -> Any:
    """Return a copy of a medium with a parameter shifted; see `replace_parameter`."""
    return replace_parameter(medium, name, get_parameter(medium, name) + shift)


def _compute_change(
    owner: Any, key: str, component: str, value: float, changes: Mapping[str, Any]
) -> dict[str, Any]:
    """Return new keywords of a medium for a value of a parameter, after other changes."""
    quantity = get_quantity(key)
    if quantity.parts:
        name, fractions = f"{key}.{component}", getattr(owner, key)
        index = quantity.parts.index(component)
        value = check_range(name, value, 0.0, 1.0)
        # The other fractions keep their ratios.
        remainder = sum(fraction for i, fraction in enumerate(fractions) if i != index)
        if remainder == 0.0:
            hint = f"which of the others grows is not known: give {key} with some of each"
            raise invalid(name, value, "below 1 to begin with", hint)
        factor = (1.0 - value) / remainder
        return {key: tuple(value if i == index else factor * x for i, x in enumerate(fractions))}
    if component:
        amounts = dict(changes.get(key, getattr(owner, key)))
        amount = amounts.get(component)
        amounts[component] = {**amount, "ng_g": value} if isinstance(amount, Mapping) else value
        return {key: amounts}
    if quantity.mean is not None and quantity.is_distribution:
        # The last value is a standard deviation.
        old_values, n_shifted = getattr(owner, key), quantity.mean + 1
        shift = value - old_values[quantity.mean]
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
) -> tuple[int | None, str, str]:
    """Return layer (None for the medium itself), keyword and component of a parameter.

    A parameter that the medium does not have raises ValueError.
    """
    if not isinstance(name, str):
        raise invalid("parameter", name, "a name, such as depth_m")
    match = _LAYER_PATTERN.fullmatch(name)
    owner, own_name, layer = medium, name, None
    if isinstance(medium, Stack):
        if name == "ground" and _has_constant_albedo(medium):
            return None, "ground", ""
        if not match or int(match[1]) >= len(medium.layers):
            last = len(medium.layers) - 1
            hint = suggest_name(name, [*list_parameters(medium), *other_names])
            raise invalid("parameter", name, f"of one of layers.0 to layers.{last}", hint)
        layer, own_name, other_names = int(match[1]), match[2], ()
        owner = medium.layers[layer]
    elif match:
        raise invalid("parameter", name, "without layers: this medium is not a stack")
    key, _, component = own_name.partition(".")
    quantity = get_quantity(key)
    if component and quantity.kinds:
        if not hasattr(owner, key):
            raise invalid("parameter", name, "of a medium with impurities: snow")
        if component not in getattr(owner, key):
            check_choice(f"parameter {key}", component, quantity.kinds())
        return layer, key, component
    if quantity.parts and component and hasattr(owner, key):
        check_choice(f"parameter {key}", component, quantity.parts)
        return layer, key, component
    known = list_parameters(owner)
    if own_name not in known:
        raise unknown_key(f"parameter {name}", [*known, *other_names])
    return layer, own_name, ""


def _has_constant_albedo(medium: Any) -> bool:
    """Return whether a medium lies over a ground that is the same at all wavelengths."""
    ground = getattr(medium, "ground", None)
    return isinstance(ground, Ground) and ground.wavelength_nm is None
