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

from splits.core.validation import check_range, invalid
from splits.materials import ice_density
from splits.media.formatting import count_digits

Kind = TypeVar("Kind")

SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY, LIQUID_WATER_KEY = (
    "specific_surface_area_m2_kg",
    "optical_radius_um",
    "liquid_water_content",
)
REPLACED_FIELDS = {
    SURFACE_AREA_KEY: "grain_size_um",
    OPTICAL_RADIUS_KEY: "grain_size_um",
    LIQUID_WATER_KEY: "saturation",
}
"""Keywords that may be given in place of a field, by name."""
MIN_SURFACE_AREA_M2_KG, MAX_SURFACE_AREA_M2_KG = 0.2, 2000.0
"""Limits of specific surface area (m²/kg): grains of some centimetres and of a micrometre."""


def accepts_measured_inputs(kind: type[Kind]) -> type[Kind]:
    """Let a dataclass of snow take `REPLACED_FIELDS` among its keywords."""
    construct: Callable[..., None] = kind.__init__  # type: ignore[misc]

    @wraps(construct)
    def measured(self: Any, *values: Any, **keywords: Any) -> None:
        keywords = {k: v for k, v in keywords.items() if k not in REPLACED_FIELDS or v is not None}
        if any(name in keywords for name in REPLACED_FIELDS):
            names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
            keywords = {**dict(zip(names, values, strict=False)), **keywords}
            values = ()
            check_no_equivalents(keywords)
            keywords = to_model_keywords(kind, keywords)
        construct(self, *values, **keywords)

    own = signature(construct)
    others = [Parameter(n, Parameter.KEYWORD_ONLY, default=None, annotation="float | None")
              for n in REPLACED_FIELDS]  # fmt: skip
    whole = own.replace(parameters=[*own.parameters.values(), *others])
    measured.__signature__ = whole  # type: ignore[attr-defined]
    kind.__init__ = measured  # type: ignore[method-assign,misc]
    kind.OTHER_KEYWORDS = tuple(REPLACED_FIELDS)  # type: ignore[attr-defined]
    return kind


def override_keywords(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords on top of others, of which those go that are said in other words."""
    said = {REPLACED_FIELDS.get(name, name) for name in overrides}
    kept = {name: v for name, v in base.items() if REPLACED_FIELDS.get(name, name) not in said}
    return {**kept, **overrides}


def check_no_equivalents(keywords: dict[str, Any]) -> None:
    """Refuse two keywords, or parameters of one layer, that say the same."""
    taken: dict[str, str] = {}
    for name, value in keywords.items():
        layer, _, own = name.rpartition(".")
        field = f"{layer}.{REPLACED_FIELDS.get(own, own)}"
        if field in taken:
            raise invalid(
                name, value, f"left out where {taken[field]} is given", "they say the same"
            )
        taken[field] = name


def to_model_keywords(kind: Callable[..., Any], keywords: dict[str, Any]) -> dict[str, Any]:
    """Return keywords with sizes and saturation in place of what was measured.

    Sizes keep the ratio of those that the kind has by default: surface area goes as one over size.
    """
    rest = {name: value for name, value in keywords.items() if name not in REPLACED_FIELDS}
    plain = kind(**rest)
    if LIQUID_WATER_KEY in keywords:
        water = check_range(
            LIQUID_WATER_KEY, keywords[LIQUID_WATER_KEY], 0.0, plain.porosity,
            hint="volume of water per volume of snow, at most that of its pores",
        )  # fmt: skip
        rest["saturation"] = water / plain.porosity
    if SURFACE_AREA_KEY in keywords or OPTICAL_RADIUS_KEY in keywords:
        if SURFACE_AREA_KEY in keywords:
            hint = "m2/kg: fresh snow has some 60, old snow 10, melting snow 3"
            area = check_range(
                SURFACE_AREA_KEY,
                keywords[SURFACE_AREA_KEY],
                MIN_SURFACE_AREA_M2_KG,
                MAX_SURFACE_AREA_M2_KG,
                hint=hint,
            )
        else:
            area = _convert_radius_to_area(keywords[OPTICAL_RADIUS_KEY], plain.temperature_c)
        factor = plain.specific_surface_area_m2_kg / area
        rest["grain_size_um"] = tuple(factor * size for size in plain.grain_size_um)
    return rest


def to_shortest_keywords(snow: Any, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return inputs of snow with what they stand for in the words that need the fewest digits.

    Sizes in the ratio that they have by default stand for a surface area or a radius, as well.
    """
    found = dict(inputs)
    usual = type(snow)().grain_size_um
    ratios = [largest / smallest for smallest, largest in (snow.grain_size_um, usual)]
    scaled = abs(ratios[0] / ratios[1] - 1.0) < 1e-9
    for field, measured in (
        ("grain_size_um", (SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY)),
        ("saturation", (LIQUID_WATER_KEY,)),
    ):
        if field in inputs and (scaled or field != "grain_size_um"):
            words = sorted((*measured, field), key=lambda name: count_digits(getattr(snow, name)))
            del found[field]
            found = {words[0]: getattr(snow, words[0]), **found}
    return found


def _convert_radius_to_area(radius_um: Any, temperature_c: float) -> float:
    """Return the specific surface area (m²/kg) of spheres of a radius, 3/(ρ_ice r)."""
    ice = ice_density(temperature_c)
    least, most = (3e6 / (ice * area) for area in (MAX_SURFACE_AREA_M2_KG, MIN_SURFACE_AREA_M2_KG))
    radius = check_range(OPTICAL_RADIUS_KEY, radius_um, least, most, "µm")
    return 3e6 / (ice * radius)
