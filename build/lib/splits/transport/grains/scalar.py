"""What the scalar kernel knows of a ray on its way, and how it draws its random numbers."""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.transport.compiling.jit import part
from splits.transport.grains.flight import Fates, Flier, Meeting, Purse, Space
from splits.transport.grains.scene import KEPT, SKIPPED
from splits.transport.grains.spheroid import Aim, Segment, Size, placed
from splits.transport.numerics.elementary import Angle
from splits.transport.numerics.rng import from_table, pick, uniform, unit_circle
from splits.transport.numerics.vectors import ORIGIN, Vector
from splits.transport.optics.faces import Index
from splits.transport.optics.phase import Phase, scattered

_FORWARD = Angle(1.0, 0.0)

NO_LEG = Segment(ORIGIN, Vector(0.0, 0.0, -1.0), -1.0)
"""In place of the leg travelled last, for a ray that has not travelled yet."""


class Beam(NamedTuple):
    """What a ray carries besides its place.

    Attributes
    ----------
    d : Vector
    layer : int
        Of the scene, in which it is.
    u : float
        The number that decides its pore: wet where it is below the layer's saturation.
    purse : Purse
    """

    d: Vector
    layer: int
    u: float
    purse: Purse


class Ray(NamedTuple):
    """A ray between grains, or at its end.

    Attributes
    ----------
    fate : int
        `TRAVELS`, or how it ended.
    flier : Flier
    beam : Beam
    legs, order : int
        Legs through the sample, which is what the ray cost, and grains, particles and facets of a
        rough surface met.
    most : int
        As many of these, after which it counts as absorbed.
    """

    fate: int
    flier: Flier
    beam: Beam
    legs: int
    order: int
    most: int


class Candidate(NamedTuple):
    """A grain drawn, but not yet met: its type, size and half its facetness."""

    kind: int
    size: Size
    roughness: float


class Found(NamedTuple):
    """What a ray meets next, and in which layer; `lost` where nothing was found."""

    candidate: Candidate
    meeting: Meeting
    layer: int
    lost: bool


class Entered(NamedTuple):
    """Whether a ray from outside passed the sample's face, and what it carries then."""

    passed: bool
    beam: Beam


class Paid(NamedTuple):
    """A purse after a leg, and whether the ray survived it."""

    purse: Purse
    alive: bool


@part
def ended(ray, fate):
    """Return a ray that has come to its end."""
    return Ray(fate, ray.flier, ray.beam, ray.legs, ray.order, ray.most)


@part
def turned(flier, d):
    """Return a ray at the same place that goes along d now."""
    return Flier(flier.place, flier.way, d, flier.last, 0.0)


@part
def paid(state, purse, leg, material, optics, analog, length):
    """Take a leg through a material, and tell whether the ray goes on.

    Lambert's law, SPLITS section 4.3.4 and SPLITSnow Eqs 5-6: exp(−αd) is the probability to
    pass.  Weighted rays add the leg to `length` (float64[materials], m), and end only by roulette.
    """
    length[material] += leg
    depth = optics.absorption[material] * leg
    if analog:
        return Paid(purse, depth == 0.0 or uniform(state) < math.exp(-depth))
    return Paid(Purse(purse.depth + depth, purse.limit, purse.weight), True)


@part
def pore_of(layers, layer, u):
    """Return the material of the pore space for a leg in a layer (SPLITS 4.3.2, SPLITSnow 3.4)."""
    pore = layers.pore[layer]
    if u < layers.saturation[layer]:
        return pore + 1
    for other in range(layers.others.shape[1]):
        if u < layers.others[layer, other]:
            return pore + 2 + other
    return pore


@part
def index_of(optics, material):
    """Return the complex refractive index of a material."""
    return Index(optics.n[material], optics.k[material])


@part
def space_of(layers, layer):
    """Return the space of a layer of a scene."""
    bottom, top = layers.face[layers.face.size - 1], layers.face[0]
    low, high = layers.face[layer + 1], layers.face[layer]
    return Space(1.0 / layers.attenuation[layer], low, high, bottom, top, min(top, 0.0))


@part
def candidate_of(state, scene, layer):
    """Draw type, size, shape and roughness of a grain of a layer."""
    share, types = scene.layers.share[layer], scene.types
    kind = scene.layers.first[layer]
    if share.size > 1:
        kind += pick(share, uniform(state))
    major = 1.0 / from_table(types.curvature, kind, uniform(state))
    sphericity = from_table(types.sphericity, kind, uniform(state))
    roughness = 0.5 * from_table(types.facetness, kind, uniform(state))
    return Candidate(kind, Size(major, 1.0 - sphericity * sphericity), roughness)


@part
def aim_of(state, flattening):
    """Draw how a ray strikes a grain."""
    while True:
        aim = Aim(uniform(state), _FORWARD, _FORWARD, uniform(state), uniform(state))
        if placed(aim, flattening):
            return Aim(aim.facing, unit_circle(state), unit_circle(state), aim.axial, aim.area)


@part
def deflected(state, particles, row, d):
    """Return the direction into which a layer's particle scatters light along d."""
    size = particles.size[row]
    phase = Phase(
        particles.kind[row], particles.g[row], 0.0, particles.cosines[row, :size],
        particles.density[row, :size], particles.quantiles[row, :size],
    )  # fmt: skip
    return scattered(state, phase, d)


@part
def fates_of(rules):
    """Return what becomes of grains that do not fit."""
    return Fates(
        rules.entry,
        rules.on_last_leg != KEPT,
        rules.across_boundary != KEPT,
        rules.on_last_leg == SKIPPED,
        rules.across_boundary == SKIPPED,
    )
