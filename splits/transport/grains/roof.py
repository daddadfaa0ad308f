"""A randomly rough surface on top of layers of grains and particles (Budak & Grimailo 2020, 3.2).

A ray has a realisation of the surface to itself.  From the sample it meets facets on its way to the
next particle; outside it goes from facet to facet until it is in the sample again, or away.  Where
the top is smooth the roof is None, and all of this is compiled away.
"""

from __future__ import annotations

from splits.transport.compiling.jit import part
from splits.transport.grains.flight import Flier
from splits.transport.grains.scalar import (
    NO_LEG,
    Beam,
    Found,
    Ray,
    ended,
    index_of,
    pore_of,
    turned,
)
from splits.transport.grains.spheroid import Segment
from splits.transport.numerics.rng import uniform
from splits.transport.numerics.vectors import ORIGIN, Vector, along, scaled
from splits.transport.optics.faces import meet
from splits.transport.rough.march import GONE, cleared, first_crossing, no_hit, normal_of
from splits.transport.rough.march import LOST as ASTRAY
from splits.transport.rough.waves import entrance
from splits.transport.sums.tally import ABSORBED, LOST, REFLECTED, TRAVELS

TALLEST = 50.0
"""No point of a realisation is higher than so many standard deviations: `waves.EXTREME` times the
root of −ln u, u the least random number, is below it."""


@part
def facet_ahead(rough_top, geometry, event, segment_length):
    """Return the facet, a `march.Hit`, that a ray in the sample meets before its leg's end (m)."""
    if rough_top is None:
        return no_hit(GONE, 0)
    begin = _begin(geometry)
    if event.lost or max(begin.z, begin.z + segment_length * geometry.direction.z) <= -rough_top.max_height:
        return no_hit(GONE, 0)
    return first_crossing(rough_top, begin, geometry.direction, -1.0, segment_length)


@part
def _begin(geometry):
    """Return where a ray's leg begins."""
    place, way = geometry.position, geometry.exit_offset
    return Vector(place.x + way.x, place.y + way.y, place.z + way.z)


@part
def cut_short(geometry, event, hit, layer_bottom):
    """Return a ray that a facet stops on its way, and what it found: nothing, in the top layer.

    The surface should end above the layer's lower face, `low` (m); see `Layer.depth_m`.
    """
    place = along(hit.distance, geometry.direction, _begin(geometry))
    geometry = Flier(place, ORIGIN, geometry.direction, Segment(ORIGIN, geometry.direction, hit.distance), 0.0)
    lost = hit.distance == ASTRAY or place.z < layer_bottom
    return geometry, Found(event.grain_sample, event.collision, 0, lost)


@part
def aimed(direction, roulette_state, rough_top, max_order):
    """Return a ray along d from outside that aims at the origin of the mean surface."""
    flier = Flier(entrance(direction, rough_top), ORIGIN, direction, NO_LEG, 0.0)
    return Ray(TRAVELS, flier, Beam(direction, 0, 0.0, roulette_state), 0, 0, max_order)


@part
def at_facet(state, ray, slope, side, scene, optics):
    """Return a ray that a facet reflects or refracts, and the side of the surface on which it is.

    Parameters
    ----------
    state, ray, scene, optics
        See `splits.transport.grains.granular.follow`.
    slope : Slope
        Of the facet.
    side : float
        1 where the ray comes from outside, −1 from the sample.
    """
    # Particles lie below: the pores that light comes to from there are new every time.
    u = uniform(state)
    inside = index_of(optics, pore_of(scene.layers, 0, u))
    outside = index_of(optics, scene.layers.pore[0])
    near = outside if side > 0.0 else inside
    far = inside if side > 0.0 else outside
    normal = normal_of(slope)
    crossing = meet(ray.payload.direction, scaled(side, normal), near, far, uniform(state))
    side = -side if crossing.transmitted else side
    d = cleared(crossing.direction, scaled(side, normal))
    beam = Beam(d, 0, u, ray.payload.roulette)
    return Ray(ray.status, turned(ray.geometry, d), beam, ray.n_segments, ray.order + 1, ray.max_order), side


@part
def outside(state, ray, scene, optics, rough_top):
    """Follow a ray above the surface until it is in the sample, or away.

    Returns
    -------
    Ray
        Its fate `TRAVELS` in the sample, `REFLECTED`, `LOST`, or `ABSORBED` where it has met as
        many facets and grains as it may.
    """
    side = 1.0
    while side > 0.0:
        hit = first_crossing(rough_top, ray.geometry.position, ray.payload.direction, side)
        if hit.distance < 0.0:
            away = hit.distance == GONE and ray.payload.direction.z > 0.0
            return ended(ray, REFLECTED if away else LOST)
        if ray.order >= ray.max_order:
            return ended(ray, ABSORBED)
        place = along(hit.distance, ray.payload.direction, ray.geometry.position)
        flier = Flier(place, ORIGIN, ray.payload.direction, NO_LEG, 0.0)
        ray = Ray(TRAVELS, flier, ray.payload, ray.n_segments, ray.order, ray.max_order)
        ray, side = at_facet(state, ray, hit.slope, side, scene, optics)
    return ray


@part
def struck(state, ray, slope, scene, optics, rough_top):
    """Return a ray from the sample after a facet: sent back, away, or in the sample again.

    Parameters are those of `at_facet` and `outside`.
    """
    if rough_top is None:
        return ray
    if ray.order >= ray.max_order:
        return ended(ray, ABSORBED)
    ray, side = at_facet(state, ray, slope, -1.0, scene, optics)
    return outside(state, ray, scene, optics, rough_top) if side > 0.0 else ray
