"""Free flights of the scalar kernel through layers of grains: next event, motion and attenuation.

A boundary between layers reflects and refracts only where the pore media on its sides differ.
Elsewhere the distance is sampled anew from the boundary, because free paths have no memory, and a
grain belongs to the layer in which the ray hits it.  The pore of a path segment is sampled once, so
it changes at a boundary between layers only where their wet fractions or pore fluids differ.
Splitting a layer in two therefore leaves the distribution of results unchanged.
"""

from __future__ import annotations

from splits.kernels.compiler.jit import inline_only
from splits.kernels.grains.free_path import (
    RayGeometry,
    RejectionRules,
    compute_boundary_hit,
    sample_collision,
)
from splits.kernels.grains.scene import MAX_REJECTIONS, NO_PARTICLES
from splits.kernels.grains.spheroid import Segment
from splits.kernels.grains.state import (
    AttenuationResult,
    NextEvent,
    RayPayload,
    attenuate,
    get_layer_geometry,
    make_rejection_rules,
    pore_material,
    refractive_index_of,
    sample_entry_variates,
    sample_grain,
)
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import ORIGIN, Vector
from splits.kernels.tallies.crossings import append_crossing, encode_crossing


@inline_only
def find_adjacent_layer(layers, layer, direction):
    """Return the layer on the other side of the boundary ahead of a ray.

    Above the sample it is −1, below the sample the number of layers.
    """
    return layer - 1 if direction.z > 0.0 else layer + 1


@inline_only
def has_same_refractive_index(layers, optics, layer, other, pore_variate):
    """Return whether the pores of two layers have the same complex refractive index."""
    a = refractive_index_of(optics, pore_material(layers, layer, pore_variate))
    b = refractive_index_of(optics, pore_material(layers, other, pore_variate))
    return a.n == b.n and a.k == b.k


@inline_only
def record_crossing(crossings, scene, layer, upward, roulette_state, path_lengths):
    """Record the crossing of a ray into the next layer, if the scene records crossings."""
    if crossings is not None and scene.record_crossings:
        append_crossing(
            crossings,
            encode_crossing(layer if upward else layer + 1, upward),
            roulette_state.weight,
            path_lengths,
        )


@inline_only
def locate_layer(geometry, payload, scene, optics, path_lengths, crossings):
    """Return a ray after a grain, with the layer in which it is now.

    A grain that extends across a boundary may release a ray on the other side.  If the pores there
    have another index, as outside the sample, the ray is moved vertically to that boundary.
    """
    layers = scene.layers
    z = geometry.position.z + geometry.exit_offset.z
    layer = payload.layer
    while z > layers.boundaries[layer] or z < layers.boundaries[layer + 1]:
        step = -1 if z > layers.boundaries[layer] else 1
        boundary = layers.boundaries[layer] if step < 0 else layers.boundaries[layer + 1]
        next_layer = layer + step
        inside = 0 <= next_layer < layers.collision_coefficient.size
        if not inside or not has_same_refractive_index(
            layers, optics, layer, next_layer, payload.pore_variate
        ):
            z = boundary
            break
        record_crossing(crossings, scene, layer, step < 0, payload.roulette, path_lengths)
        layer = next_layer
    exit_offset = Vector(geometry.exit_offset.x, geometry.exit_offset.y, z - geometry.position.z)
    return RayGeometry(
        geometry.position, exit_offset, payload.direction, geometry.previous_segment, 0.0
    ), RayPayload(payload.direction, layer, payload.pore_variate, payload.roulette)


@inline_only
def sample_next_event(state, geometry, payload, scene, optics):
    """Sample the next grain on a ray, or find the boundary that it reaches first.

    After a rejected grain, another one is sampled from the start of the segment, from the last
    skipped grain, or from the end of the last layer of particles.
    """
    layers, default_rules = scene.layers, make_rejection_rules(scene.rules)
    restart_layer, layer = payload.layer, payload.layer
    flight_geometry = RayGeometry(
        geometry.position, geometry.exit_offset, geometry.direction, geometry.previous_segment, 0.0
    )
    n_rejected = 0
    while True:
        layer_geometry = get_layer_geometry(layers, layer)
        grain_sample = sample_grain(state, scene, layer)
        variates = sample_entry_variates(state, grain_sample.size.flattening)
        rejection_rules = default_rules
        if layers.particle_row[layer] != NO_PARTICLES:
            # Particles are points and never overlap anything; the grain is a placeholder.
            rejection_rules = RejectionRules(
                default_rules.entry_sampling, False, False, False, False
            )
        collision = sample_collision(
            flight_geometry,
            grain_sample.size,
            variates,
            uniform(state),
            layer_geometry,
            rejection_rules,
        )
        if collision.accepted:
            return NextEvent(grain_sample, collision, layer, False)
        if collision.leaves_layer:
            next_layer = find_adjacent_layer(layers, layer, geometry.direction)
            inside = 0 <= next_layer < layers.collision_coefficient.size
            if not inside or not has_same_refractive_index(
                layers, optics, layer, next_layer, payload.pore_variate
            ):
                return NextEvent(grain_sample, collision, layer, False)
            boundary_distance = compute_boundary_hit(geometry, layer_geometry).distance
            flight_geometry = RayGeometry(
                geometry.position,
                geometry.exit_offset,
                geometry.direction,
                geometry.previous_segment,
                boundary_distance,
            )
            if layers.particle_row[layer] != NO_PARTICLES:
                # After a rejected grain, a layer of particles that was passed is not sampled again.
                restart_layer, geometry = next_layer, flight_geometry
            layer = next_layer
            continue
        if collision.start_distance == collision.distance:
            # The rejected grain was skipped.
            restart_layer = layer
            geometry = RayGeometry(
                geometry.position,
                geometry.exit_offset,
                geometry.direction,
                geometry.previous_segment,
                collision.start_distance,
            )
        layer = restart_layer
        flight_geometry = geometry
        n_rejected += 1
        if n_rejected == MAX_REJECTIONS:
            return NextEvent(grain_sample, collision, layer, True)


@inline_only
def move_to_event(geometry, event, layer_geometry):
    """Return a ray at the grain that it hits, or at the boundary that comes first."""
    distance, height = event.collision.distance, event.collision.height
    if event.collision.leaves_layer:
        boundary_hit = compute_boundary_hit(geometry, layer_geometry)
        distance, height = boundary_hit.distance, boundary_hit.position.z
    x = geometry.position.x + geometry.exit_offset.x + distance * geometry.direction.x
    y = geometry.position.y + geometry.exit_offset.y + distance * geometry.direction.y
    return RayGeometry(
        Vector(x, y, height),
        ORIGIN,
        geometry.direction,
        Segment(ORIGIN, geometry.direction, distance),
        0.0,
    )


@inline_only
def attenuate_segment(state, payload, event, segment, scene, optics, path_lengths, crossings):
    """Attenuate a ray along a segment through the pores of all layers that it crosses.

    Parameters
    ----------
    payload : RayPayload
        At the start of the segment.
    event : NextEvent
        At its end.
    segment : Segment
        With its end as a position (m).
    path_lengths, crossings
        See `splits.kernels.grains.history.trace_history`.
    """
    layers, d, analog = scene.layers, payload.direction, scene.rules.analog
    attenuation = AttenuationResult(payload.roulette, True)
    remaining, layer = segment.length, payload.layer
    z = segment.end.z - segment.length * d.z
    while layer != event.layer and attenuation.alive:
        boundary = layers.boundaries[layer] if d.z > 0.0 else layers.boundaries[layer + 1]
        length = min(max((boundary - z) / d.z, 0.0), remaining)
        pore = pore_material(layers, layer, payload.pore_variate)
        attenuation = attenuate(
            state, attenuation.roulette, length, pore, optics, analog, path_lengths
        )
        if attenuation.alive:
            record_crossing(crossings, scene, layer, d.z > 0.0, attenuation.roulette, path_lengths)
        z, remaining, layer = boundary, remaining - length, find_adjacent_layer(layers, layer, d)
    if attenuation.alive:
        pore = pore_material(layers, layer, payload.pore_variate)
        attenuation = attenuate(
            state, attenuation.roulette, remaining, pore, optics, analog, path_lengths
        )
    return attenuation
