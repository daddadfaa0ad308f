"""Snow as it lies: grains with the optical shape that tomography measures, and their surface area.

Facetness and sphericity are those whose absorption enhancement B and asymmetry parameter g come
nearest to natural snow's (Robledano et al. 2023, Nature Communications 14, 3955: B 1.68 ± 0.02,
g 0.65 ± 0.03 over 33 samples at 900 nm).  They were found by `benchmarks/grain_shape.py --search`,
from single scattering alone; nothing was fitted to an albedo.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from splits.checks import in_range, known_arguments, refuse
from splits.materials import ice_density
from splits.media.measured_inputs import AREA, RADIUS
from splits.media.readings import Readings, together

if TYPE_CHECKING:
    from splits.media.snow import Snow

FACETNESS = 0.05
SPHERICITY = 0.75


class Shape(NamedTuple):
    """Optical shape of dry grains at 900 nm, see `splits.analysis.grain_shape`."""

    enhancement: float
    enhancement_stderr: float
    asymmetry: float
    asymmetry_stderr: float


SHAPE = Shape(1.661, 0.003, 0.678, 0.001)

LIGHTEST = 10.0
"""Density (kg/m³) below which no snow lies."""

INDICES = {"ice": "warren_brandt_2008_picard_2016", "water": "segelstein_1981"}

GRAINS: dict[str, Any] = {
    "facetness": (FACETNESS, FACETNESS, FACETNESS, 0.0),
    "sphericity": (SPHERICITY, SPHERICITY, SPHERICITY, 0.0),
}
READINGS = "radiative_transfer"


@known_arguments
def natural(
    cls: type[Snow],
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
    readings: Readings | str | Mapping[str, Any] | None = None,
) -> Snow:
    """Return snow as it lies, by its surface area: dry, deep and clean unless said.

    Its grains have the absorption enhancement and the asymmetry parameter that natural snow
    was measured to have at 900 nm (`splits.media.natural_snow`).  They are point scatterers
    (readings ``radiative_transfer``), so that the reflectance of a dry half-space does not depend
    on its density, the BRDF is reciprocal, and mean paths inside are those of the law with the
    grains' own B.  Its ice absorbs as Picard et al. (2016) found below 600 nm, and its water is
    Segelstein's.

    Parameters
    ----------
    specific_surface_area_m2_kg, optical_radius_um, grain_size_um
        One of the three, as for `Snow`.
    density_kg_m3 : float
        From 10 kg/m³ on: no lighter snow lies.
    depth_m : float
        Infinite depths are for spectra, albedos and profiles; the others need a finite one.
    others
        As for `Snow`; without them snow is dry and clean.

    Raises
    ------
    ValueError
        Without a size, or for a value outside its range.

    Examples
    --------
    >>> from splits import Snow
    >>> snow = Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=250, depth_m=1)
    >>> round(snow.optical_radius_um, 1)
    163.6
    """
    given = {**locals()}
    given.pop("cls")
    given = {name: value for name, value in given.items() if value is not None}
    return cls(**natural_settings(given))


def natural_settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of `splits.Snow` that natural snow has, with those given.

    Raises
    ------
    ValueError
        Where no size is given.
    """
    if not {AREA, RADIUS, "grain_size_um"} & set(given):
        raise refuse(
            AREA, None, "given, or optical_radius_um",
            "m2/kg: fresh snow has 40 and more, old snow 10, melting snow 3",
        )  # fmt: skip
    usual = {
        **GRAINS, "readings": READINGS, "density_kg_m3": 300.0, "depth_m": math.inf,
    }  # fmt: skip
    if "saturation" not in given and "liquid_water_content" not in given:
        usual["saturation"] = 0.0
    if "density_kg_m3" in given:
        key, temperature = "density_kg_m3", given.get("temperature_c", -1.0)
        temperature = in_range("temperature_c", temperature, -40.0, 0.0, "°C")
        ice = ice_density(temperature)
        hint = f"kg/m3, not g/cm3: ice at {temperature:g} °C has {ice:g}"
        in_range(key, given[key], LIGHTEST, ice, "kg/m3", hint=hint, open_high=True)
    readings = given.get("readings", {})
    if isinstance(readings, Mapping):
        given = {**given, "readings": together([READINGS, readings])}
    index = given.get("refractive_index", {})
    indices = {"refractive_index": {**INDICES, **index} if isinstance(index, Mapping) else index}
    return {**usual, **given, **indices}


def is_natural(snow: Any) -> bool:
    """Tell whether snow has the grains and the readings of natural snow."""
    alike = all(getattr(snow, name) == value for name, value in GRAINS.items())
    return alike and snow.readings == type(snow.readings).of(READINGS)


def shape_facts(snow: Any) -> dict[str, float]:
    """Return the optical shape of natural snow's grains as attributes, of other grains nothing."""
    if not is_natural(snow):
        return {}
    return {
        "absorption_enhancement_900nm_dry": SHAPE.enhancement,
        "absorption_enhancement_900nm_dry_stderr": SHAPE.enhancement_stderr,
        "asymmetry_parameter_900nm_dry": SHAPE.asymmetry,
        "asymmetry_parameter_900nm_dry_stderr": SHAPE.asymmetry_stderr,
    }
