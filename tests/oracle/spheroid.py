"""Prolate spheroids: where a ray meets a grain, and what lies on the way through it.

A grain has semi-major axis b along the unit vector w and two equal semi-minor axes c = Ψ² b
(SPLITSnow Eq 2, Ψ the inscribed-circle sphericity); f = 1 − c/b is its flattening.  Squeezing
space along w by c/b turns it into a sphere.  Points on the surface are kept as unit vectors q of
that sphere, lengths in units of c, and directions stay those of real space: neither the grain's
centre nor a rotation into its frame is needed.  Every function serves both precisions.
"""

from __future__ import annotations

import math

from oracle.arithmetic import fused, reciprocal_root, root
from oracle.frames import around, dot, normalized
from oracle.jit import HALF, ONE, THREE, TWO, ZERO, kernel
from oracle.rng import uniform, unit_circle

UNIFORM = 0
"""Entry point uniform over the surface that faces the ray (SPLITS 4.3.3, SPLITSnow 3.2)."""
PROJECTED = 1
"""Entry point (and orientation) weighted by area projected along the ray: geometry's own law."""


@kernel
def squeezed(x1, x2, x3, w1, w2, w3, flattening):
    """Return the vector x squeezed along w by the ratio of the axes, x − f (x·w) w."""
    k = -flattening * dot(x1, x2, x3, w1, w2, w3)
    return fused(k, w1, x1), fused(k, w2, x2), fused(k, w3, x3)


@kernel
def normal_at(q1, q2, q3, w1, w2, w3, flattening):
    """Return the outward unit normal at the surface point q."""
    n1, n2, n3 = squeezed(q1, q2, q3, w1, w2, w3, flattening)
    return normalized(n1, n2, n3)


@kernel
def across(q1, q2, q3, dx, dy, dz, w1, w2, w3, flattening):
    """Return the chord from the surface point q along d through the grain, and its other end.

    Returns
    -------
    chord : float
        Its length in units of the semi-minor axis, at least 0.
    q : 3 float
        The other end, brought back to unit length, so that errors do not add up.
    """
    e1, e2, e3 = squeezed(dx, dy, dz, w1, w2, w3, flattening)
    along = dot(q1, q2, q3, e1, e2, e3)
    chord = max(-TWO * along / dot(e1, e2, e3, e1, e2, e3), ZERO)
    q1 = fused(chord, e1, q1)
    q2 = fused(chord, e2, q2)
    q3 = fused(chord, e3, q3)
    # One step of Newton's method for 1/|q| from 1.
    scale = HALF * (THREE - dot(q1, q2, q3, q1, q2, q3))
    return chord, q1 * scale, q2 * scale, q3 * scale


@kernel
def slope_squared(axial, flattening):
    """Return 1 − e² z², z the axial position in units of b and e² = 1 − Ψ⁴.

    It is the squared length of the normal that `squeezed` makes of q, and the density of area
    over z is proportional to its root (SPLITS Eq 27, differentiated).
    """
    return ONE - flattening * (TWO - flattening) * axial * axial


@kernel
def axial_position(state, flattening):
    """Return z/b of a point uniform over the area of a prolate spheroid, in (−1, 1).

    Rejection draws exactly, without inverting SPLITS Eq 27.
    """
    while True:
        z = TWO * uniform(state) - ONE
        u = uniform(state)
        if u * u < slope_squared(z, flattening):
            return z


@kernel
def entry_point(
    dx, dy, dz, facing, cos_azimuth, sin_azimuth, axial, cos_turn, sin_turn, flattening
):  # fmt: skip
    """Return where a ray along d strikes a grain, and how that grain lies.

    A grain turned at random shows the normal at any fixed point of it in a random direction; so
    the normal is drawn around −d, and the grain is then turned around that normal.

    Parameters
    ----------
    d : 3 float
    facing : float
        −d·n in (0, 1]: uniform for entry uniform over the facing surface, the root of a uniform
        number for entry in proportion to projected area.
    cos_azimuth, sin_azimuth : float
        Azimuth of n around −d, uniform.
    axial : float
        z/b of the entry point, see `axial_position`.
    cos_turn, sin_turn : float
        Azimuth of w around n, uniform.
    flattening : float

    Returns
    -------
    q, w, n : 3 float each
        Entry point, major axis and outward normal, d·n = −`facing`.
    """
    square = slope_squared(axial, flattening)
    per_slope = reciprocal_root(square)
    slope = square * per_slope
    sine = root(max(ONE - facing * facing, ZERO))
    n1, n2, n3 = around(-dx, -dy, -dz, facing, sine, cos_azimuth, sin_azimuth)
    cos_axis = (ONE - flattening) * axial * per_slope
    sin_axis = root(max(ONE - axial * axial, ZERO)) * per_slope
    w1, w2, w3 = around(n1, n2, n3, cos_axis, sin_axis, cos_turn, sin_turn)
    shift = flattening * axial
    return (
        fused(shift, w1, slope * n1), fused(shift, w2, slope * n2), fused(shift, w3, slope * n3),
        w1, w2, w3, n1, n2, n3,
    )  # fmt: skip


@kernel
def struck_point(state, dx, dy, dz, flattening, entry):
    """Draw entry point, orientation and normal of the grain that a ray along d strikes.

    Returns what `entry_point` does.
    """
    axial = axial_position(state, flattening)
    facing = uniform(state)
    if entry == PROJECTED:
        facing = math.sqrt(facing)
    ca, sa = unit_circle(state)
    ct, st = unit_circle(state)
    return entry_point(dx, dy, dz, facing, ca, sa, axial, ct, st, flattening)


@kernel
def crosses(height, q3, w3, axial, minor, major, depth):
    """Tell whether a grain entered at a height below the boundary 0 reaches over 0 or −depth.

    Parameters
    ----------
    height : float
        Height of the entry point (m).
    q3, w3 : float
        Vertical components of entry point and major axis.
    axial, minor, major : float
        z/b of the entry point; semi-axes (m).
    depth : float
        Metres.
    """
    excess = (major - minor) * w3
    centre = height - fused(minor, q3, axial * excess)
    half = root(fused(minor, minor, (major + minor) * excess * w3))
    return (centre + half > ZERO) | (centre - half < -depth)


@kernel
def cuts_segment(
    q1, q2, q3, w1, w2, w3, minor, flattening, e1, e2, e3, lx, ly, lz, length
):  # fmt: skip
    """Tell whether a grain overlaps a segment.

    Parameters
    ----------
    q, w : 3 float each
        A point on the grain's surface and its major axis.
    minor, flattening : float
        Semi-minor axis (m) and flattening.
    e : 3 float
        The end of the segment, from that point (m).
    l : 3 float
        Direction of the segment, towards that end.
    length : float
        Its length (m); none if negative.
    """
    a1, a2, a3 = squeezed(e1, e2, e3, w1, w2, w3, flattening)
    a1 = fused(minor, q1, a1)
    a2 = fused(minor, q2, a2)
    a3 = fused(minor, q3, a3)
    b1, b2, b3 = squeezed(lx, ly, lz, w1, w2, w3, flattening)
    t = dot(a1, a2, a3, b1, b2, b3) / dot(b1, b2, b3, b1, b2, b3)
    t = -min(max(t, ZERO), length)
    a1 = fused(t, b1, a1)
    a2 = fused(t, b2, a2)
    a3 = fused(t, b3, a3)
    return (length > ZERO) & (dot(a1, a2, a3, a1, a2, a3) < minor * minor)
