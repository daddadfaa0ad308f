"""Natural snow: grains with the optical shape derived from tomography, by specific surface area.

Facetness and sphericity are those whose absorption enhancement B and asymmetry parameter g are
closest to those of natural snow (Robledano et al. 2023, Nature Communications 14, 3955:
B 1.68 ± 0.02, g 0.65 ± 0.03 over 33 samples at 900 nm).  `benchmarks/grains.py closest_shape` found
them from single scattering alone; no albedo was fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import wraps
from inspect import Parameter, signature
from typing import Any, NamedTuple, TypeVar

from splits.core.keywords import reject_unknown_arguments
from splits.core.validation import check_range, invalid
from splits.materials import ice_density
from splits.media.formatting import count_digits
from splits.media.interpretations import Interpretation, merge_interpretations

# --------------------------------------------------------------------------------------------------
# Measured quantities that replace model parameters: surface area, optical radius, water content.
#
# Specific surface area scales the range of grain sizes; liquid water content is the volume of water
# per volume of snow, in place of saturation.

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


# --------------------------------------------------------------------------------------------------
# Natural snow: grains with the optical shape derived from tomography, by specific surface area.

NATURAL_FACETNESS = 0.05
NATURAL_SPHERICITY = 0.75


class NaturalGrainShape(NamedTuple):
    """Optical shape of dry grains at 900 nm; see `splits.analysis.theory.grain_shape`."""

    absorption_enhancement: float
    absorption_enhancement_stderr: float
    asymmetry_parameter: float
    asymmetry_parameter_stderr: float


NATURAL_GRAIN_SHAPE = NaturalGrainShape(1.661, 0.003, 0.678, 0.001)

MIN_NATURAL_DENSITY_KG_M3 = 10.0
"""Lower limit of the density of natural snow (kg/m³)."""

NATURAL_REFRACTIVE_INDICES = {"ice": "warren_brandt_2008_picard_2016", "water": "segelstein_1981"}

NATURAL_GRAINS: dict[str, Any] = {
    "facetness": (NATURAL_FACETNESS, NATURAL_FACETNESS, NATURAL_FACETNESS, 0.0),
    "sphericity": (NATURAL_SPHERICITY, NATURAL_SPHERICITY, NATURAL_SPHERICITY, 0.0),
}
NATURAL_INTERPRETATION = "radiative_transfer"


@reject_unknown_arguments
def make_natural_snow(
    cls: type[Any],
    *,
    specific_surface_area_m2_kg: float | None = None,
    optical_radius_um: float | None = None,
    grain_size_um: tuple[float, float] | None = None,
    density_kg_m3: float = 300.0,
    depth_m: float = math.inf,
    temperature_c: float = -1.0,
    saturation: float | None = None,
    liquid_water_content: float | None = None,
    impurities_ng_g: Mapping[str, Any] | None = None,
    algae_cells_ml: Mapping[str, float] | None = None,
    impurities_in: str = "ice",
    ground: Any = None,
    facetness: tuple[float, float, float, float] | None = None,
    sphericity: tuple[float, float, float, float] | None = None,
    pores: Mapping[str, float] | None = None,
    refractive_index: Mapping[str, Any] | None = None,
    interpretation: Interpretation | str | Mapping[str, Any] | None = None,
) -> Any:
    """Return modelled natural snow; dry, clean and semi-infinite by default.

    The grains have the absorption enhancement B and the asymmetry parameter measured for natural
    snow at 900 nm (`splits.media.natural_snow`).  They are point scatterers (interpretation
    ``radiative_transfer``).  The reflectance of dry semi-infinite snow therefore does not depend on
    its density, the BRDF is reciprocal, and the mean path length in ice follows from B.  The
    absorption of ice below 600 nm is that of Picard et al. (2016), and the refractive index of
    water is that of Segelstein (1981).

    Parameters
    ----------
    specific_surface_area_m2_kg, optical_radius_um, grain_size_um
        Size of the grains, by one of the three; see `Snow`.
    density_kg_m3 : float
        Mass of ice per volume of snow, from 10 kg/m³ to below the density of ice.
    depth_m : float
        Thickness (m).  An infinite depth is allowed for spectra, albedos, profiles and delays,
        and for BRDFs and HDRFs by discrete ordinates.

    Raises
    ------
    ValueError
        If no size is given, or for a value outside its range.

    Notes
    -----
    The other keywords are those of `Snow`; by default the snow is dry and clean.

    Examples
    --------
    >>> from splits import Snow
    >>> snow = Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=250, depth_m=1)
    >>> round(snow.optical_radius_um, 1)
    163.6
    """
    keywords = {**locals()}
    keywords.pop("cls")
    keywords = {name: value for name, value in keywords.items() if value is not None}
    return cls(**complete_natural_keywords(keywords))


make_natural_snow.__qualname__ = "Snow.natural"
"""Name in error messages: that of the public function."""


def complete_natural_keywords(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of `splits.Snow` for natural snow, updated by those given.

    Raises
    ------
    ValueError
        If no size is given.
    """
    if not {SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY, "grain_size_um"} & set(keywords):
        raise invalid(
            SURFACE_AREA_KEY, None, "given, or optical_radius_um",
            "m2/kg: 40 and more for fresh snow, 10 for old snow, 3 for melting snow",
        )  # fmt: skip
    defaults = {
        **NATURAL_GRAINS, "interpretation": NATURAL_INTERPRETATION,
        "density_kg_m3": 300.0, "depth_m": math.inf,
    }  # fmt: skip
    if "saturation" not in keywords and "liquid_water_content" not in keywords:
        defaults["saturation"] = 0.0
    if "density_kg_m3" in keywords:
        key, temperature = "density_kg_m3", keywords.get("temperature_c", -1.0)
        temperature = check_range("temperature_c", temperature, -40.0, 0.0, "°C")
        ice = ice_density(temperature)
        hint = f"ice at {temperature:g} °C has {ice:g}"
        check_range(
            key, keywords[key], MIN_NATURAL_DENSITY_KG_M3, ice, "kg/m3", hint=hint, open_high=True
        )
    interpretation = keywords.get("interpretation", {})
    if isinstance(interpretation, Mapping):
        keywords = {
            **keywords,
            "interpretation": merge_interpretations([NATURAL_INTERPRETATION, interpretation]),
        }
    index = keywords.get("refractive_index", {})
    indices = {
        "refractive_index": {**NATURAL_REFRACTIVE_INDICES, **index}
        if isinstance(index, Mapping)
        else index
    }
    return {**defaults, **keywords, **indices}


def is_natural(snow: Any) -> bool:
    """Return whether snow has the grains and the interpretation of natural snow."""
    same_grains = all(getattr(snow, name) == value for name, value in NATURAL_GRAINS.items())
    return same_grains and snow.interpretation == type(snow.interpretation).from_input(
        NATURAL_INTERPRETATION
    )


def describe_grain_shape(snow: Any) -> dict[str, float]:
    """Return the optical shape of grains of natural snow as attributes; empty for others."""
    if not is_natural(snow):
        return {}
    shape = NATURAL_GRAIN_SHAPE
    return {
        "absorption_enhancement_900nm_dry": shape.absorption_enhancement,
        "absorption_enhancement_900nm_dry_stderr": shape.absorption_enhancement_stderr,
        "asymmetry_parameter_900nm_dry": shape.asymmetry_parameter,
        "asymmetry_parameter_900nm_dry_stderr": shape.asymmetry_parameter_stderr,
    }
