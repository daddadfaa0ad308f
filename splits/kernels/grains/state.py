"""Properties of layers, sampling of grains, and attenuation."""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.base.ray import ABSORBED
from splits.kernels.base.sampling_rules import OVERLAP_KEEP, OVERLAP_SKIP
from splits.kernels.base.scene import WET_PORE
from splits.kernels.compiler.jit import inline_only
from splits.kernels.compiler.replace import replace
from splits.kernels.grains.free_path import LayerGeometry, RejectionRules
from splits.kernels.grains.spheroid import (
    EntryPoint,
    EntryVariates,
    GrainSize,
    Spheroid,
    accept_axial_position,
)
from splits.kernels.math.elementary import Angle
from splits.kernels.math.rng import interpolate_quantile, sample_azimuth, sample_discrete, uniform
from splits.kernels.math.vectors import UP
from splits.kernels.optics.interface import ComplexIndex


class GrainSample(NamedTuple):
    """Sampled grain: its type, size, and roughness, half of its facetness."""

    grain_type: int
    size: GrainSize
    roughness: float


_ZERO_ANGLE = Angle(1.0, 0.0)
_PLACEHOLDER = (
    GrainSample(0, GrainSize(1.0, 0.0), 0.0),
    EntryPoint(Spheroid(UP, UP, 0.0, 1.0), UP, 0.0, 1.0),
)


@inline_only
def attenuate(state, ray, distance, material, optics, analog, path_lengths):
    """Attenuate a ray along a distance in a material.

    Beer-Lambert law, SPLITS section 4.3.4 and SPLITSnow Eqs 5-6: exp(−αd) is the probability of
    survival.  The distance is added to `path_lengths` (float64[materials], m).  Analog rays may be
    absorbed; weighted rays are not absorbed here.
    """
    path_lengths[material] += distance
    depth = optics.absorption[material] * distance
    if not analog:
        return replace(ray, optical_depth=ray.optical_depth + depth)
    survives = depth == 0.0 or uniform(state) < math.exp(-depth)
    return replace(ray, status=ray.status if survives else ABSORBED)


@inline_only
def pore_material(layers, layer, pore_variate):
    """Return the material of the pore of a ray in a layer (SPLITS 4.3.2, SPLITSnow 3.4)."""
    pore = layers.first_pore_material[layer]
    if pore_variate < layers.wet_fraction[layer]:
        return pore + WET_PORE
    for other in range(layers.pore_cdf.shape[1]):
        if pore_variate < layers.pore_cdf[layer, other]:
            return pore + WET_PORE + 1 + other
    return pore


@inline_only
def refractive_index_of(optics, material):
    """Return the complex refractive index of a material, or of (work item, material)."""
    return ComplexIndex(optics.n[material], optics.k[material])


@inline_only
def interface_index(scene, optics, material):
    """Return the refractive index of a material at interfaces.

    Without grains, extinction of the matrix is 0; the constant compiles the absorbing branch of
    Fresnel's equations away.
    """
    if scene.types is None:
        return ComplexIndex(optics.n[material], 0.0)
    return refractive_index_of(optics, material)


@inline_only
def get_layer_geometry(layers, layer):
    """Return the `LayerGeometry` of a layer."""
    slab_bottom, slab_top = layers.boundaries[layers.boundaries.size - 1], layers.boundaries[0]
    bottom, top = layers.boundaries[layer + 1], layers.boundaries[layer]
    return LayerGeometry(
        1.0 / layers.collision_coefficient[layer],
        bottom,
        top,
        slab_bottom,
        slab_top,
        min(slab_top, 0.0),
    )


@inline_only
def sample_grain(state, scene, layer):
    """Sample type, size, shape and roughness of a grain of a layer."""
    type_cdf, grain_type = scene.layers.type_cdf[layer], scene.layers.first_type[layer]
    if type_cdf.size > 1:
        grain_type += sample_discrete(type_cdf, uniform(state))
    return sample_shape(state, scene.types, grain_type)


@inline_only
def sample_shape(state, types, grain_type):
    """Sample the `GrainSample` of a type; another table of types may have another shape."""
    semi_major = 1.0 / interpolate_quantile(types.inverse_semi_major, grain_type, uniform(state))
    sphericity = interpolate_quantile(types.sphericity, grain_type, uniform(state))
    roughness = 0.5 * interpolate_quantile(types.facetness, grain_type, uniform(state))
    return GrainSample(grain_type, GrainSize(semi_major, 1.0 - sphericity * sphericity), roughness)


@inline_only
def sample_entry_variates(state, size):
    """Sample the random numbers of the entry point on a grain by rejection."""
    while True:
        variates = EntryVariates(
            uniform(state), _ZERO_ANGLE, _ZERO_ANGLE, uniform(state), uniform(state)
        )
        if accept_axial_position(variates, size.flattening):
            return EntryVariates(
                variates.u_cos_incidence,
                sample_azimuth(state),
                sample_azimuth(state),
                variates.u_axial,
                variates.u_accept,
            )


@inline_only
def make_placeholder_grain(types):
    """Return a `GrainSample` and an entry point of the classes for `types`, with any values.

    Compiled events have them where a ray hits a particle, too.
    """
    return _PLACEHOLDER


@inline_only
def make_rejection_rules(rules):
    """Return the `RejectionRules` of sampling rules."""
    return RejectionRules(
        rules.entry_sampling,
        rules.segment_overlap != OVERLAP_KEEP,
        rules.boundary_overlap != OVERLAP_KEEP,
        rules.segment_overlap == OVERLAP_SKIP,
        rules.boundary_overlap == OVERLAP_SKIP,
    )
