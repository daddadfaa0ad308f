"""Media and wavelengths for which discrete ordinates apply, and the reasons where they do not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.discrete_ordinates.grain_table import MAX_ABSORPTION
from splits.discrete_ordinates.snow_layers import SnowLayer
from splits.discrete_ordinates.snowpack import Snowpack, load_natural_grains
from splits.media.medium import Medium
from splits.media.natural_snow import is_natural
from splits.media.snow import Snow

MAX_WATER_DIFFERENCE = 0.005
"""Largest difference of the index of water from that of the table of wet grains."""
MAX_SATURATION = 0.5
"""Largest saturation of the table of wet grains."""
SHAPE_PARAMETERS = ("facetness", "sphericity")
WATER_PARAMETERS = ("saturation", "liquid_water_content")


def find_obstacle(medium: Medium, wavelength_nm: np.ndarray) -> str | None:
    """Return why discrete ordinates cannot simulate a medium, None if they can.

    Parameters
    ----------
    medium : Medium
    wavelength_nm : float, shape (wavelengths,)
    """
    layers: Any = medium.scene_layers
    for number, layer in enumerate(layers):
        place = f"layers[{number}] " if len(layers) > 1 else "it "
        reason = _find_obstacle_in_layer(layer, wavelength_nm)
        if reason:
            return place + reason
    saturated = [layer.saturation > 0.0 for layer in layers]
    water = [layer.refractive_index["water"] for layer in layers]
    if any(saturated) and any(one != water[0] for one in water):
        return "its layers have different refractive indices of water"
    return None


def make_snowpack(medium: Medium, wavelength_nm: np.ndarray) -> Snowpack:
    """Return a medium without obstacle as a snowpack at wavelengths (nm)."""
    layers: Any = medium.scene_layers
    ground = medium.reflecting_ground
    albedo = np.zeros(wavelength_nm.size) if ground is None else ground.albedo(wavelength_nm)
    return Snowpack([SnowLayer.from_snow(layer, wavelength_nm) for layer in layers], albedo)


def _find_obstacle_in_layer(layer: Any, wavelength_nm: np.ndarray) -> str | None:
    if not isinstance(layer, Snow) or not is_natural(layer):
        return "is no natural snow, made by splits.Snow.natural"
    if layer.pores:
        return "has other fluids than air and water in its pores"
    optics = SnowLayer.from_snow(layer, wavelength_nm)
    is_wet = layer.saturation > 0.0
    table = load_natural_grains(wet=is_wet)
    outside = ~table.contrast.contains(optics.contrast)
    if outside.any():
        limits = 1.0 + table.contrast.nodes[[0, -1]]
        return (
            f"has an index of ice of {1.0 + optics.contrast[outside][0]:.4g} at "
            f"{wavelength_nm[outside][0]:g} nm, outside {limits[0]:g} to {limits[1]:g}"
        )
    strong = optics.grain_absorption > MAX_ABSORPTION
    if strong.any():
        return f"absorbs too strongly at {wavelength_nm[strong][0]:g} nm"
    if not is_wet:
        return None
    if layer.saturation > MAX_SATURATION:
        return f"has a saturation of {layer.saturation:g}, above {MAX_SATURATION:g}"
    expected = table.contrast.compute_weights(optics.contrast) @ table.water
    if np.abs(optics.water_index - expected).max() > MAX_WATER_DIFFERENCE:
        return "has another refractive index of water than by default"
    return None


def find_parameter_obstacle(medium: Medium, parameters: Sequence[str]) -> str | None:
    """Return why a medium without obstacle has no derivatives by discrete ordinates.

    Parameters
    ----------
    medium : Medium
    parameters : sequence of str
        Parameters of the medium.
    """
    layers: Any = medium.scene_layers
    for name in parameters:
        *place, key = name.split(".")
        if key in SHAPE_PARAMETERS:
            return f"{name} changes the shape of natural grains"
        layer = layers[int(place[1])] if len(place) > 1 else layers[0]
        if key in WATER_PARAMETERS and layer.saturation == 0.0:
            return f"{name} changes dry snow into wet snow"
    return None
