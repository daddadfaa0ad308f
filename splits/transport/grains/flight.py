"""From grain to grain: roulette, the next grain and the way to it, the way to a boundary.

SPLITS section 4.3.3 and SPLITSnow section 3.1: only the grain that the ray meets exists.  Distance,
type, size, shape, orientation and entry point are drawn; a grain that crosses a boundary or lies
on the leg just travelled is drawn again.  The functions serve scalar kernel and lanes, in either
precision, without loops and without branches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.transport.compiling.jit import ONE, ZERO, exact, kernel
from splits.transport.grains.spheroid import Entry, Segment, crosses, cuts, strike
from splits.transport.numerics.arithmetic import fused
from splits.transport.numerics.elementary import logarithm
from splits.transport.numerics.vectors import Vector, combined

ROULETTE_BELOW = 0.6
ROULETTE_SURVIVAL = ROULETTE_BELOW
FIRST_ROULETTE = -math.log(ROULETTE_BELOW)
"""Optical depth from which a ray that carries weights plays Russian roulette: it has become lighter
for every wavelength that listens to it.  Long paths cost as much as they are long, whatever they
weigh, so it pays to end most of them early; nothing is lost on average.  One that goes on weighs
what it did at first, so that none ever weighs more."""
_NEXT = exact(-math.log(ROULETTE_SURVIVAL))
_SURVIVAL = exact(ROULETTE_SURVIVAL)
_LIGHTER = exact(1.0 / ROULETTE_SURVIVAL)


class Purse(NamedTuple):
    """What roulette knows of a ray.

    Attributes
    ----------
    depth : float
        Least optical depth passed so far, over the wavelengths served.
    limit : float
        Optical depth at which roulette is played next.
    weight : float
        Inverse probability of having survived.
    """

    depth: float
    limit: float
    weight: float


class Played(NamedTuple):
    """A purse after roulette, and whether the ray ended."""

    purse: Purse
    ended: bool


class Flier(NamedTuple):
    """A ray between grains.

    Attributes
    ----------
    place : Vector
        Where it met the grain it comes from (m).
    way : Vector
        From there to where it left that grain (m).
    d : Vector
        Direction.
    last : Segment
        The leg before, which ended at `place`; its end is not used.
    skipped : float
        Distance from which the next grain is drawn (m): to the last one left out, or to the face
        through which the ray came into its layer.
    """

    place: Vector
    way: Vector
    d: Vector
    last: Segment
    skipped: float


class Space(NamedTuple):
    """The pore space that a ray flies through.

    Attributes
    ----------
    mean_leg : float
        Mean distance between grains (m).
    low, high : float
        Heights of the faces of the layer (m).
    floor, ceiling : float
        Heights of the faces of the whole sample (m).
    brim : float
        Height (m) above which no grain may reach: the ceiling, or the mean height of a rough one.
    """

    mean_leg: float
    low: float
    high: float
    floor: float
    ceiling: float
    brim: float


class Fates(NamedTuple):
    """What becomes of grains that do not fit.

    Attributes
    ----------
    entry : int
        See `spheroid.strike`.
    refuse_on_last_leg, refuse_across_boundary : bool
    skip_on_last_leg, skip_across_boundary : bool
        Such a grain is left out, and the next distance counts from its place; otherwise it is drawn
        again from the ray's origin.
    """

    entry: int
    refuse_on_last_leg: bool
    refuse_across_boundary: bool
    skip_on_last_leg: bool
    skip_across_boundary: bool


class Meeting(NamedTuple):
    """The next grain on a ray, or why there is none.

    Attributes
    ----------
    leg : float
        Distance (m).
    height : float
        Of the entry point (m).
    entry : Entry
    outside : bool
        A face of the layer comes first.
    fits : bool
        The grain is met.
    skipped : float
        Distance from which the next trial counts (m).
    """

    leg: float
    height: float
    entry: Entry
    outside: bool
    fits: bool
    skipped: float


class Arrival(NamedTuple):
    """A ray at a face: the place and the leg that led there (m)."""

    place: Vector
    leg: float


@kernel
def roulette(purse, u, active):
    """Let a ray that has become light end, or go on heavier."""
    played = active & (purse.depth > purse.limit)
    limit = purse.limit + _NEXT if played else purse.limit
    weight = purse.weight * _LIGHTER if played else purse.weight
    return Played(Purse(purse.depth, limit, weight), played & (u > _SURVIVAL))


@kernel
def next_grain(ray, size, aim, u, space, fates):
    """Draw the next grain on a ray.

    SPLITS 4.3.3: distance from Eq 21 (SPLITSnow Eq 1), then the entry point.

    Parameters
    ----------
    ray : Flier
    size : Size
    aim : Aim
        One that is `spheroid.placed`.
    u : float
        A uniform random number, for the distance.
    space : Space
    fates : Fates

    Returns
    -------
    Meeting
    """
    d, way = ray.d, ray.way
    leg = -logarithm(u) * space.mean_leg
    leg += ray.skipped
    # A grain kept across a boundary may have ended outside: the ray stands on the boundary.
    start = min(max(ray.place.z + way.z, space.floor), space.ceiling)
    height = fused(leg, d.z, start)
    outside = (height > space.high) if d.z > ZERO else (height < space.low)
    entry = strike(d, size, aim, fates.entry)
    across = fates.refuse_across_boundary & crosses(entry, height, space.floor, space.brim)
    behind = Segment(combined(-leg, d, -ONE, way), ray.last.d, ray.last.length)
    backwards = fates.refuse_on_last_leg & cuts(entry.grain, behind)
    fits = (not outside) & (not across) & (not backwards)
    skips = fates.skip_across_boundary if across else fates.skip_on_last_leg & backwards
    skipped = leg if (not outside) & skips else ray.skipped
    skipped = ZERO if fits | outside else skipped
    return Meeting(leg, height, entry, outside, fits, skipped)


@kernel
def to_boundary(ray, space):
    """Return where a ray meets the face of its layer ahead of it."""
    place = Vector(ray.place.x + ray.way.x, ray.place.y + ray.way.y, ray.place.z + ray.way.z)
    goal = space.low if ray.d.z < ZERO else space.high
    height = min(max(place.z, space.floor), space.ceiling)
    leg = (goal - height) / ray.d.z
    return Arrival(Vector(place.x + leg * ray.d.x, place.y + leg * ray.d.y, goal), leg)
