"""Natural snow: grains with the optical shape derived from tomography, by specific surface area.

Facetness and sphericity are those whose absorption enhancement B and asymmetry parameter g are
closest to those of natural snow (Robledano et al. 2023, Nature Communications 14, 3955:
B 1.68 ± 0.02, g 0.65 ± 0.03 over 33 samples at 900 nm).  `benchmarks/grain_shape.py --search` found
them from single scattering alone; no albedo was fitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from splits.core.keywords import reject_unknown_arguments
from splits.core.validation import check_range, invalid
from splits.materials import ice_density
from splits.media.interpretations import Interpretation, merge_interpretations
from splits.media.measured_inputs import OPTICAL_RADIUS_KEY, SURFACE_AREA_KEY

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
