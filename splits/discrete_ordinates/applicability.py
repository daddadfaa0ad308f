"""Media and wavelengths for which discrete ordinates apply, and the reasons where they do not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from splits.discrete_ordinates.grains import (
    MAX_ABSORPTION,
    GrainTable,
    TracedGrains,
    choose_rays,
    load_grains,
)
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    load_natural_grains,
)
from splits.media.medium import GranularMedium, Medium
from splits.media.snow import Snow, is_natural
from splits.simulation.scene import N_PORE_MATERIALS, compute_material_constants

MAX_WATER_DIFFERENCE = 0.005
"""Largest difference of the index of water from that of the table of wet grains."""
MAX_SATURATION = 0.5
"""Largest fraction of wet pores, that of the table of wet grains."""
DEFAULT_ERROR = 0.002
EXTENT_ERROR_PER_FRACTION = 0.02
"""Bound on the error of fluxes due to the extent of grains, over the volume fraction of grains."""
RECIPROCAL_RULES = {
    "entry_point": "projected",
    "facet_sampling": "projected",
    "wrong_side_ray": "mirror",
}
"""Rules within grains under which wet layers and finite grains have been compared with paths."""
SHAPE_PARAMETERS = ("facetness", "sphericity")
WATER_PARAMETERS = ("saturation", "liquid_water_content")


def find_obstacle(medium: Medium) -> str | None:
    """Return why discrete ordinates cannot simulate a medium, None if they can.

    The tables of natural snow have further limits, see `find_table_obstacle`.
    """
    layers: Any = medium.scene_layers
    for place, layer in _iterate_layers(medium):
        reason = _find_obstacle_in_layer(layer)
        if reason:
            return place + reason
    saturated = [layer.wet_fraction > 0.0 for layer in layers]
    water = [layer.refractive_index["water"] for layer in layers]
    if any(saturated) and any(one != water[0] for one in water):
        return "its layers have different refractive indices of water"
    return None


def find_table_obstacle(
    medium: Medium, stack: GranularStack, wavelength_nm: np.ndarray
) -> str | None:
    """Return why the tables of natural snow do not hold for a medium, None if they do.

    Parameters
    ----------
    medium : Medium
        Without other obstacle.
    stack : GranularStack
        See `make_granular_stack`.
    wavelength_nm : float, shape (wavelengths,)
    """
    for (place, layer), optics in zip(_iterate_layers(medium), stack.layers, strict=True):
        if isinstance(optics.grains, TracedGrains):
            continue
        contrast = optics.grains.contrast
        outside = ~contrast.contains(optics.contrast)
        if outside.any():
            limits = 1.0 + contrast.nodes[[0, -1]]
            return (
                f"{place}has an index of ice of {1.0 + optics.contrast[outside][0]:.4g} at "
                f"{wavelength_nm[outside][0]:g} nm, outside {limits[0]:g} to {limits[1]:g}"
            )
        strong = optics.grain_absorption > MAX_ABSORPTION
        if strong.any():
            return f"{place}absorbs too strongly at {wavelength_nm[strong][0]:g} nm"
        if layer.wet_fraction > 0.0:
            expected = contrast.compute_weights(optics.contrast) @ optics.grains.water
            if np.abs(optics.water_index - expected).max() > MAX_WATER_DIFFERENCE:
                return f"{place}has another refractive index of water than by default"
    return None


def _iterate_layers(medium: Medium) -> Iterator[tuple[str, Any]]:
    """Yield the layers of a medium, each with the beginning of a sentence on it."""
    layers = medium.scene_layers
    for number, layer in enumerate(layers):
        yield f"layers[{number}] " if len(layers) > 1 else "it ", layer


def make_granular_stack(
    medium: Medium, wavelength_nm: np.ndarray, max_error: float = DEFAULT_ERROR, threads: int = 1
) -> GranularStack:
    """Return a medium without obstacle as a snowpack at wavelengths (nm).

    Parameters
    ----------
    medium : Medium
    wavelength_nm : float, shape (wavelengths,)
    max_error : float
        Error of a reflectance, of which about half is due to grains that are not natural snow.
    threads : int
        For paths through these grains.
    """
    layers: Any = medium.scene_layers
    ground = medium.reflecting_ground
    albedo = np.zeros(wavelength_nm.size) if ground is None else ground.albedo(wavelength_nm)
    is_wet = any(layer.wet_fraction > 0.0 for layer in layers)
    grain_layers = []
    for layer in layers:
        grains: GrainTable | TracedGrains
        if _is_natural_layer(layer):
            grains = load_natural_grains(wet=is_wet)
        else:
            grains = load_grains(layer, wavelength_nm, choose_rays(max_error), threads)
            if is_wet and layer.wet_fraction == 0.0:
                grains = grains.add_wet_pores()
        error = compute_extent_error(layer)
        grain_layers.append(GranularLayer.from_medium(layer, wavelength_nm, grains, error))
    return GranularStack(grain_layers, albedo)


def compute_extent_error(layer: GranularMedium) -> float:
    """Return the bound on the error of fluxes of a thick layer due to the extent of its grains.

    Fluxes follow from single scattering and from the mean distance between grains
    (`splits.discrete_ordinates.grains.TracedGrains.compute_packing_ratio`).  Near the
    surface, they depend on more than the mean.  `benchmarks/grains.py` measures the
    differences.  Point grains have none.
    """
    if layer.interpretation.grain_extent == "point":
        return 0.0
    return EXTENT_ERROR_PER_FRACTION * (1.0 - layer.porosity)


def is_tabulated(medium: Medium) -> bool:
    """Return whether all layers are natural snow, which needs no paths through grains."""
    return all(map(_is_natural_layer, medium.scene_layers))


def find_direction_obstacle(medium: Medium) -> str | None:
    """Return why a medium without other obstacle has no BRDF by discrete ordinates."""
    for layer in medium.scene_layers:
        if not layer.has_grains or _is_natural_layer(layer):
            continue
        if layer.wet_fraction > 0.0:
            return "the BRDF of wet grains other than natural snow needs paths"
        if layer.interpretation.grain_extent != "point":
            return "the BRDF of grains that are no points needs paths"
    return None


def find_profile_obstacle(medium: Medium, wavelength_nm: np.ndarray) -> str | None:
    """Return why path lengths in a medium without other obstacle do not follow from absorption.

    Parameters
    ----------
    medium : Medium
        See `find_obstacle`.
    wavelength_nm : float, shape (wavelengths,)
    """
    layers: Any = medium.scene_layers
    for number, layer in enumerate(layers):
        if len(layer.list_materials()) > N_PORE_MATERIALS + 1:
            return f"layers[{number}] has grains of several materials"
        if layer.interpretation.grain_extent != "point":
            return f"layers[{number}] has no point grains"
        transparent = compute_material_constants(layer, wavelength_nm).absorption[:, -1] <= 0.0
        if transparent.any():
            first = wavelength_nm[transparent][0]
            return f"the grains of layers[{number}] absorb nothing at {first:g} nm"
    return None


def _is_natural_layer(layer: Any) -> bool:
    """Return whether the tables of natural snow are those of a layer."""
    return isinstance(layer, Snow) and is_natural(layer)


def _find_obstacle_in_layer(layer: Any) -> str | None:
    if not isinstance(layer, GranularMedium):
        return "has no grains"
    if layer.pores:
        return "has other fluids than air and water in its pores"
    if layer.wet_fraction > MAX_SATURATION:
        return (
            f"has a saturation of {layer.saturation:g}, by which more than {MAX_SATURATION:g} "
            "of its pores are wet"
        )
    if _is_natural_layer(layer):
        return None
    rules = layer.interpretation.as_dict()
    for name in ("overlap_with_boundary", "overlap_with_previous_segment"):
        if rules[name] != "keep":
            return (
                f"has {name} {rules[name]!r} in its interpretation, under which no equation of "
                "radiative transfer holds; one holds under the set radiative_transfer"
            )
    is_wet, is_point = layer.wet_fraction > 0.0, layer.interpretation.grain_extent == "point"
    if is_wet and rules["boundary_fresnel"] == "no":
        return "has water without Fresnel reflection at its boundaries (boundary_fresnel 'no')"
    if is_wet and not is_point:
        return "has water between grains that are no points"
    if is_wet or not is_point:
        which = "has water" if is_wet else "has no point grains"
        for name, choice in RECIPROCAL_RULES.items():
            if rules[name] != choice:
                return (
                    f"{which}, and {name} is {rules[name]!r} in its interpretation, not {choice!r}"
                )
    return None


def find_parameter_obstacle(medium: Medium, parameters: Sequence[str]) -> str | None:
    """Return why a medium without obstacle has no derivatives by discrete ordinates.

    Parameters
    ----------
    medium : Medium
    parameters : sequence of str
        Parameters of the medium.
    """
    if not parameters:
        return None
    layers: Any = medium.scene_layers
    for name in parameters:
        if name.split(".")[-1] in SHAPE_PARAMETERS:
            return f"{name} changes the shape of natural grains"
    for number, layer in enumerate(layers):
        if not _is_natural_layer(layer):
            which = f"layers[{number}]" if len(layers) > 1 else "it"
            return f"its parameters can vary only in natural snow, and {which} is another medium"
    for name in parameters:
        *place, key = name.split(".")
        layer = layers[int(place[1])] if len(place) > 1 else layers[0]
        if key in WATER_PARAMETERS and layer.saturation == 0.0:
            return f"{name} changes dry snow into wet snow"
    return None
