"""What people measure of snow, in place of what the model is given: surface area, radius, water.

Specific surface area scales the range of grain sizes as a whole; the amount of water is told per
volume of snow instead of per volume of pores.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import wraps
from inspect import Parameter, signature
from typing import Any, TypeVar

from splits.checks import in_range, refuse
from splits.materials import ice_density
from splits.media.words import digits

Kind = TypeVar("Kind")

AREA, RADIUS, WATER = "specific_surface_area_m2_kg", "optical_radius_um", "liquid_water_content"
REPLACES = {AREA: "grain_size_um", RADIUS: "grain_size_um", WATER: "saturation"}
"""Keywords that may be given in place of a field, by name."""
LEAST_AREA, MOST_AREA = 0.2, 2000.0
"""Limits of specific surface area (m²/kg): grains of some centimetres and of a micrometre."""


def takes_measured(kind: type[Kind]) -> type[Kind]:
    """Let a dataclass of snow take `REPLACES` among its keywords."""
    construct: Callable[..., None] = kind.__init__  # type: ignore[misc]

    @wraps(construct)
    def measured(self: Any, *values: Any, **keywords: Any) -> None:
        keywords = {k: v for k, v in keywords.items() if k not in REPLACES or v is not None}
        if any(name in keywords for name in REPLACES):
            names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
            keywords = {**dict(zip(names, values, strict=False)), **keywords}
            values = ()
            check_one_of_each(keywords)
            keywords = in_own_words(kind, keywords)
        construct(self, *values, **keywords)

    own = signature(construct)
    others = [Parameter(n, Parameter.KEYWORD_ONLY, default=None, annotation="float | None")
              for n in REPLACES]  # fmt: skip
    whole = own.replace(parameters=[*own.parameters.values(), *others])
    measured.__signature__ = whole  # type: ignore[attr-defined]
    kind.__init__ = measured  # type: ignore[method-assign,misc]
    kind.OTHER_KEYWORDS = tuple(REPLACES)  # type: ignore[attr-defined]
    return kind


def on_top(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords on top of others, of which those go that are said in other words."""
    said = {REPLACES.get(name, name) for name in overrides}
    kept = {name: v for name, v in base.items() if REPLACES.get(name, name) not in said}
    return {**kept, **overrides}


def check_one_of_each(keywords: dict[str, Any]) -> None:
    """Refuse two keywords, or parameters of one layer, that say the same."""
    taken: dict[str, str] = {}
    for name, value in keywords.items():
        layer, _, own = name.rpartition(".")
        field = f"{layer}.{REPLACES.get(own, own)}"
        if field in taken:
            raise refuse(
                name, value, f"left out where {taken[field]} is given", "they say the same"
            )
        taken[field] = name


def in_own_words(kind: Callable[..., Any], keywords: dict[str, Any]) -> dict[str, Any]:
    """Return keywords with sizes and saturation in place of what was measured.

    Sizes keep the ratio of those that the kind has by default: surface area goes as one over size.
    """
    rest = {name: value for name, value in keywords.items() if name not in REPLACES}
    plain = kind(**rest)
    if WATER in keywords:
        water = in_range(
            WATER, keywords[WATER], 0.0, plain.porosity,
            hint="volume of water per volume of snow, at most that of its pores",
        )  # fmt: skip
        rest["saturation"] = water / plain.porosity
    if AREA in keywords or RADIUS in keywords:
        if AREA in keywords:
            hint = "m2/kg: fresh snow has some 60, old snow 10, melting snow 3"
            area = in_range(AREA, keywords[AREA], LEAST_AREA, MOST_AREA, hint=hint)
        else:
            area = _area_of(keywords[RADIUS], plain.temperature_c)
        factor = plain.specific_surface_area_m2_kg / area
        rest["grain_size_um"] = tuple(factor * size for size in plain.grain_size_um)
    return rest


def in_words_of_input(snow: Any, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return inputs of snow with what they stand for in the words that need the fewest digits.

    Sizes in the ratio that they have by default stand for a surface area or a radius, as well.
    """
    found = dict(inputs)
    usual = type(snow)().grain_size_um
    ratios = [largest / smallest for smallest, largest in (snow.grain_size_um, usual)]
    scaled = abs(ratios[0] / ratios[1] - 1.0) < 1e-9
    for field, measured in (("grain_size_um", (AREA, RADIUS)), ("saturation", (WATER,))):
        if field in inputs and (scaled or field != "grain_size_um"):
            words = sorted((*measured, field), key=lambda name: digits(getattr(snow, name)))
            del found[field]
            found = {words[0]: getattr(snow, words[0]), **found}
    return found


def _area_of(radius_um: Any, temperature_c: float) -> float:
    """Return the specific surface area (m²/kg) of spheres of a radius, 3/(ρ_ice r)."""
    ice = ice_density(temperature_c)
    least, most = (3e6 / (ice * area) for area in (MOST_AREA, LEAST_AREA))
    radius = in_range(RADIUS, radius_um, least, most, "µm")
    return 3e6 / (ice * radius)
