"""Prolate spheroids: entry points of rays, chords, and overlap with boundaries and segments.

A grain has semi-major axis b along the unit vector w and two equal semi-minor axes c = Ψ² b
(SPLITSnow Eq 2, Ψ the inscribed-circle sphericity); f = 1 − c/b is its flattening.  Scaling space
along w by c/b turns it into a sphere.  Points on the surface are unit vectors q of that sphere,
lengths are in units of c, and directions are those of real space: neither the centre of the grain
nor a rotation into its frame is needed.
"""

import math

from oracle.arithmetic import fused, reciprocal_root, root
from oracle.frames import around, dot, normalized
from oracle.jit import HALF, ONE, THREE, TWO, ZERO, kernel
from oracle.rng import uniform, unit_circle

UNIFORM = 0
"""Entry point uniform over the surface facing the ray (SPLITS 4.3.3, SPLITSnow 3.2)."""
PROJECTED = 1
"""Entry point and orientation weighted by area projected along the ray, the geometric law."""


@kernel
def scale_along_axis(x1, x2, x3, w1, w2, w3, flattening):
    """Return the vector x scaled along w by the ratio of the axes, x − f (x·w) w."""
    k = -flattening * dot(x1, x2, x3, w1, w2, w3)
    return fused(k, w1, x1), fused(k, w2, x2), fused(k, w3, x3)


@kernel
def compute_outward_normal(q1, q2, q3, w1, w2, w3, flattening):
    """Return the outward unit normal at the surface point q."""
    n1, n2, n3 = scale_along_axis(q1, q2, q3, w1, w2, w3, flattening)
    return normalized(n1, n2, n3)


@kernel
def compute_chord(q1, q2, q3, dx, dy, dz, w1, w2, w3, flattening):
    """Return the chord from the surface point q along d through the grain, and its other end.

    Returns
    -------
    chord : float
        Its length in units of the semi-minor axis, at least 0.
    q : 3 float
        The other end, normalized, so that rounding errors do not accumulate.
    """
    e1, e2, e3 = scale_along_axis(dx, dy, dz, w1, w2, w3, flattening)
    along = dot(q1, q2, q3, e1, e2, e3)
    chord = max(-TWO * along / dot(e1, e2, e3, e1, e2, e3), ZERO)
    q1 = fused(chord, e1, q1)
    q2 = fused(chord, e2, q2)
    q3 = fused(chord, e3, q3)
    # One step of Newton's method for 1/|q| from 1.
    scale = HALF * (THREE - dot(q1, q2, q3, q1, q2, q3))
    return chord, q1 * scale, q2 * scale, q3 * scale


@kernel
def normal_length_squared(axial, flattening):
    """Return 1 − e² z², z the axial position in units of b and e² = 1 − Ψ⁴.

    It is the squared length of the normal that `scale_along_axis` makes of q, and the density of
    area over z is proportional to its root (SPLITS Eq 27, differentiated).
    """
    return ONE - flattening * (TWO - flattening) * axial * axial


@kernel
def sample_axial_position(state, flattening):
    """Return z/b of a point uniform over the area of a prolate spheroid, in (−1, 1).

    Rejection sampling is exact, and needs no inverse of SPLITS Eq 27.
    """
    while True:
        z = TWO * uniform(state) - ONE
        u = uniform(state)
        if u * u < normal_length_squared(z, flattening):
            return z


@kernel
def compute_entry_point(
    dx, dy, dz, cos_incidence, cos_azimuth, sin_azimuth, axial, cos_turn, sin_turn, flattening
):  # fmt: skip
    """Return the entry point of a ray along d, and the orientation of the grain.

    The normal at any fixed point of a randomly oriented grain is isotropic.  So the normal is
    sampled around −d, and then the azimuth of the grain around that normal.

    Parameters
    ----------
    d : 3 float
    cos_incidence : float
        −d·n in (0, 1]: uniform for entry uniform over the surface facing the ray, the root of a
        uniform number for entry in proportion to projected area.
    cos_azimuth, sin_azimuth : float
        Azimuth of n around −d, uniform.
    axial : float
        z/b of the entry point, see `sample_axial_position`.
    cos_turn, sin_turn : float
        Azimuth of w around n, uniform.
    flattening : float

    Returns
    -------
    q, w, n : 3 float each
        Entry point, major axis and outward normal, d·n = −`cos_incidence`.
    """
    square = normal_length_squared(axial, flattening)
    per_normal_length = reciprocal_root(square)
    length = square * per_normal_length
    sine = root(max(ONE - cos_incidence * cos_incidence, ZERO))
    n1, n2, n3 = around(-dx, -dy, -dz, cos_incidence, sine, cos_azimuth, sin_azimuth)
    cos_axis = (ONE - flattening) * axial * per_normal_length
    sin_axis = root(max(ONE - axial * axial, ZERO)) * per_normal_length
    w1, w2, w3 = around(n1, n2, n3, cos_axis, sin_axis, cos_turn, sin_turn)
    shift = flattening * axial
    return (
        fused(shift, w1, length * n1), fused(shift, w2, length * n2), fused(shift, w3, length * n3),
        w1, w2, w3, n1, n2, n3,
    )  # fmt: skip


@kernel
def sample_entry_point(state, dx, dy, dz, flattening, entry_sampling):
    """Sample entry point, orientation and normal of the grain that a ray along d hits.

    The values returned are those of `compute_entry_point`.
    """
    axial = sample_axial_position(state, flattening)
    cos_incidence = uniform(state)
    if entry_sampling == PROJECTED:
        cos_incidence = math.sqrt(cos_incidence)
    ca, sa = unit_circle(state)
    ct, st = unit_circle(state)
    return compute_entry_point(dx, dy, dz, cos_incidence, ca, sa, axial, ct, st, flattening)


@kernel
def overlaps_boundary(height, q3, w3, axial, minor, major, depth):
    """Return whether a grain entered at `height` extends above 0 or below −depth.

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
def overlaps_segment(
    q1, q2, q3, w1, w2, w3, minor, flattening, e1, e2, e3, lx, ly, lz, length
):  # fmt: skip
    """Return whether a grain overlaps a segment.

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
    a1, a2, a3 = scale_along_axis(e1, e2, e3, w1, w2, w3, flattening)
    a1 = fused(minor, q1, a1)
    a2 = fused(minor, q2, a2)
    a3 = fused(minor, q3, a3)
    b1, b2, b3 = scale_along_axis(lx, ly, lz, w1, w2, w3, flattening)
    t = dot(a1, a2, a3, b1, b2, b3) / dot(b1, b2, b3, b1, b2, b3)
    t = -min(max(t, ZERO), length)
    a1 = fused(t, b1, a1)
    a2 = fused(t, b2, a2)
    a3 = fused(t, b3, a3)
    return (length > ZERO) & (dot(a1, a2, a3, a1, a2, a3) < minor * minor)
