"""Geometry and motion of the rays of lanes between grains."""

from __future__ import annotations

from splits.kernels.base.ray import Ray, Segment
from splits.kernels.compiler.jit import ONE, ZERO, inline_only
from splits.kernels.math.vectors import Vector, select


@inline_only
def load_ray(lane):
    """Return the `Ray` of a lane, with None for the fields that a flight does not need."""
    previous_segment = Segment(
        lane.previous_direction, lane.previous_direction, lane.previous_length
    )
    return Ray(
        None, lane.position, lane.exit_offset, lane.direction, previous_segment,
        lane.start_distance, None, None, lane.weight, lane.optical_depth, lane.next_roulette,
        None, None, None, None,
    )  # fmt: skip


@inline_only
def has_left_layer(lane, ray, layer_geometry):
    """Return whether a ray left a grain on the other side of a boundary between layers."""
    z = ray.position.z + ray.exit_offset.z
    above = (z > layer_geometry.top) & (layer_geometry.top < layer_geometry.slab_top)
    below = (z < layer_geometry.bottom) & (layer_geometry.bottom > layer_geometry.slab_bottom)
    return (lane.layer == lane.flight_layer) & (not lane.on_boundary) & (above | below)


@inline_only
def move_to_grain(lane, ray, collision, accepted, features):
    """Move the ray of a lane to the accepted grain, if there is one."""
    position, exit_offset, d, distance = (
        ray.position, ray.exit_offset, ray.direction, collision.distance
    )  # fmt: skip
    entry_point = Vector(
        position.x + exit_offset.x + distance * d.x,
        position.y + exit_offset.y + distance * d.y,
        collision.height,
    )
    lane.position = select(accepted, entry_point, position)
    lane.exit_offset = select(accepted, Vector(ZERO, ZERO, ZERO), exit_offset)
    lane.previous_direction = select(accepted, d, ray.previous_segment.direction)
    lane.previous_length = select(accepted, distance, ray.previous_segment.length)
    # In layered scenes the segment is attenuated between the passes.
    if features.layered is None:
        attenuate(lane, select(accepted, distance, ZERO), features)


@inline_only
def move_to_boundary(lane, ray, boundary_hit):
    """Move the ray of a lane to the boundary ahead."""
    lane.position = boundary_hit.position
    lane.exit_offset = Vector(ZERO, ZERO, ZERO)
    lane.previous_direction, lane.previous_length = ray.direction, boundary_hit.distance


@inline_only
def attenuate(lane, distance, features):
    """Attenuate the ray of a lane along a distance in its pore."""
    dry_path = distance
    if features.wet is not None:
        wet_path = select(lane.pore_wet, distance, ZERO)
        dry_path = select(lane.pore_wet, ZERO, distance)
        lane.wet_path += wet_path
        lane.optical_depth += wet_path * lane.wet.material.absorption
    lane.dry_path += dry_path
    lane.optical_depth += dry_path * lane.dry.material.absorption


@inline_only
def store_grain(lane, grain, accepted, features):
    """Store the accepted grain of a lane, if there is one."""
    lane.grain = select(accepted, grain, lane.grain)
    lane.shell, lane.side = select(accepted, ZERO, lane.shell), select(accepted, ONE, lane.side)
    if features.faceted is not None:
        lane.roughness = select(accepted, lane.new_roughness, lane.roughness)
    if features.mixed is not None:
        lane.grain_type = select(accepted, lane.new_type, lane.grain_type)
