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
    way: Vector
    beam: Beam


class Sides(NamedTuple):
    """The media on both sides of a surface, and the number that decides the pore outside."""

    contrast: Contrast
    u: float


@part
def media_of(state, stand, kind, beam, scene, optics):
    """Return the media that a ray at a grain has on both sides."""
    shell, beyond = int(stand.shell), int(stand.shell + stand.side)
    materials, layers = scene.types.material, scene.layers
    u = beam.u
    # On its way into a lobe a ray keeps the pore that let it through.
    if beyond == 0 and not stand.lobe:
        u = uniform(state)
    here = materials[kind, shell - 1] if shell > 0 else pore_of(layers, beam.layer, u)
    there = materials[kind, beyond - 1] if beyond > 0 else pore_of(layers, beam.layer, u)
    return Sides(contrast(index_of(optics, here), index_of(optics, there)), u)


@part
def trial(state, d, stand, grain, roughness, media, rules):
    """Return what one trial at a grain's surface leads to."""
    facet = facing(d, grain, stand.side)
    u = uniform(state)
    while roughness > 0.0:
        azimuth = unit_circle(state)
        azimuth = Angle(abs(azimuth.cos), azimuth.sin)
        numbers = Numbers(uniform(state), u, 0.0, half_normal(state), azimuth)
        found = rough(d, facet, roughness, numbers, stand.lobe, rules.facets)
        if found.accepted or stand.lobe:
            facet = found
            break
    return outcome(d, stand, facet, media, u, rules.wrong_side != LOBE, EVERYTHING)


@part
def walk(state, beam, found, scene, optics, length):
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
    kind, size, roughness = found.candidate
    grain, types = found.meeting.entry.grain, scene.types
    way = ORIGIN
    stand = Stand(0.0, 1.0, False, False)
    while True:
        media = media_of(state, stand, kind, beam, scene, optics)
        after = trial(state, beam.d, stand, grain, roughness, media.contrast, scene.rules)
        if not after.done:
            beam = Beam(beam.d, beam.layer, media.u, beam.purse)
            stand = Stand(stand.shell, stand.side, after.to_lobe, after.passed)
            continue
        gone = goings(stand, after, float(types.shells[kind]), True)
        stand = gone.stand
        if gone.out:
            u = media.u if after.passed else uniform(state)
            return Walk(True, way, Beam(after.d, beam.layer, u, beam.purse))
        shell = int(stand.shell) - 1
        if gone.core:
            leg, grain = across(grain, after.d)
            way = along(leg, after.d, way)
        else:
            leg = film(2.0 * size.major * types.thickness[kind, shell], after, True)
        material = types.material[kind, shell]
        payment = paid(state, beam.purse, leg, material, optics, scene.rules.analog, length)
        beam = Beam(after.d, beam.layer, media.u, payment.purse)
        if not payment.alive:
            return Walk(False, way, beam)
