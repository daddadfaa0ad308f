"""From grain to grain: roulette, the next grain and the way to it, the way to a boundary.

SPLITS section 4.3.3 and SPLITSnow section 3.1: only the grain that the ray meets exists.  Distance,
type, size, shape, orientation and entry point are drawn; a grain that crosses a boundary or lies
on the leg just travelled is drawn again.  The functions serve scalar kernel and lanes, in either
precision, without loops and without branches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.compiler.jit import ONE, ZERO, float32_constant, inline
from splits.kernels.grains.spheroid import (
    EntryPoint,
    Segment,
    overlaps_boundary,
    overlaps_segment,
    sample_entry_point,
)
from splits.kernels.math.arithmetic import fma
from splits.kernels.math.elementary import log
from splits.kernels.math.vectors import Vector, linear_combination

ROULETTE_THRESHOLD = 0.6
ROULETTE_SURVIVAL_PROBABILITY = ROULETTE_THRESHOLD
FIRST_ROULETTE_DEPTH = -math.log(ROULETTE_THRESHOLD)
"""Optical depth from which a ray that carries weights plays Russian roulette: it has become lighter
for every wavelength that listens to it.  Long paths cost as much as they are long, whatever they
weigh, so it pays to end most of them early; nothing is lost on average.  One that goes on weighs
what it did at first, so that none ever weighs more."""
_NEXT_ROULETTE_STEP = float32_constant(-math.log(ROULETTE_SURVIVAL_PROBABILITY))
_SURVIVAL_PROBABILITY = float32_constant(ROULETTE_SURVIVAL_PROBABILITY)
_SURVIVOR_WEIGHT_FACTOR = float32_constant(1.0 / ROULETTE_SURVIVAL_PROBABILITY)


class RouletteState(NamedTuple):
    """What roulette knows of a ray.

    Attributes
    ----------
    optical_depth : float
        Least optical depth passed so far, over the wavelengths served.
    next_roulette : float
        Optical depth at which roulette is played next.
    weight : float
        Inverse probability of having survived.
    """

    optical_depth: float
    next_roulette: float
    weight: float


class RouletteResult(NamedTuple):
    """A purse after roulette, and whether the ray ended."""

    roulette: RouletteState
    terminated: bool


class RayGeometry(NamedTuple):
    """A ray between grains.

    Attributes
    ----------
    position : Vector
        Where it met the grain it comes from (m).
    exit_offset : Vector
        From there to where it left that grain (m).
    direction : Vector
        Direction.
    previous_segment : Segment
        The leg before, which ended at `position`; its end is not used.
    start_distance : float
        Distance from which the next grain is drawn (m): to the last one left out, or to the face
        through which the ray came into its layer.
    """

    position: Vector
    exit_offset: Vector
    direction: Vector
    previous_segment: Segment
    start_distance: float


class LayerGeometry(NamedTuple):
    """The pore space that a ray flies through.

    Attributes
    ----------
    mean_free_path : float
        Mean distance between grains (m).
    bottom, top : float
        Heights of the faces of the layer (m).
    slab_bottom, slab_top : float
        Heights of the faces of the whole sample (m).
    grain_ceiling : float
        Height (m) above which no grain may reach: the ceiling, or the mean height of a rough one.
    """

    mean_free_path: float
    bottom: float
    top: float
    slab_bottom: float
    slab_top: float
    grain_ceiling: float


class RejectionRules(NamedTuple):
    """What becomes of grains that do not fit.

    Attributes
    ----------
    entry_sampling : int
        See `spheroid.sample_entry_point`.
    reject_segment_overlap, reject_boundary_overlap : bool
    skip_segment_overlap, skip_boundary_overlap : bool
        Such a grain is left out, and the next distance counts from its place; otherwise it is drawn
        again from the ray's origin.
    """

    entry_sampling: int
    reject_segment_overlap: bool
    reject_boundary_overlap: bool
    skip_segment_overlap: bool
    skip_boundary_overlap: bool


class Collision(NamedTuple):
    """The next grain on a ray, or why there is none.

    Attributes
    ----------
    distance : float
        Distance (m).
    height : float
        Of the entry point (m).
    entry : EntryPoint
    leaves_layer : bool
        A face of the layer comes first.
    accepted : bool
        The grain is met.
    start_distance : float
        Distance from which the next trial counts (m).
    """

    distance: float
    height: float
    entry: EntryPoint
    leaves_layer: bool
    accepted: bool
    start_distance: float


class BoundaryHit(NamedTuple):
    """A ray at a face: the place and the leg that led there (m)."""

    position: Vector
    distance: float


@inline
def russian_roulette(roulette_state, u, active):
    """Let a ray that has become light end, or go on heavier."""
    played = active & (roulette_state.optical_depth > roulette_state.next_roulette)
    limit = (
        roulette_state.next_roulette + _NEXT_ROULETTE_STEP
        if played
        else roulette_state.next_roulette
    )
    weight = roulette_state.weight * _SURVIVOR_WEIGHT_FACTOR if played else roulette_state.weight
    return RouletteResult(
        RouletteState(roulette_state.optical_depth, limit, weight),
        played & (u > _SURVIVAL_PROBABILITY),
    )


@inline
def sample_collision(geometry, size, variates, u, layer_geometry, rejection_rules):
    """Draw the next grain on a ray.

    SPLITS 4.3.3: distance from Eq 21 (SPLITSnow Eq 1), then the entry point.

    Parameters
    ----------
    geometry : RayGeometry
    size : GrainSize
    variates : Aim
        One that is `spheroid.placed`.
    u : float
        A uniform random number, for the distance.
    layer_geometry : LayerGeometry
    rejection_rules : RejectionRules

    Returns
    -------
    Meeting
    """
    d, way = geometry.direction, geometry.exit_offset
    leg = -log(u) * layer_geometry.mean_free_path
    leg += geometry.start_distance
    # A grain kept across a boundary may have ended outside: the ray stands on the boundary.
    start = min(
        max(geometry.position.z + way.z, layer_geometry.slab_bottom), layer_geometry.slab_top
    )
    height = fma(leg, d.z, start)
    outside = (height > layer_geometry.top) if d.z > ZERO else (height < layer_geometry.bottom)
    entry = sample_entry_point(d, size, variates, rejection_rules.entry_sampling)
    across = rejection_rules.reject_boundary_overlap & overlaps_boundary(
        entry, height, layer_geometry.slab_bottom, layer_geometry.grain_ceiling
    )
    behind = Segment(
        linear_combination(-leg, d, -ONE, way),
        geometry.previous_segment.direction,
        geometry.previous_segment.length,
    )
    backwards = rejection_rules.reject_segment_overlap & overlaps_segment(entry.grain, behind)
    fits = (not outside) & (not across) & (not backwards)
    skips = (
        rejection_rules.skip_boundary_overlap
        if across
        else rejection_rules.skip_segment_overlap & backwards
    )
    skipped = leg if (not outside) & skips else geometry.start_distance
    skipped = ZERO if fits | outside else skipped
    return Collision(leg, height, entry, outside, fits, skipped)


@inline
def compute_boundary_hit(geometry, layer_geometry):
    """Return where a ray meets the face of its layer ahead of it."""
    place = Vector(
        geometry.position.x + geometry.exit_offset.x,
        geometry.position.y + geometry.exit_offset.y,
        geometry.position.z + geometry.exit_offset.z,
    )
    goal = layer_geometry.bottom if geometry.direction.z < ZERO else layer_geometry.top
    height = min(max(place.z, layer_geometry.slab_bottom), layer_geometry.slab_top)
    leg = (goal - height) / geometry.direction.z
    return BoundaryHit(
        Vector(place.x + leg * geometry.direction.x, place.y + leg * geometry.direction.y, goal),
        leg,
    )
