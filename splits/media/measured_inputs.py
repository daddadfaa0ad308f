"""Measured quantities that replace model parameters: surface area, optical radius, water content.

Specific surface area scales the range of grain sizes; liquid water content is the volume of water
per volume of snow, in place of saturation.
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
"""Field replaced by each keyword."""
GRAIN_SIZE_RANGE_UM = (1.0, 1e5)
"""Limits of the sizes of grains (µm)."""
MIN_SURFACE_AREA_M2_KG, MAX_SURFACE_AREA_M2_KG = 0.2, 2000.0
"""Limits of specific surface area (m²/kg): grains of a few cm and of a few µm."""


def accepts_measured_inputs(kind: type[Kind]) -> type[Kind]:
    """Add `REPLACED_FIELDS` to the keywords of a snow dataclass."""
    construct: Callable[..., None] = kind.__init__  # type: ignore[misc]

    @wraps(construct)
    def construct_measured(self: Any, *values: Any, **keywords: Any) -> None:
        keywords = {k: v for k, v in keywords.items() if k not in REPLACED_FIELDS or v is not None}
        if any(name in keywords for name in REPLACED_FIELDS):
            names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
            keywords = {**dict(zip(names, values, strict=False)), **keywords}
            values = ()
            check_no_equivalents(keywords)
            keywords = to_model_keywords(kind, keywords)
        construct(self, *values, **keywords)

    own_signature = signature(construct)
    extras = [Parameter(n, Parameter.KEYWORD_ONLY, default=None, annotation="float | None")
              for n in REPLACED_FIELDS]  # fmt: skip
    full_signature = own_signature.replace(parameters=[*own_signature.parameters.values(), *extras])
    construct_measured.__signature__ = full_signature  # type: ignore[attr-defined]
    kind.__init__ = construct_measured  # type: ignore[method-assign,misc]
    kind.OTHER_KEYWORDS = tuple(REPLACED_FIELDS)  # type: ignore[attr-defined]
    return kind


def override_keywords(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` updated by `overrides`; keywords equivalent to overrides are removed."""
    overridden = {REPLACED_FIELDS.get(name, name) for name in overrides}
    remaining = {
        name: v for name, v in base.items() if REPLACED_FIELDS.get(name, name) not in overridden
    }
    return {**remaining, **overrides}


def check_no_equivalents(keywords: dict[str, Any]) -> None:
    """Check that no two keywords, or parameters of a layer, set the same field."""
    seen: dict[str, str] = {}
    for name, value in keywords.items():
        layer, _, own_name = name.rpartition(".")
        field = f"{layer}.{REPLACED_FIELDS.get(own_name, own_name)}"
        if field in seen:
            raise invalid(
                name, value, f"left out where {seen[field]} is given", "they set the same field"
            )
        seen[field] = name


def to_model_keywords(kind: Callable[..., Any], keywords: dict[str, Any]) -> dict[str, Any]:
    """Return keywords with grain size and saturation in place of measured quantities.

    Specific surface area is inversely proportional to size; sizes keep the ratio of the defaults.
    """
    model_keywords = {
        name: value for name, value in keywords.items() if name not in REPLACED_FIELDS
    }
    default_medium = kind(**model_keywords)
    if LIQUID_WATER_KEY in keywords:
        water = check_range(
            LIQUID_WATER_KEY, keywords[LIQUID_WATER_KEY], 0.0, default_medium.porosity,
            hint="volume of water per volume of snow, at most that of its pores",
        )  # fmt: skip
        model_keywords["saturation"] = water / default_medium.porosity
    if SURFACE_AREA_KEY in keywords or OPTICAL_RADIUS_KEY in keywords:
        if SURFACE_AREA_KEY in keywords:
            hint = "m2/kg: about 60 for fresh snow, 10 for old snow, 3 for melting snow"
            area = check_range(
                SURFACE_AREA_KEY,
                keywords[SURFACE_AREA_KEY],
                MIN_SURFACE_AREA_M2_KG,
                MAX_SURFACE_AREA_M2_KG,
                hint=hint,
            )
        else:
            area = _convert_radius_to_area(
                keywords[OPTICAL_RADIUS_KEY], default_medium.temperature_c
            )
        factor = default_medium.specific_surface_area_m2_kg / area
        model_keywords["grain_size_um"] = tuple(
            factor * size for size in default_medium.grain_size_um
        )
    return model_keywords


def to_shortest_keywords(snow: Any, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the inputs of snow with each in the equivalent keyword that needs the fewest digits.

    Sizes in the default ratio are equivalent to a surface area and to a radius.
    """
    shortest = dict(inputs)
    default_size = type(snow)().grain_size_um
    ratios = [largest / smallest for smallest, largest in (snow.grain_size_um, default_size)]
    scaled = abs(ratios[0] / ratios[1] - 1.0) < 1e-9
    for field, measured in (
        ("grain_size_um", (SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY)),
        ("saturation", (LIQUID_WATER_KEY,)),
    ):
        if field in inputs and (scaled or field != "grain_size_um"):
            candidates = sorted(
                (*measured, field), key=lambda name: count_digits(getattr(snow, name))
            )
            del shortest[field]
            shortest = {candidates[0]: getattr(snow, candidates[0]), **shortest}
    return shortest


def _convert_radius_to_area(radius_um: Any, temperature_c: float) -> float:
    """Return the specific surface area (m²/kg) of spheres of given radius, 3/(ρ_ice r)."""
    ice = ice_density(temperature_c)
    min_radius, max_radius = (
        3e6 / (ice * area) for area in (MAX_SURFACE_AREA_M2_KG, MIN_SURFACE_AREA_M2_KG)
    )
    radius = check_range(OPTICAL_RADIUS_KEY, radius_um, min_radius, max_radius, "µm")
    return 3e6 / (ice * radius)
