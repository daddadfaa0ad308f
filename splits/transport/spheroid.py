"""Prolate spheroids: where a ray meets a grain, and what lies on the way through it.

A grain has semi-major axis b along the unit vector w and two equal semi-minor axes c = Ψ² b
(SPLITSnow Eq 2, Ψ the inscribed-circle sphericity).  All functions work in world axes with
positions relative to the grain's centre: the quadratic form

    Q(x, y) = x·y / c² + (x·w)(y·w) (1/b² − 1/c²)

has Q(p, p) = 1 on the surface and ∇Q ∝ p / c² + (p·w) (1/b² − 1/c²) w along the normal, so no
rotation into the grain's frame is needed.
"""

from __future__ import annotations

import math

from splits.transport.frames import normalized, orthonormal_basis
from splits.transport.jit import kernel
from splits.transport.rng import uniform, unit_circle, unit_sphere

UNIFORM = 0
"""Entry point uniform over the surface that faces the ray (SPLITS 4.3.3, SPLITSnow 3.2)."""
PROJECTED = 1
"""Entry point (and orientation) weighted by area projected along the ray: geometry's own law."""


@kernel
def quadratic(x1, x2, x3, y1, y2, y3, w1, w2, w3, minor2, shift):
    """Return Q(x, y) with `minor2` = 1/c² and `shift` = 1/b² − 1/c²."""
    dot = x1 * y1 + x2 * y2 + x3 * y3
    return dot * minor2 + (x1 * w1 + x2 * w2 + x3 * w3) * (y1 * w1 + y2 * w2 + y3 * w3) * shift


@kernel
def axial_position(state, sphericity):
    """Return z/b of a point uniform over the area of a prolate spheroid, in (−1, 1).

    SPLITS Eq 27 is the cumulative area F(z); its derivative is proportional to √(1 − e²z²/b²)
    with e² = 1 − Ψ⁴, from which rejection draws exactly, without inverting F.
    """
    psi2 = sphericity * sphericity
    e2 = 1.0 - psi2 * psi2
    while True:
        z = 2.0 * uniform(state) - 1.0
        u = uniform(state)
        if u * u < 1.0 - e2 * z * z:
            return z


@kernel
def normal_at(p1, p2, p3, w1, w2, w3, minor2, shift):
    """Return the outward unit normal at the surface point p."""
    along = (p1 * w1 + p2 * w2 + p3 * w3) * shift
    return normalized(
        p1 * minor2 + along * w1,
        p2 * minor2 + along * w2,
        p3 * minor2 + along * w3,
    )


@kernel
def struck_point(state, dx, dy, dz, semi_major, sphericity, entry):
    """Draw orientation and entry point of the grain that a ray along d strikes.

    Returns
    -------
    p : 3 float
        Entry point relative to the centre, in the unit of `semi_major`.
    w : 3 float
        Direction of the major axis, uniform on the sphere (`UNIFORM`), or weighted by the
        area the grain shows the ray (`PROJECTED`).
    n : 3 float
        Outward normal at p, with d·n < 0.
    """
    psi2 = sphericity * sphericity
    semi_minor = semi_major * psi2
    minor2 = 1.0 / (semi_minor * semi_minor)
    shift = 1.0 / (semi_major * semi_major) - minor2
    while True:
        w1, w2, w3 = unit_sphere(state)
        z = axial_position(state, sphericity)
        r = semi_minor * math.sqrt(1.0 - z * z)
        z *= semi_major
        c, s = unit_circle(state)
        u1, u2, u3, v1, v2, v3 = orthonormal_basis(w1, w2, w3)
        c *= r
        s *= r
        p1 = z * w1 + c * u1 + s * v1
        p2 = z * w2 + c * u2 + s * v2
        p3 = z * w3 + c * u3 + s * v3
        n1, n2, n3 = normal_at(p1, p2, p3, w1, w2, w3, minor2, shift)
        facing = -(dx * n1 + dy * n2 + dz * n3)
        # The facing and the hidden half have equal area: a point on the hidden side moves to
        # its antipode.
        if facing < 0.0:
            p1, p2, p3 = -p1, -p2, -p3
            n1, n2, n3 = -n1, -n2, -n3
            facing = -facing
        if facing > 0.0 and (entry == UNIFORM or uniform(state) < facing):
            return p1, p2, p3, w1, w2, w3, n1, n2, n3


@kernel
def chord(p1, p2, p3, dx, dy, dz, w1, w2, w3, minor2, shift):
    """Return the length of the straight path from the surface point p along d through the grain."""
    return (
        -2.0
        * quadratic(p1, p2, p3, dx, dy, dz, w1, w2, w3, minor2, shift)
        / quadratic(dx, dy, dz, dx, dy, dz, w1, w2, w3, minor2, shift)
    )


@kernel
def half_height(w3, semi_major, semi_minor):
    """Return how far the grain reaches above (and below) its centre along z."""
    return math.sqrt(semi_minor * semi_minor * (1.0 - w3 * w3) + semi_major * semi_major * w3 * w3)


@kernel
def cuts_segment(o1, o2, o3, dx, dy, dz, length, w1, w2, w3, minor2, shift):
    """Tell whether the grain overlaps the segment from o (relative to its centre) along d."""
    qdd = quadratic(dx, dy, dz, dx, dy, dz, w1, w2, w3, minor2, shift)
    qod = quadratic(o1, o2, o3, dx, dy, dz, w1, w2, w3, minor2, shift)
    qoo = quadratic(o1, o2, o3, o1, o2, o3, w1, w2, w3, minor2, shift)
    t = min(max(-qod / qdd, 0.0), length)
    return qoo + t * (2.0 * qod + t * qdd) < 1.0
