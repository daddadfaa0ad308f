"""Prolate spheroids: entry points, chords, and free paths between them."""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.arithmetic import (
    Angle,
    add_scaled,
    direction_around,
    dot,
    fma,
    linear_combination,
    log,
    normalize,
    rsqrt,
    scale,
    sqrt,
)
from splits.kernels.compiler.jit import HALF, ONE, THREE, TWO, ZERO, float32_constant, inline
from splits.kernels.rays import compute_position
from splits.kernels.scene import PROJECTED_ENTRY, Segment, Vector

# --------------------------------------------------------------------------------------------------
# Prolate spheroids: entry points of rays, chords, and overlap with boundaries and segments.
#
# A grain has semi-major axis b along the unit vector w and two equal semi-minor axes c = Ψ² b
# (SPLITSnow Eq 2, Ψ the inscribed-circle sphericity); f = 1 − c/b is its flattening.  Compressing
# space along w by c/b transforms it into a sphere.  Points on the surface are stored as unit
# vectors q of that sphere, lengths in units of c, and directions remain those of real space:
# neither the centre of the grain nor a rotation into its frame is needed.  Every function serves
# both precisions.


class Spheroid(NamedTuple):
    """Grain with the point of its surface at which a ray is.

    Attributes
    ----------
    q : Vector
        Point, on the unit sphere.
    w : Vector
        Major axis.
    flattening : float
    semi_minor : float
        Semi-minor axis (m).
    """

    q: Vector
    w: Vector
    flattening: float
    semi_minor: float


class GrainSize(NamedTuple):
    """Semi-major axis (m) and flattening."""

    semi_major: float
    flattening: float


class EntryVariates(NamedTuple):
    """Random numbers for the entry point and the orientation of a grain.

    Attributes
    ----------
    u_cos_incidence : float
        Uniform, for the cosine −d·n.
    normal_azimuth, axis_azimuth : Angle
        Azimuths of n around −d and of w around n.
    u_axial, u_accept : float
        Uniform, for z/b of the entry point and its acceptance.
    """

    u_cos_incidence: float
    normal_azimuth: Angle
    axis_azimuth: Angle
    u_axial: float
    u_accept: float


class EntryPoint(NamedTuple):
    """Entry point of a ray on a grain.

    Attributes
    ----------
    grain : Spheroid
    normal : Vector
        Outward normal at the entry point.
    axial_position : float
        z/b of the entry point.
    semi_major : float
        Semi-major axis (m).
    """

    grain: Spheroid
    normal: Vector
    axial_position: float
    semi_major: float


class Chord(NamedTuple):
    """Chord through a grain: its length (m), and the grain with the ray at its end."""

    length: float
    grain: Spheroid


@inline
def scale_along_axis(x, w, flattening):
    """Return the vector x compressed along w by the ratio of the axes, x − f (x·w) w."""
    return add_scaled(-flattening * dot(x, w), w, x)


@inline
def compute_outward_normal(grain):
    """Return the outward unit normal at the position of the ray."""
    return normalize(scale_along_axis(grain.q, grain.w, grain.flattening))


@inline
def compute_chord(grain, d):
    """Return the chord through the grain along d from the position of the ray.

    The end point is normalized, so that errors do not accumulate.
    """
    e = scale_along_axis(d, grain.w, grain.flattening)
    chord = max(-TWO * dot(grain.q, e) / dot(e, e), ZERO)
    q = add_scaled(chord, e, grain.q)
    # One step of Newton's method for 1/|q| from 1.
    q = scale(HALF * (THREE - dot(q, q)), q)
    return Chord(chord * grain.semi_minor, Spheroid(q, grain.w, grain.flattening, grain.semi_minor))


@inline
def normal_length_squared(axial_position, flattening):
    """Return 1 − e² z², z the axial position in units of b and e² = 1 − Ψ⁴.

    It is the squared length of `scale_along_axis` of q, and the density of surface area over z is
    proportional to its root (SPLITS Eq 27, differentiated).
    """
    return ONE - flattening * (TWO - flattening) * axial_position * axial_position


@inline
def accept_axial_position(variates, flattening):
    """Return whether a sampled axial position is accepted.

    Accepted positions are uniform over the area of a spheroid, exactly and without an inversion of
    SPLITS Eq 27.
    """
    return variates.u_accept * variates.u_accept < normal_length_squared(
        TWO * variates.u_axial - ONE, flattening
    )


@inline
def sample_entry_point(d, size, variates, entry_sampling):
    """Sample the entry point of a ray along d, and the orientation of the grain.

    For a random orientation of the grain, the normal at a fixed point of its surface has a random
    direction; the normal is therefore sampled around −d, and the axis around that normal.

    Parameters
    ----------
    d : Vector
    size : GrainSize
    variates : EntryVariates
    entry_sampling : int
        `UNIFORM_ENTRY` or `PROJECTED_ENTRY`.

    Returns
    -------
    EntryPoint
    """
    flattening = size.flattening
    axial = TWO * variates.u_axial - ONE
    square = normal_length_squared(axial, flattening)
    cos_incidence = (
        sqrt(variates.u_cos_incidence)
        if entry_sampling == PROJECTED_ENTRY
        else variates.u_cos_incidence
    )
    polar = Angle(cos_incidence, sqrt(max(ONE - cos_incidence * cos_incidence, ZERO)))
    n = direction_around(Vector(-d.x, -d.y, -d.z), polar, variates.normal_azimuth)
    per_length = rsqrt(square)
    normal_length = square * per_length
    cos_axis = (ONE - flattening) * axial * per_length
    sin_axis = sqrt(max(ONE - axial * axial, ZERO)) * per_length
    w = direction_around(n, Angle(cos_axis, sin_axis), variates.axis_azimuth)
    q = linear_combination(flattening * axial, w, normal_length, n)
    minor = (ONE - flattening) * size.semi_major
    return EntryPoint(Spheroid(q, w, flattening, minor), n, axial, size.semi_major)


@inline
def overlaps_boundary(entry, height, bottom, top):
    """Return whether a grain entered at `height` extends below `bottom` or above `top` (m)."""
    grain = entry.grain
    minor = grain.semi_minor
    excess = (entry.semi_major - minor) * grain.w.z
    centre = height - fma(minor, grain.q.z, entry.axial_position * excess)
    half = sqrt(fma(minor, minor, (entry.semi_major + minor) * excess * grain.w.z))
    return (centre + half > top) | (centre - half < bottom)


@inline
def overlaps_segment(grain, segment):
    """Return whether a grain overlaps a segment, whose end is relative to the ray (m)."""
    a = scale_along_axis(segment.end, grain.w, grain.flattening)
    a = add_scaled(grain.semi_minor, grain.q, a)
    b = scale_along_axis(segment.direction, grain.w, grain.flattening)
    t = dot(a, b) / dot(b, b)
    a = add_scaled(-min(max(t, ZERO), segment.length), b, a)
    return (segment.length > ZERO) & (dot(a, a) < grain.semi_minor * grain.semi_minor)


# --------------------------------------------------------------------------------------------------
# Roulette, sampling of the next grain and of the distance to it, and distance to a boundary.
#
# SPLITS section 4.3.3 and SPLITSnow section 3.1: only the grain that the ray hits exists.
# Distance, type, size, shape, orientation and entry point are sampled.  A grain that extends beyond
# the sample or overlaps the previous path segment is rejected unless the rules keep it.  The
# functions serve the scalar and the vectorized kernel, in either precision, without loops and
# without branches.

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
