"""Prolate spheroids: entry points of rays, chords, and overlap with boundaries and segments.

A grain has semi-major axis b along the unit vector w and two equal semi-minor axes c = Ψ² b
(SPLITSnow Eq 2, Ψ the inscribed-circle sphericity); f = 1 − c/b is its flattening.  Compressing
space along w by c/b transforms it into a sphere.  Points on the surface are stored as unit vectors
q of that sphere, lengths in units of c, and directions remain those of real space: neither the
centre of the grain nor a rotation into its frame is needed.  Every function serves both precisions.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.base.sampling_rules import PROJECTED_ENTRY
from splits.kernels.compiler.jit import HALF, ONE, THREE, TWO, ZERO, inline
from splits.kernels.math.arithmetic import fma, rsqrt, sqrt
from splits.kernels.math.elementary import Angle
from splits.kernels.math.vectors import (
    Vector,
    add_scaled,
    direction_around,
    dot,
    linear_combination,
    normalize,
    scale,
)


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
