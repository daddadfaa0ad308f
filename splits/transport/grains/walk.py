"""The walk of a ray through one grain, by trials at its surface, for the scalar kernel."""

from __future__ import annotations

from typing import NamedTuple

from splits.transport.compiling.features import EVERYTHING
from splits.transport.compiling.jit import part
from splits.transport.grains.facets import facing, rough
from splits.transport.grains.scalar import Beam, index_of, paid, pore_of
from splits.transport.grains.scene import LOBE
from splits.transport.grains.spheroid import across
from splits.transport.grains.surface import (
    Contrast,
    Numbers,
    Stand,
    contrast,
    film,
    goings,
    outcome,
)
from splits.transport.numerics.elementary import Angle
from splits.transport.numerics.rng import half_normal, uniform, unit_circle
from splits.transport.numerics.vectors import ORIGIN, Vector, along


class Walk(NamedTuple):
    """A ray after a grain: whether it survived, its way from entry to exit (m), what it carries."""

    alive: bool
    displacement: Vector
    payload: Beam


class Sides(NamedTuple):
    """The media on both sides of a surface, and the number that decides the pore outside."""

    relative_index: Contrast
    pore_variate: float


@part
def media_of(state, interface, grain_type, payload, scene, optics):
    """Return the media that a ray at a grain has on both sides."""
    shell, beyond = int(interface.shell), int(interface.shell + interface.side)
    materials, layers = scene.types.material, scene.layers
    u = payload.pore_variate
    # On its way into a lobe a ray keeps the pore that let it through.
    if beyond == 0 and not interface.in_lobe:
        u = uniform(state)
    here = materials[grain_type, shell - 1] if shell > 0 else pore_of(layers, payload.layer, u)
    there = materials[grain_type, beyond - 1] if beyond > 0 else pore_of(layers, payload.layer, u)
    return Sides(contrast(index_of(optics, here), index_of(optics, there)), u)


@part
def trial(state, d, interface, grain, roughness, media, rules):
    """Return what one trial at a grain's surface leads to."""
    facet = facing(d, grain, interface.side)
    u = uniform(state)
    while roughness > 0.0:
        azimuth = unit_circle(state)
        azimuth = Angle(abs(azimuth.cos), azimuth.sin)
        numbers = Numbers(uniform(state), u, 0.0, half_normal(state), azimuth)
        found = rough(d, facet, roughness, numbers, interface.in_lobe, rules.facet_sampling)
        if found.accepted or interface.in_lobe:
            facet = found
            break
    return outcome(d, interface, facet, media, u, rules.wrong_side != LOBE, EVERYTHING)


@part
def walk(state, payload, event, scene, optics, path_lengths):
    """Follow a ray from its entry point on a grain until it is back in the pore space.

    Parameters
    ----------
    state : uint64[1]
    beam : Beam
        As it meets the grain.
    found : Found
    scene, optics
        See `splits.transport.grains.scene`.
    length : float64[materials]
        Path lengths (m), advanced in place by those inside the grain.

    Returns
    -------
    Walk
    """
    kind, size, roughness = event.grain_sample
    grain, types = event.collision.entry.grain, scene.types
    way = ORIGIN
    stand = Stand(0.0, 1.0, False, False)
    while True:
        media = media_of(state, stand, kind, payload, scene, optics)
        after = trial(state, payload.direction, stand, grain, roughness, media.relative_index, scene.rules)
        if not after.accepted:
            payload = Beam(payload.direction, payload.layer, media.pore_variate, payload.roulette)
            stand = Stand(stand.shell, stand.side, after.needs_lobe, after.transmitted)
            continue
        gone = goings(stand, after, float(types.n_shells[kind]), True)
        stand = gone.interface
        if gone.in_pore:
            u = media.pore_variate if after.transmitted else uniform(state)
            return Walk(True, way, Beam(after.direction, payload.layer, u, payload.roulette))
        shell = int(stand.shell) - 1
        if gone.in_core:
            leg, grain = across(grain, after.direction)
            way = along(leg, after.direction, way)
        else:
            leg = film(2.0 * size.semi_major * types.coating_thickness[kind, shell], after, True)
        material = types.material[kind, shell]
        payment = paid(state, payload.roulette, leg, material, optics, scene.rules.analog, path_lengths)
        payload = Beam(after.direction, payload.layer, media.pore_variate, payment.roulette)
        if not payment.alive:
            return Walk(False, way, payload)
