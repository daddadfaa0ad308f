"""A randomly rough surface on top of layers of grains and particles (Budak & Grimailo 2020, 3.2).

A ray has a realisation of the surface to itself.  From the sample it meets facets on its way to the
next particle; outside it goes from facet to facet until it is in the sample again, or away.  Where
the top is smooth the roof is None, and all of this is compiled away.
"""

from __future__ import annotations

from splits.kernels.compiler.jit import inline_only
from splits.kernels.grains.free_path import RayGeometry
from splits.kernels.grains.spheroid import Segment
from splits.kernels.grains.state import (
    NO_SEGMENT,
    NextEvent,
    Ray,
    RayPayload,
    pore_material,
    refractive_index_of,
    terminate,
    with_direction,
)
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import ORIGIN, Vector, add_scaled, scale
from splits.kernels.optics.interface import sample_interface
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    compute_normal_from_slope,
    find_first_intersection,
    make_no_hit,
    nudge_off_surface,
)
from splits.kernels.rough_surface.intersection import STEP_LIMIT_REACHED as ASTRAY
from splits.kernels.rough_surface.realization import compute_entry_position
from splits.kernels.tallies.exits import ABSORBED, ALIVE, LOST, REFLECTED

MAX_HEIGHT_SIGMA = 50.0
"""No point of a realisation is higher than so many standard deviations: `waves.EXTREME` times the
root of −ln u, u the least random number, is below it."""


@inline_only
def intersect_rough_top(rough_top, geometry, event, segment_length):
    """Return the facet, a `march.Hit`, that a ray in the sample meets before its leg's end (m)."""
    if rough_top is None:
        return make_no_hit(NO_HIT, 0)
    begin = _compute_segment_start(geometry)
    if (
        event.lost
        or max(begin.z, begin.z + segment_length * geometry.direction.z) <= -rough_top.max_height
    ):
        return make_no_hit(NO_HIT, 0)
    return find_first_intersection(rough_top, begin, geometry.direction, -1.0, segment_length)


@inline_only
def _compute_segment_start(geometry):
    """Return where a ray's leg begins."""
    place, way = geometry.position, geometry.exit_offset
    return Vector(place.x + way.x, place.y + way.y, place.z + way.z)


@inline_only
def stop_at_facet(geometry, event, hit, layer_bottom):
    """Return a ray that a facet stops on its way, and what it found: nothing, in the top layer.

    The surface should end above the layer's lower face, `layer_bottom` (m); see `Layer.depth_m`.
    """
    place = add_scaled(hit.distance, geometry.direction, _compute_segment_start(geometry))
    geometry = RayGeometry(
        place, ORIGIN, geometry.direction, Segment(ORIGIN, geometry.direction, hit.distance), 0.0
    )
    lost = hit.distance == ASTRAY or place.z < layer_bottom
    return geometry, NextEvent(event.grain_sample, event.collision, 0, lost)


@inline_only
def make_incident_ray(direction, roulette_state, rough_top, max_order):
    """Return a ray along d from outside that aims at the origin of the mean surface."""
    flier = RayGeometry(
        compute_entry_position(direction, rough_top), ORIGIN, direction, NO_SEGMENT, 0.0
    )
    return Ray(ALIVE, flier, RayPayload(direction, 0, 0.0, roulette_state), 0, 0, max_order)


@inline_only
def scatter_at_facet(state, ray, slope, side, scene, optics):
    """Return a ray that a facet reflects or refracts, and the side of the surface on which it is.

    Parameters
    ----------
    state, ray, scene, optics
        See `splits.kernels.grains.history.trace_history`.
    slope : Slope
        Of the facet.
    side : float
        1 where the ray comes from outside, −1 from the sample.
    """
    # Particles lie below: the pores that light comes to from there are new every time.
    u = uniform(state)
    inside = refractive_index_of(optics, pore_material(scene.layers, 0, u))
    outside = refractive_index_of(optics, scene.layers.pore[0])
    near = outside if side > 0.0 else inside
    far = inside if side > 0.0 else outside
    normal = compute_normal_from_slope(slope)
    crossing = sample_interface(
        ray.payload.direction, scale(side, normal), near, far, uniform(state)
    )
    side = -side if crossing.transmitted else side
    d = nudge_off_surface(crossing.direction, scale(side, normal))
    beam = RayPayload(d, 0, u, ray.payload.roulette)
    return Ray(
        ray.status,
        with_direction(ray.geometry, d),
        beam,
        ray.n_segments,
        ray.order + 1,
        ray.max_order,
    ), side


@inline_only
def trace_above_surface(state, ray, scene, optics, rough_top):
    """Follow a ray above the surface until it is in the sample, or away.

    Returns
    -------
    Ray
        Its fate `ALIVE` in the sample, `REFLECTED`, `STEP_LIMIT_REACHED`, or `ABSORBED` where it has met as
        many facets and grains as it may.
    """
    side = 1.0
    while side > 0.0:
        hit = find_first_intersection(rough_top, ray.geometry.position, ray.payload.direction, side)
        if hit.distance < 0.0:
            away = hit.distance == NO_HIT and ray.payload.direction.z > 0.0
            return terminate(ray, REFLECTED if away else LOST)
        if ray.order >= ray.max_order:
            return terminate(ray, ABSORBED)
        place = add_scaled(hit.distance, ray.payload.direction, ray.geometry.position)
        flier = RayGeometry(place, ORIGIN, ray.payload.direction, NO_SEGMENT, 0.0)
        ray = Ray(ALIVE, flier, ray.payload, ray.n_segments, ray.order, ray.max_order)
        ray, side = scatter_at_facet(state, ray, hit.slope, side, scene, optics)
    return ray


@inline_only
def interact_at_rough_top(state, ray, slope, scene, optics, rough_top):
    """Return a ray from the sample after a facet: sent back, away, or in the sample again.

    Parameters are those of `scatter_at_facet` and `trace_above_surface`.
    """
    if rough_top is None:
        return ray
    if ray.order >= ray.max_order:
        return terminate(ray, ABSORBED)
    ray, side = scatter_at_facet(state, ray, slope, -1.0, scene, optics)
    return trace_above_surface(state, ray, scene, optics, rough_top) if side > 0.0 else ray
