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

    direction: Vector
    layer: int
    pore_variate: float
    roulette: Purse


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

    status: int
    geometry: Flier
    payload: Beam
    n_segments: int
    order: int
    max_order: int


class Candidate(NamedTuple):
    """A grain drawn, but not yet met: its type, size and half its facetness."""

    grain_type: int
    size: Size
    roughness: float


class Found(NamedTuple):
    """What a ray meets next, and in which layer; `lost` where nothing was found."""

    grain_sample: Candidate
    collision: Meeting
    layer: int
    lost: bool


class Entered(NamedTuple):
    """Whether a ray from outside passed the sample's face, and what it carries then."""

    continues: bool
    payload: Beam


class Paid(NamedTuple):
    """A purse after a leg, and whether the ray survived it."""

    roulette: Purse
    alive: bool


@part
def ended(ray, status):
    """Return a ray that has come to its end."""
    return Ray(status, ray.geometry, ray.payload, ray.n_segments, ray.order, ray.max_order)


@part
def turned(geometry, direction):
    """Return a ray at the same place that goes along d now."""
    return Flier(geometry.position, geometry.exit_offset, direction, geometry.previous_segment, 0.0)


@part
def paid(state, roulette_state, distance, material, optics, analog, path_lengths):
    """Take a leg through a material, and tell whether the ray goes on.

    Lambert's law, SPLITS section 4.3.4 and SPLITSnow Eqs 5-6: exp(−αd) is the probability to
    pass.  Weighted rays add the leg to `length` (float64[materials], m), and end only by roulette.
    """
    path_lengths[material] += distance
    depth = optics.absorption[material] * distance
    if analog:
        return Paid(roulette_state, depth == 0.0 or uniform(state) < math.exp(-depth))
    return Paid(Purse(roulette_state.optical_depth + depth, roulette_state.next_roulette, roulette_state.weight), True)


@part
def pore_of(layers, layer, pore_variate):
    """Return the material of the pore space for a leg in a layer (SPLITS 4.3.2, SPLITSnow 3.4)."""
    pore = layers.pore[layer]
    if pore_variate < layers.saturation[layer]:
        return pore + 1
    for other in range(layers.pore_cdf.shape[1]):
        if pore_variate < layers.pore_cdf[layer, other]:
            return pore + 2 + other
    return pore


@part
def index_of(optics, material):
    """Return the complex refractive index of a material."""
    return Index(optics.n[material], optics.k[material])


@part
def space_of(layers, layer):
    """Return the space of a layer of a scene."""
    bottom, top = layers.boundaries[layers.boundaries.size - 1], layers.boundaries[0]
    low, high = layers.boundaries[layer + 1], layers.boundaries[layer]
    return Space(1.0 / layers.attenuation[layer], low, high, bottom, top, min(top, 0.0))


@part
def candidate_of(state, scene, layer):
    """Draw type, size, shape and roughness of a grain of a layer."""
    share, types = scene.layers.type_cdf[layer], scene.types
    kind = scene.layers.first_type[layer]
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
            return Aim(aim.u_cos_incidence, unit_circle(state), unit_circle(state), aim.u_axial, aim.u_accept)


@part
def deflected(state, particles, row, direction):
    """Return the direction into which a layer's particle scatters light along d."""
    size = particles.table_size[row]
    phase = Phase(
        particles.kind[row], particles.g[row], 0.0, particles.cosines[row, :size],
        particles.density[row, :size], particles.cdf[row, :size],
    )  # fmt: skip
    return scattered(state, phase, direction)


@part
def fates_of(rules):
    """Return what becomes of grains that do not fit."""
    return Fates(
        rules.entry_sampling,
        rules.segment_overlap != KEPT,
        rules.boundary_overlap != KEPT,
        rules.segment_overlap == SKIPPED,
        rules.boundary_overlap == SKIPPED,
    )
