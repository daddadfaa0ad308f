"""Parameters of media and light in datasets: long names, units, attributes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

PARAMETERS: dict[str, tuple[str, str]] = {
    "algae_cells_ml": ("number of algae cells per volume of meltwater", "ml-1"),
    "asymmetry": ("mean cosine of the scattering angle", "1"),
    "bottom_albedo": ("albedo of the bottom", "1"),
    "density_kg_m3": ("mass of ice per volume", "kg m-3"),
    "depolarization": ("depolarization factor of Rayleigh scattering", "1"),
    "depth_m": ("thickness of the sample", "m"),
    "facetness": ("facetness of the grains, mean", "1"),
    "ground": ("ground below", "1"),
    "grain_size_um": ("major-axis diameter of the grains, smallest to largest", "um"),
    "hematite_ratio": ("mass of hematite per mass of iron oxide", "1"),
    "impurities_in": ("location of the impurities", "1"),
    "impurities_ng_g": ("mass of impurities per mass of ice", "1e-9"),
    "incidence_deg": ("angle of incidence", "degree"),
    "iron_oxide": ("mass of hematite and goethite per mass of sand", "1"),
    "layers": ("layers", "1"),
    "liquid_water_content": ("volume of water per volume of snow", "1"),
    "magnetite": ("mass of magnetite per mass of sand", "1"),
    "medium": ("sample", "1"),
    "opaque": ("whether all light transmitted by the surface is absorbed", "1"),
    "optical_radius_um": ("radius of spheres of the same specific surface area", "um"),
    "optical_thickness": ("optical thickness", "1"),
    "partition": ("mass fractions of pure, mixed and coated particles", "1"),
    "phase_function": ("phase function", "1"),
    "polarized": ("whether the Stokes vector is traced", "1"),
    "pores": ("fluids in the pores besides air and water", "1"),
    "porosity": ("volume of pores per volume", "1"),
    "interpretation": ("interpretation of the papers", "1"),
    "refractive_index": ("refractive index", "1"),
    "relative_coating_thickness": ("thickness of coatings per major axis of the particle", "1"),
    "roundness": ("roundness of the particles, mean and standard deviation", "1"),
    "saturation": ("volume of water per volume of pores", "1"),
    "scattering_matrix": ("scattering matrix", "1"),
    "single_scattering_albedo": ("single-scattering albedo", "1"),
    "size_tail": ("mass fraction outside the outermost size limits", "1"),
    "specific_surface_area_m2_kg": ("specific surface area of the ice", "m2 kg-1"),
    "sphericity": ("sphericity of the grains, mean", "1"),
    "surface": ("surface of the layer", "1"),
    "temperature_c": ("temperature", "degC"),
    "texture": ("mass fractions of clay, silt and sand", "1"),
}
"""Long names and units (UDUNITS) of all parameters of a grid."""

DERIVED_QUANTITIES: dict[str, tuple[str, str]] = {
    "absorption_enhancement_900nm_dry": ("absorption enhancement of dry grains at 900 nm", "1"),
    "asymmetry_parameter_900nm_dry": ("asymmetry parameter of dry grains at 900 nm", "1"),
    "extinction_per_m": ("extinction coefficient", "m-1"),
    "mean_grain_distance_m": ("mean distance between grains along a ray", "m"),
}
"""Long names and units of derived quantities that datasets hold as attributes."""

IMPURITY_KEYWORDS = ("impurities_ng_g", "algae_cells_ml")
"""Keywords that are mappings of amounts by type."""
_IMPURITY_PATTERN = re.compile(rf"({'|'.join(IMPURITY_KEYWORDS)})\.(\w+)")
_LAYER_PATTERN = re.compile(r"layers\.(\d+)\.(\w+)")


def parse_layer_parameter(parameter: str) -> tuple[int, str] | None:
    """Return the layer number and the keyword of a path such as layers.0.depth_m, or None."""
    match = _LAYER_PATTERN.fullmatch(parameter)
    return (int(match[1]), match[2]) if match else None


def parse_impurity_parameter(parameter: str) -> tuple[str, str] | None:
    """Return keyword and type of a name such as impurities_ng_g.black_carbon, or None."""
    match = _IMPURITY_PATTERN.fullmatch(parameter)
    return (match[1], match[2]) if match else None


def describe_parameter(parameter: str) -> tuple[str, str]:
    """Return the long name and units of a parameter, also for the path of one in a layer.

    An unknown parameter, such as one of a user's function, gets its own name.
    """
    path = parse_layer_parameter(parameter)
    if path is not None:
        long_name, units = describe_parameter(path[1])
        return f"{long_name}, layer {path[0]}", units
    key, _, kind = parameter.partition(".")
    known = PARAMETERS.get(key) or DERIVED_QUANTITIES.get(key)
    long_name, units = known or (key.replace("_", " "), "1")
    return (f"{long_name}: {kind.replace('_', ' ')}" if kind else long_name), units


INCIDENT_STOKES = "incident_stokes"
UNPOLARIZED_LIGHT = (1.0, 0.0, 0.0, 0.0)
"""Stokes vector of the incident light, by default."""


def get_incident_stokes(attributes: Mapping[Any, Any]) -> tuple[float, ...]:
    """Return I, Q, U and V of the incident light, unpolarized without the attribute."""
    return tuple(float(value) for value in attributes.get(INCIDENT_STOKES, UNPOLARIZED_LIGHT))
