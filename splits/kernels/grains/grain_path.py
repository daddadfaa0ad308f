"""Path of a ray through one grain, by interactions at its surface, for the scalar kernel."""

from __future__ import annotations

from typing import Any, NamedTuple

from splits.kernels.base.ray import ALIVE
from splits.kernels.base.sampling_rules import WRONG_SIDE_LOBE
from splits.kernels.compiler.features import ALL_FEATURES
from splits.kernels.compiler.jit import inline_only
from splits.kernels.compiler.replace import replace
from splits.kernels.grains.interaction import (
    InteractionResult,
    InteractionVariates,
    InterfaceState,
    RelativeIndex,
    compute_coating_path_length,
    find_next_region,
    reflect_or_refract,
    relative_index,
)
from splits.kernels.grains.microfacet import make_smooth_facet, sample_microfacet
from splits.kernels.grains.polarized_interaction import reflect_or_refract_polarized
from splits.kernels.grains.spheroid import compute_chord
from splits.kernels.grains.state import attenuate, pore_material, refractive_index_of
from splits.kernels.math.elementary import Angle
from splits.kernels.math.rng import sample_azimuth, sample_half_normal, uniform
from splits.kernels.math.vectors import add_scaled


class AdjacentMedia(NamedTuple):
    """Relative index of the media at an interface, and the variate that selects the pore."""

    relative_index: RelativeIndex
    pore_variate: float


@inline_only
def sample_adjacent_media(state, interface, grain_type, ray, scene, optics):
    """Sample the media on both sides of an interface of a grain."""
    shell, next_shell = int(interface.shell), int(interface.shell + interface.side)
    materials, layers = scene.types.material, scene.layers
    pore_variate = ray.pore_variate
    # A ray in a lobe keeps the pore into which it was transmitted.
    if next_shell == 0 and not interface.in_lobe:
        pore_variate = uniform(state)
    pore = pore_material(layers, ray.layer, pore_variate)
    near_material = materials[grain_type, shell - 1] if shell > 0 else pore
    far_material = materials[grain_type, next_shell - 1] if next_shell > 0 else pore
    near, far = (
        refractive_index_of(optics, near_material),
        refractive_index_of(optics, far_material),
    )
    return AdjacentMedia(relative_index(near, far), pore_variate)


class GrainInteraction(NamedTuple):
    """An `InteractionResult`, and the `Stokes` (or None) after it."""

    result: InteractionResult
    stokes: Any


@inline_only
def sample_interaction(state, d, stokes, interface, grain, roughness, media, rules):
    """Sample one interaction at the surface of a grain, a `GrainInteraction`."""
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
        return GrainInteraction(result, stokes)
    polarized = reflect_or_refract_polarized(d, stokes, interface, facet, media, u, mirror)
    return GrainInteraction(polarized.result, polarized.stokes)


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
        See `splits.kernels.base.scene`.
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
        media = sample_adjacent_media(state, interface, grain_type, ray, scene, optics)
        result, stokes = sample_interaction(
            state, ray.direction, ray.stokes, interface, grain, roughness, media.relative_index,
            scene.rules,
        )  # fmt: skip
        ray = replace(ray, pore_variate=media.pore_variate)
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
