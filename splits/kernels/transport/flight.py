"""Free flights through layers of grains and of particles: next event, motion and attenuation.

A boundary between layers reflects and refracts only where the pore media on its sides differ.
Elsewhere the distance is sampled anew from the boundary, because free paths have no memory, and a
grain belongs to the layer in which the ray hits it.  The pore of a path segment is sampled once, so
it changes at a boundary between layers only where their wet fractions or pore fluids differ.
Splitting a layer in two therefore leaves the distribution of results unchanged.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.compiler.jit import inline_only, replace
from splits.kernels.grains.grain_path import (
    GrainSample,
    attenuate,
    get_layer_geometry,
    make_placeholder_grain,
    make_rejection_rules,
    pore_material,
    refractive_index_of,
    sample_entry_variates,
    sample_grain,
)
from splits.kernels.grains.spheroid import (
    MAX_REJECTIONS,
    Collision,
    EntryPoint,
    compute_boundary_hit,
    sample_collision,
)
from splits.kernels.rays import compute_position
from splits.kernels.rng import uniform
from splits.kernels.rough_surface.realization import SurfaceSlope
from splits.kernels.scene import (
    ALIVE,
    LOST,
    NO_PARTICLES,
    ORIGIN,
    Segment,
    Vector,
)
from splits.kernels.tallies.exits import append_crossing, encode_crossing

COLLISION, BOUNDARY, ROUGH_TOP, NO_EVENT = range(4)
"""Kinds of events: a grain or a particle, a layer boundary, the rough top, or none was found."""


class Event(NamedTuple):
    """Next event of a ray.

    Attributes
    ----------
    kind : int
        `COLLISION`, `BOUNDARY`, `ROUGH_TOP`, or `NO_EVENT`.
    layer : int
        Layer in which it is.
    distance : float
        Length of the path segment that it ends (m).
    position : Vector
        Where it is (m).
    grain_sample : GrainSample
    entry : EntryPoint
        The sampled grain, which only a `COLLISION` hits.
    slope : SurfaceSlope
        Slope of the facet of a `ROUGH_TOP`.
    """

    kind: int
    layer: int
    distance: float
    position: Vector
    grain_sample: GrainSample
    entry: EntryPoint
    slope: SurfaceSlope


@inline_only
def find_adjacent_layer(layer, direction):
    """Return the layer on the other side of the boundary ahead of a ray.

    Above the sample it is −1, below the sample the number of layers.
    """
    return layer - 1 if direction.z > 0.0 else layer + 1


@inline_only
def find_next_material(layers, layer, next_layer, pore_variate):
    """Return the material behind the boundary ahead of a ray: a pore, or the medium outside."""
    if 0 <= next_layer < layers.collision_coefficient.size:
        return pore_material(layers, next_layer, pore_variate)
    return layers.first_pore_material[layer]


@inline_only
def is_continuous(layers, optics, layer, other, pore_variate):
    """Return whether `other` is a layer whose pores have the refractive index of those of `layer`.

    Rays then pass from one to the other without an interface.
    """
    if not 0 <= other < layers.collision_coefficient.size:
        return False
    a = refractive_index_of(optics, pore_material(layers, layer, pore_variate))
    b = refractive_index_of(optics, pore_material(layers, other, pore_variate))
    return a.n == b.n and a.k == b.k


@inline_only
def record_crossing(ray, upward, scene, path_lengths, crossings):
    """Record the crossing of a ray into the next layer, if the scene records crossings."""
    if crossings is not None and scene.record_crossings:
        append_crossing(crossings, encode_crossing(ray.layer, upward), ray.weight, path_lengths)


@inline_only
def locate_layer(ray, scene, optics, path_lengths, crossings):
    """Return a ray after a grain, with the layer in which it is now.

    A grain that extends across a boundary may release a ray on the other side.  If the pores there
    have another index, as outside the sample, the ray is moved vertically to that boundary.
    """
    if scene.types is None:
        return ray
    layers, z = scene.layers, compute_position(ray).z
    while z > layers.boundaries[ray.layer] or z < layers.boundaries[ray.layer + 1]:
        upward = z > layers.boundaries[ray.layer]
        next_layer = ray.layer - 1 if upward else ray.layer + 1
        if not is_continuous(layers, optics, ray.layer, next_layer, ray.pore_variate):
            z = layers.boundaries[ray.layer if upward else ray.layer + 1]
            break
        record_crossing(ray, upward, scene, path_lengths, crossings)
        ray = replace(ray, layer=next_layer)
    exit_offset = Vector(ray.exit_offset.x, ray.exit_offset.y, z - ray.position.z)
    return replace(ray, exit_offset=exit_offset, start_distance=0.0)


@inline_only
def sample_particle_collision(flight, u, layer_geometry, entry):
    """Sample the `Collision` with a particle, a point that overlaps nothing.

    Its entry point is the placeholder `entry`.
    """
    distance = flight.start_distance - math.log(u) * layer_geometry.mean_free_path
    height = compute_position(flight).z + distance * flight.direction.z
    outside = height < layer_geometry.bottom
    if flight.direction.z > 0.0:
        outside = height > layer_geometry.top
    return Collision(distance, height, entry, outside, not outside, 0.0)


@inline_only
def sample_layer_collision(state, flight, scene, layer_geometry, rules):
    """Sample the `GrainSample` and the `Collision` of a ray, which may lie outside its layer.

    In a layer of particles the grain is a placeholder.

    Parameters
    ----------
    state, scene
        See `splits.kernels.transport.history.trace_history`.
    flight : Ray
        With the layer and the distance at which the sampling starts.
    layer_geometry : LayerGeometry
    rules : RejectionRules
    """
    if scene.types is None or (
        scene.particles is not None and scene.layers.particle_row[flight.layer] != NO_PARTICLES
    ):
        grain_sample, entry = make_placeholder_grain(scene.types)
        collision = sample_particle_collision(flight, uniform(state), layer_geometry, entry)
        return grain_sample, collision
    grain_sample = sample_grain(state, scene, flight.layer)
    variates = sample_entry_variates(state, grain_sample.size)
    collision = sample_collision(
        flight, grain_sample.size, variates, uniform(state), layer_geometry, rules
    )
    return grain_sample, collision


@inline_only
def sample_next_event(state, ray, scene, optics):
    """Sample the next grain or particle on a ray, or find the boundary that it reaches first.

    After a rejected grain, another one is sampled from the start of the segment, from the last
    skipped grain, or from the end of the last layer of particles.
    """
    layers, rules = scene.layers, make_rejection_rules(scene.rules)
    restart = replace(ray, start_distance=0.0)
    flight = restart
    n_rejected = 0
    while True:
        geometry = get_layer_geometry(layers, flight.layer)
        grain_sample, collision = sample_layer_collision(state, flight, scene, geometry, rules)
        if collision.accepted:
            kind, distance, height = COLLISION, collision.distance, collision.height
            break
        # Segments are memoryless (SPLITSnow Eq 1): sampling goes on behind a boundary that does not
        # refract, with the mean distance of the next layer.
        if collision.leaves_layer:
            boundary_hit = compute_boundary_hit(ray, geometry)
            distance, height = boundary_hit.distance, boundary_hit.position.z
            next_layer = find_adjacent_layer(flight.layer, ray.direction)
            if not is_continuous(layers, optics, flight.layer, next_layer, ray.pore_variate):
                kind = BOUNDARY
                break
            # After a rejected grain, a layer of particles that was passed is not sampled again.
            passed_particles = layers.particle_row[flight.layer] != NO_PARTICLES
            flight = replace(flight, layer=next_layer, start_distance=distance)
            restart = flight if passed_particles else restart
            continue
        if collision.start_distance == collision.distance:
            # The rejected grain was skipped.
            restart = replace(flight, start_distance=collision.start_distance)
        flight = restart
        n_rejected += 1
        if n_rejected == MAX_REJECTIONS:
            kind, distance, height = NO_EVENT, collision.distance, collision.height
            break
    x = ray.position.x + ray.exit_offset.x + distance * ray.direction.x
    y = ray.position.y + ray.exit_offset.y + distance * ray.direction.y
    position = Vector(x, y, height)
    no_slope = SurfaceSlope(0.0, 0.0)
    return Event(kind, flight.layer, distance, position, grain_sample, collision.entry, no_slope)


@inline_only
def end_segment(ray, event):
    """Return a ray at its next event, `LOST` without one."""
    return replace(
        ray, status=LOST if event.kind == NO_EVENT else ray.status, position=event.position,
        exit_offset=ORIGIN, previous_segment=Segment(ORIGIN, ray.direction, event.distance),
        start_distance=0.0, n_segments=ray.n_segments + 1,
    )  # fmt: skip


@inline_only
def attenuate_segment(state, ray, last_layer, scene, optics, path_lengths, crossings):
    """Attenuate a ray along its previous segment, through the pores of all layers that it crosses.

    Parameters
    ----------
    ray : Ray
        At the end of the segment, with the layer of its start.
    last_layer : int
        Layer of its end.
    path_lengths, crossings
        See `splits.kernels.transport.history.trace_history`.
    """
    layers, d, analog = scene.layers, ray.direction, scene.rules.analog
    remaining = ray.previous_segment.length
    z = ray.position.z - remaining * d.z
    while ray.layer != last_layer and ray.status == ALIVE:
        boundary = layers.boundaries[ray.layer] if d.z > 0.0 else layers.boundaries[ray.layer + 1]
        length = min(max((boundary - z) / d.z, 0.0), remaining)
        pore = pore_material(layers, ray.layer, ray.pore_variate)
        ray = attenuate(state, ray, length, pore, optics, analog, path_lengths)
        if ray.status == ALIVE:
            record_crossing(ray, d.z > 0.0, scene, path_lengths, crossings)
        z, remaining = boundary, remaining - length
        ray = replace(ray, layer=find_adjacent_layer(ray.layer, d))
    if ray.status == ALIVE:
        pore = pore_material(layers, ray.layer, ray.pore_variate)
        ray = attenuate(state, ray, remaining, pore, optics, analog, path_lengths)
    return ray
