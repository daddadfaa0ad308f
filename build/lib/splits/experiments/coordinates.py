"""What the parameters of a grid are called in datasets, and their units."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from splits.experiments.stacks import path_of

PARAMETERS: dict[str, tuple[str, str]] = {
    "algae_cells_ml": ("cells of algae per volume of meltwater", "1"),
    "asymmetry": ("mean cosine of the scattering angle", "1"),
    "bottom_albedo": ("albedo of the bottom", "1"),
    "density_kg_m3": ("mass of ice per volume", "kg m-3"),
    "depth_m": ("thickness of the sample", "m"),
    "facetness": ("facetness of the grains, mean", "1"),
    "ground": ("ground below", "1"),
    "grain_size_um": ("major-axis diameter of the grains, smallest to largest", "um"),
    "hematite_ratio": ("mass of hematite per mass of iron oxide", "1"),
    "impurities_in": ("where impurities are", "1"),
    "impurities_ng_g": ("mass of impurities per mass of ice", "1e-9"),
    "incidence_deg": ("angle of incidence", "degree"),
    "iron_oxide": ("mass of hematite and goethite per mass of sand", "1"),
    "layers": ("layers", "1"),
    "liquid_water_content": ("volume of water per volume of snow", "1"),
    "magnetite": ("mass of magnetite per mass of sand", "1"),
    "max_polarization": ("largest degree of polarization of light scattered once", "1"),
    "medium": ("sample", "1"),
    "opaque": ("whether nothing comes back from below the surface", "1"),
    "optical_radius_um": ("radius of spheres of the same surface area per mass", "um"),
    "optical_thickness": ("optical thickness", "1"),
    "partition": ("mass fractions of pure, mixed and coated particles", "1"),
    "phase_function": ("phase function", "1"),
    "polarized": ("whether the Stokes vector is followed", "1"),
    "pores": ("what fills the pores besides air and water", "1"),
    "porosity": ("volume of pores per volume", "1"),
    "readings": ("reading of the papers", "1"),
    "refractive_index": ("refractive index", "1"),
    "relative_coating_thickness": ("thickness of coatings per major axis of the particle", "1"),
    "roundness": ("roundness of the particles, mean and standard deviation", "1"),
    "saturation": ("volume of water per volume of pores", "1"),
    "single_scattering_albedo": ("single-scattering albedo", "1"),
    "size_tail": ("mass beyond the outermost size limits per mass", "1"),
    "specific_surface_area_m2_kg": ("surface area of the ice per mass", "m2 kg-1"),
    "sphericity": ("sphericity of the grains, mean", "1"),
    "surface": ("surface of the layer", "1"),
    "temperature_c": ("temperature", "degC"),
    "texture": ("mass fractions of clay, silt and sand", "1"),
}
"""Long names and units (UDUNITS) of all parameters that a grid can have."""

MEANS: dict[str, Callable[[Sequence[float]], float]] = {
    "facetness": lambda given: given[2],
    "grain_size_um": lambda given: 0.5 * (given[0] + given[1]),
    "roundness": lambda given: given[0],
    "sphericity": lambda given: given[2],
}
"""The number that stands for a range or a distribution, by its parameter."""

Coordinate = tuple[str, np.ndarray, dict[str, str]]
"""Dimension, values and attributes, as `xarray.Dataset` takes them."""


def grid_coordinates(grid: Mapping[str, Mapping[str, Any]]) -> dict[str, Coordinate]:
    """Return the coordinates of an experiment's grid.

    Parameters
    ----------
    grid : mapping
        Per parameter its values by label.

    Returns
    -------
    dict
        Per parameter numbers in the parameter's unit where all values are numbers, and labels
        otherwise; labels have no units, so that their long name says the unit.  Beside labels of
        ranges and distributions stand their means as ``…_mean``, so that one can interpolate.
    """
    found = {}
    for parameter, choices in grid.items():
        long_name, units = parameter_about(parameter)
        values = coordinate_values(choices)
        if values.dtype.kind == "f":
            about = {"long_name": long_name, "units": units}
        else:
            about = {"long_name": long_name + (f" ({units})" if units != "1" else "")}
        found[parameter] = (parameter, values, about)
        means = means_of(parameter, choices)
        if means is not None:
            about = {"long_name": f"mean of: {long_name}", "units": units}
            found[f"{parameter}_mean"] = (parameter, means, about)
    return found


def means_of(parameter: str, choices: Mapping[str, Any]) -> np.ndarray | None:
    """Return the mean of each value of a grid, None where values are no ranges."""
    path = path_of(parameter)
    mean = MEANS.get(path[1] if path else parameter)
    several = all(isinstance(value, (list, tuple)) for value in choices.values())
    if mean is None or not several:
        return None
    return np.array([float(mean(value)) for value in choices.values()])


def parameter_about(parameter: str) -> tuple[str, str]:
    """Return the long name and the units of a parameter, or of that of a layer by its path."""
    path = path_of(parameter)
    if path is None:
        return PARAMETERS[parameter]
    long_name, units = PARAMETERS[path[1]]
    return f"{long_name}, layer {path[0]}", units


def coordinate_values(choices: Mapping[str, Any]) -> np.ndarray:
    """Return numbers where all grid values are numbers, and labels otherwise."""
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in choices.values()):
        return np.array([float(v) for v in choices.values()])
    return np.array(list(choices), dtype=object).astype(str)
