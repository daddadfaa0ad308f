"""Snow as it lies: grains with the optical shape that tomography measures, and their surface area.

Facetness and sphericity are those whose absorption enhancement B and asymmetry parameter g come
nearest to natural snow's (Robledano et al. 2023, Nature Communications 14, 3955: B 1.68 ± 0.02,
g 0.65 ± 0.03 over 33 samples at 900 nm).  They were found by `benchmarks/grain_shape.py --search`,
from single scattering alone; nothing was fitted to an albedo.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from splits.checks import in_range, refuse
from splits.media.measured_inputs import AREA, RADIUS
from splits.media.readings import together

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
            "m2/kg: fresh snow has some 60, old snow 10, melting snow 3",
        )  # fmt: skip
    usual = {
        **GRAINS, "readings": READINGS, "density_kg_m3": 300.0, "depth_m": math.inf,
    }  # fmt: skip
    if "saturation" not in given and "liquid_water_content" not in given:
        usual["saturation"] = 0.0
    if "density_kg_m3" in given:
        hint = "kg/m3, not g/cm3"
        in_range("density_kg_m3", given["density_kg_m3"], LIGHTEST, 1000.0, "kg/m3", hint=hint)
    readings = given.get("readings", {})
    if isinstance(readings, Mapping):
        given = {**given, "readings": together([READINGS, readings])}
    index = given.get("refractive_index", {})
    indices = {"refractive_index": {**INDICES, **index} if isinstance(index, Mapping) else index}
    return {**usual, **given, **indices}


def shape_facts(snow: Any) -> dict[str, float]:
    """Return the optical shape of natural snow's grains as attributes, of other grains nothing."""
    alike = all(getattr(snow, name) == value for name, value in GRAINS.items())
    if not alike or snow.readings != type(snow.readings).of(READINGS):
        return {}
    return {
        "absorption_enhancement_900nm_dry": SHAPE.enhancement,
        "absorption_enhancement_900nm_dry_stderr": SHAPE.enhancement_stderr,
        "asymmetry_parameter_900nm_dry": SHAPE.asymmetry,
        "asymmetry_parameter_900nm_dry_stderr": SHAPE.asymmetry_stderr,
    }
