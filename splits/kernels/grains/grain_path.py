"""The walk of a ray through one grain, by trials at its surface, for the scalar kernel."""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.features import ALL_FEATURES
from splits.kernels.compiler.jit import inline_only
from splits.kernels.grains.interaction import (
    InteractionVariates,
    InterfaceState,
    RelativeIndex,
    compute_coating_path_length,
    find_next_region,
    reflect_or_refract,
    relative_index,
)
from splits.kernels.grains.microfacet import make_smooth_facet, sample_microfacet
from splits.kernels.grains.scene import WRONG_SIDE_LOBE
from splits.kernels.grains.spheroid import compute_chord
from splits.kernels.grains.state import RayPayload, attenuate, pore_material, refractive_index_of
from splits.kernels.math.elementary import Angle
from splits.kernels.math.rng import sample_azimuth, sample_half_normal, uniform
from splits.kernels.math.vectors import ORIGIN, Vector, add_scaled


class GrainTransit(NamedTuple):
    """A ray after a grain: whether it survived, its way from entry to exit (m), what it carries."""

    alive: bool
    displacement: Vector
    payload: RayPayload


class AdjacentMedia(NamedTuple):
    """The media on both sides of a surface, and the number that decides the pore outside."""

    relative_index: RelativeIndex
    pore_variate: float


@inline_only
def sample_adjacent_media(state, interface, grain_type, payload, scene, optics):
    """Return the media that a ray at a grain has on both sides."""
    shell, beyond = int(interface.shell), int(interface.shell + interface.side)
    materials, layers = scene.types.material, scene.layers
    u = payload.pore_variate
    # On its way into a lobe a ray keeps the pore that let it through.
    if beyond == 0 and not interface.in_lobe:
        u = uniform(state)
    here = (
        materials[grain_type, shell - 1] if shell > 0 else pore_material(layers, payload.layer, u)
    )
    there = (
        materials[grain_type, beyond - 1] if beyond > 0 else pore_material(layers, payload.layer, u)
    )
    return AdjacentMedia(
        relative_index(refractive_index_of(optics, here), refractive_index_of(optics, there)), u
    )


@inline_only
def sample_interaction(state, d, interface, grain, roughness, media, rules):
    """Return what one trial at a grain's surface leads to."""
    facet = make_smooth_facet(d, grain, interface.side)
    u = uniform(state)
    while roughness > 0.0:
        azimuth = sample_azimuth(state)
        azimuth = Angle(abs(azimuth.cos), azimuth.sin)
        numbers = InteractionVariates(uniform(state), u, 0.0, sample_half_normal(state), azimuth)
        found = sample_microfacet(
            d, facet, roughness, numbers, interface.in_lobe, rules.facet_sampling
        )
        if found.accepted or interface.in_lobe:
            facet = found
            break
    return reflect_or_refract(
        d, interface, facet, media, u, rules.wrong_side != WRONG_SIDE_LOBE, ALL_FEATURES
    )


@inline_only
def trace_through_grain(state, payload, event, scene, optics, path_lengths):
    """Follow a ray from its entry point on a grain until it is back in the pore space.

    Parameters
    ----------
    state : uint64[1]
    payload : RayPayload
        As it meets the grain.
    event : Found
    scene, optics
        See `splits.kernels.grains.scene`.
    path_lengths : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.

    Returns
    -------
    Walk
    """
    kind, size, roughness = event.grain_sample
    grain, types = event.collision.entry.grain, scene.types
    way = ORIGIN
    stand = InterfaceState(0.0, 1.0, False, False)
    while True:
        media = sample_adjacent_media(state, stand, kind, payload, scene, optics)
        after = sample_interaction(
            state, payload.direction, stand, grain, roughness, media.relative_index, scene.rules
        )
        if not after.accepted:
            payload = RayPayload(
                payload.direction, payload.layer, media.pore_variate, payload.roulette
            )
            stand = InterfaceState(stand.shell, stand.side, after.needs_lobe, after.transmitted)
            continue
        gone = find_next_region(stand, after, float(types.n_shells[kind]), True)
        stand = gone.interface
        if gone.in_pore:
            u = media.pore_variate if after.transmitted else uniform(state)
            return GrainTransit(
                True, way, RayPayload(after.direction, payload.layer, u, payload.roulette)
            )
        shell = int(stand.shell) - 1
        if gone.in_core:
            leg, grain = compute_chord(grain, after.direction)
            way = add_scaled(leg, after.direction, way)
        else:
            leg = compute_coating_path_length(
                2.0 * size.semi_major * types.coating_thickness[kind, shell], after, True
            )
        material = types.material[kind, shell]
        payment = attenuate(
            state, payload.roulette, leg, material, optics, scene.rules.analog, path_lengths
        )
        payload = RayPayload(after.direction, payload.layer, media.pore_variate, payment.roulette)
        if not payment.alive:
            return GrainTransit(False, way, payload)
