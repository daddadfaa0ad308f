"""Roulette, sampling of the next grain and of the distance to it, and distance to a boundary.

SPLITS section 4.3.3 and SPLITSnow section 3.1: only the grain that the ray hits exists.  Distance,
type, size, shape, orientation and entry point are sampled.  A grain that extends beyond the sample
or overlaps the previous path segment is rejected unless the rules keep it.  The functions serve the
scalar and the vectorized kernel, in either precision, without loops and without branches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.base.ray import Segment, compute_position
from splits.kernels.compiler.jit import ONE, ZERO, float32_constant, inline
from splits.kernels.grains.spheroid import (
    EntryPoint,
    overlaps_boundary,
    overlaps_segment,
    sample_entry_point,
)
from splits.kernels.math.arithmetic import fma
from splits.kernels.math.elementary import log
from splits.kernels.math.vectors import Vector, linear_combination

MAX_REJECTIONS = 10_000_000
"""Successive rejections after which a ray counts as lost.

At grazing incidence few grains fit below the boundary: 3e5 are rejected on average at 89.9999
degrees.
"""

ROULETTE_THRESHOLD = 0.6
ROULETTE_SURVIVAL_PROBABILITY = ROULETTE_THRESHOLD
FIRST_ROULETTE_DEPTH = -math.log(ROULETTE_THRESHOLD)
"""Optical depth at which a weighted ray first plays Russian roulette.

The cost of a path grows with its length, not its weight, so low-weight paths are terminated by
roulette.  The optical depth is that of absorption, the minimum over the wavelengths that use the
path, so its weight is low for all of them.  The product of the inverse probability of survival and
exp(−optical depth) never exceeds 1.
"""
# Both precisions use these rounded values.  A game therefore changes the expected weight by +1.6e-8
# of it in the scalar kernel, and by −1.8e-7 on lanes, whose u has 21 bits.
_NEXT_ROULETTE_STEP = float32_constant(-math.log(ROULETTE_SURVIVAL_PROBABILITY))
_SURVIVAL_PROBABILITY = float32_constant(ROULETTE_SURVIVAL_PROBABILITY)
_SURVIVOR_WEIGHT_FACTOR = float32_constant(1.0 / ROULETTE_SURVIVAL_PROBABILITY)


class RouletteResult(NamedTuple):
    """Roulette state of a ray after a game, and whether the game terminates the ray."""

    weight: float
    next_roulette: float
    terminated: bool


class LayerGeometry(NamedTuple):
    """Geometry of the pore space of a layer.

    Attributes
    ----------
    mean_free_path : float
        Mean free path in the pore space (m).
    bottom, top : float
        Heights of the boundaries of the layer (m).
    slab_bottom, slab_top : float
        Heights of the boundaries of the whole sample (m).
    grain_ceiling : float
        Largest height (m) of a grain: the slab top, or the mean height of a rough one.
    """

    mean_free_path: float
    bottom: float
    top: float
    slab_bottom: float
    slab_top: float
    grain_ceiling: float


class RejectionRules(NamedTuple):
    """Treatment of sampled grains that extend beyond the sample or overlap the previous segment.

    Attributes
    ----------
    entry_sampling : int
        See `spheroid.sample_entry_point`.
    reject_segment_overlap, reject_boundary_overlap : bool
        Such a grain is rejected.
    skip_segment_overlap, skip_boundary_overlap : bool
        The next distance after a rejected grain starts from that grain; otherwise from the start of
        the segment.
    """

    entry_sampling: int
    reject_segment_overlap: bool
    reject_boundary_overlap: bool
    skip_segment_overlap: bool
    skip_boundary_overlap: bool


class Collision(NamedTuple):
    """Sampled collision of a ray with a grain.

    Attributes
    ----------
    distance : float
        Distance (m).
    height : float
        Height of the entry point (m).
    entry : EntryPoint
    leaves_layer : bool
        The ray reaches a boundary of its layer first.
    accepted : bool
        The grain is accepted.
    start_distance : float
        Distance at which the next sampling attempt starts (m).
    """

    distance: float
    height: float
    entry: EntryPoint
    leaves_layer: bool
    accepted: bool
    start_distance: float


class BoundaryHit(NamedTuple):
    """Position of a ray at a boundary, and the distance to it (m)."""

    position: Vector
    distance: float


@inline
def russian_roulette(ray, u, active):
    """Play Russian roulette: terminate a low-weight ray or raise its weight."""
    played = active & (ray.optical_depth > ray.next_roulette)
    return RouletteResult(
        ray.weight * _SURVIVOR_WEIGHT_FACTOR if played else ray.weight,
        ray.next_roulette + _NEXT_ROULETTE_STEP if played else ray.next_roulette,
        played & (u > _SURVIVAL_PROBABILITY),
    )


@inline
def sample_collision(ray, size, variates, u, layer_geometry, rejection_rules):
    """Sample the next grain on a ray.

    SPLITS 4.3.3: the distance from Eq 21 (SPLITSnow Eq 1), then the entry point.

    Parameters
    ----------
    ray : Ray
    size : GrainSize
    variates : EntryVariates
        Accepted by `spheroid.accept_axial_position`.
    u : float
        A uniform random number, for the distance.
    layer_geometry : LayerGeometry
    rejection_rules : RejectionRules

    Returns
    -------
    Collision
    """
    d, exit_offset = ray.direction, ray.exit_offset
    distance = -log(u) * layer_geometry.mean_free_path
    distance += ray.start_distance
    # A grain may extend beyond the sample.  A ray that leaves it there starts on the boundary.
    start_height = min(
        max(ray.position.z + exit_offset.z, layer_geometry.slab_bottom),
        layer_geometry.slab_top,
    )
    height = fma(distance, d.z, start_height)
    outside = (height > layer_geometry.top) if d.z > ZERO else (height < layer_geometry.bottom)
    entry = sample_entry_point(d, size, variates, rejection_rules.entry_sampling)
    extends_beyond_slab = rejection_rules.reject_boundary_overlap & overlaps_boundary(
        entry, height, layer_geometry.slab_bottom, layer_geometry.grain_ceiling
    )
    previous_segment = Segment(
        linear_combination(-distance, d, -ONE, exit_offset),
        ray.previous_segment.direction,
        ray.previous_segment.length,
    )
    overlaps_previous = rejection_rules.reject_segment_overlap & overlaps_segment(
        entry.grain, previous_segment
    )
    accepted = (not outside) & (not extends_beyond_slab) & (not overlaps_previous)
    skip = (
        rejection_rules.skip_boundary_overlap
        if extends_beyond_slab
        else rejection_rules.skip_segment_overlap & overlaps_previous
    )
    start_distance = distance if (not outside) & skip else ray.start_distance
    start_distance = ZERO if accepted | outside else start_distance
    return Collision(distance, height, entry, outside, accepted, start_distance)


@inline
def compute_boundary_hit(ray, layer_geometry):
    """Return the intersection of a ray with the boundary of its layer ahead."""
    position = compute_position(ray)
    boundary = layer_geometry.bottom if ray.direction.z < ZERO else layer_geometry.top
    height = min(max(position.z, layer_geometry.slab_bottom), layer_geometry.slab_top)
    distance = (boundary - height) / ray.direction.z
    return BoundaryHit(
        Vector(
            position.x + distance * ray.direction.x,
            position.y + distance * ray.direction.y,
            boundary,
        ),
        distance,
    )
