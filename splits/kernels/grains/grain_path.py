"""Grains that a ray hits, and its path through each, for the scalar kernel."""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.arithmetic import Angle, add_scaled
from splits.kernels.compiler.jit import inline_only, replace
from splits.kernels.grains.spheroid import (
    EntryPoint,
    EntryVariates,
    GrainSize,
    LayerGeometry,
    RejectionRules,
    Spheroid,
    accept_axial_position,
    compute_chord,
)
from splits.kernels.grains.surface import (
    InteractionVariates,
    InterfaceState,
    SurfaceInteraction,
    compute_coating_path_length,
    find_next_region,
    make_smooth_facet,
    reflect_or_refract,
    reflect_or_refract_polarized,
    relative_index,
    sample_microfacet,
)
from splits.kernels.interface import ComplexIndex
from splits.kernels.rng import (
    interpolate_quantile,
    sample_azimuth,
    sample_discrete,
    sample_half_normal,
    uniform,
)
from splits.kernels.scene import (
    ABSORBED,
    ALIVE,
    ALL_FEATURES,
    OVERLAP_KEEP,
    OVERLAP_SKIP,
    UP,
    WET_PORE,
    WRONG_SIDE_LOBE,
)

# --------------------------------------------------------------------------------------------------
# Properties of layers, sampling of grains, and attenuation.


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


# --------------------------------------------------------------------------------------------------
# Path of a ray through one grain, by interactions at its surface, for the scalar kernel.


@inline_only
def sample_adjacent_media(state, interface, grain_type, ray, scene, optics):
    """Return the `RelativeIndex` of the media at an interface of a grain, and the pore variate."""
    shell, next_shell = int(interface.shell), int(interface.shell + interface.side)
    materials, layers = scene.types.material, scene.layers
    pore_variate = ray.pore_variate
    # A ray in a lobe keeps the pore into which it was transmitted.
    if next_shell == 0 and not interface.in_lobe:
        pore_variate = uniform(state)
    pore = pore_material(layers, ray.layer, pore_variate)
    near_material = materials[grain_type, shell - 1] if shell > 0 else pore
    far_material = materials[grain_type, next_shell - 1] if next_shell > 0 else pore
    near = refractive_index_of(optics, near_material)
    far = refractive_index_of(optics, far_material)
    return relative_index(near, far), pore_variate


@inline_only
def sample_interaction(state, d, stokes, interface, grain, roughness, media, rules):
    """Sample one interaction at the surface of a grain, a `SurfaceInteraction`."""
    facet = make_smooth_facet(d, grain, interface.side)
    u = uniform(state)
    while roughness > 0.0:
        azimuth = sample_azimuth(state)
        azimuth = Angle(abs(azimuth.cos), azimuth.sin)
        variates = InteractionVariates(uniform(state), u, 0.0, sample_half_normal(state), azimuth)
        sample = sample_microfacet(
            d, facet, roughness, variates, interface.in_lobe, rules.facet_sampling
        )
        if sample.accepted or interface.in_lobe:
            facet = sample
            break
    mirror = rules.wrong_side != WRONG_SIDE_LOBE
    if stokes is None:
        result = reflect_or_refract(d, interface, facet, media, u, mirror, ALL_FEATURES)
        return SurfaceInteraction(result, stokes)
    return reflect_or_refract_polarized(d, stokes, interface, facet, media, u, mirror)


@inline_only
def trace_through_grain(state, ray, grain_sample, entry, scene, optics, path_lengths):
    """Trace a ray from its entry point on a grain until it is back in the pore space.

    Parameters
    ----------
    state : uint64[1]
    ray : Ray
        At the entry point.
    grain_sample : GrainSample
    entry : EntryPoint
    scene, optics
        See `splits.kernels.scene`.
    path_lengths : float64[materials]
        Path lengths (m), accumulated in place by those inside the grain.

    Returns
    -------
    Ray
        At the exit point, or `ABSORBED`.
    """
    grain_type, size, roughness = grain_sample
    grain, types = entry.grain, scene.types
    interface = InterfaceState(0.0, 1.0, False, False)
    while True:
        media, variate = sample_adjacent_media(state, interface, grain_type, ray, scene, optics)
        result, stokes = sample_interaction(
            state, ray.direction, ray.stokes, interface, grain, roughness, media, scene.rules
        )
        ray = replace(ray, pore_variate=variate)
        if not result.accepted:
            interface = InterfaceState(
                interface.shell, interface.side, result.needs_lobe, result.transmitted
            )
            continue
        ray = replace(ray, direction=result.direction, stokes=stokes)
        region = find_next_region(interface, result, float(types.n_shells[grain_type]), True)
        interface = region.interface
        if region.in_pore:
            pore_variate = ray.pore_variate if result.transmitted else uniform(state)
            return replace(ray, pore_variate=pore_variate)
        shell = int(interface.shell) - 1
        if region.in_core:
            length, grain = compute_chord(grain, ray.direction)
            ray = replace(ray, exit_offset=add_scaled(length, ray.direction, ray.exit_offset))
        else:
            thickness = 2.0 * size.semi_major * types.coating_thickness[grain_type, shell]
            length = compute_coating_path_length(thickness, result, True)
        material = types.material[grain_type, shell]
        ray = attenuate(state, ray, length, material, optics, scene.rules.analog, path_lengths)
        if ray.status != ALIVE:
            return ray
