"""Polarised light: Stokes vectors, and what scattering makes of them.

Light that travels along d has a reference e, a unit vector perpendicular to d; f = d × e completes
the right-handed frame (e, f, d).  With the complex amplitudes of a field that goes as e^(−iωt),

    I = |E_e|² + |E_f|²    Q = |E_e|² − |E_f|²    U = 2 Re(E_e* E_f)    V = 2 Im(E_e* E_f).

Q > 0 is polarised along e; U > 0 at +45° from e towards f, anticlockwise for whom the light
reaches; V > 0 where the field at a fixed point turns from e towards f, anticlockwise again (the
traditional left-handed light, of positive helicity).  Kernels carry q, u, v = Q/I, U/I, V/I and no
weight: what Stokes vectors do to probabilities is in what is drawn.

The plane of scattering or incidence becomes the reference: e' lies in it, so that q' > 0 is
parallel to the plane and q' < 0 perpendicular; the frames of all beams share f' on its normal.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.transport.compiling.jit import TINY, kernel, part
from splits.transport.numerics.rng import uniform, unit_circle
from splits.transport.numerics.vectors import (
    Vector,
    along,
    combined,
    cross,
    dot,
    normalized,
    tangents,
)
from splits.transport.optics.phase import phase_density, polarizing_ratios, scattering_cosine


class Stokes(NamedTuple):
    """Polarization of a ray: the reference e, and Q, U and V over I.

    Rays of which nobody asks it carry None in its place, and all that follows it is compiled away.
    """

    e: Vector
    q: float
    u: float
    v: float


NATURAL = Stokes(Vector(1.0, 0.0, 0.0), 0.0, 0.0, 0.0)
"""Unpolarised light; what its reference is does not matter."""


class Linear(NamedTuple):
    """Q and U over I, for a reference that is known elsewhere."""

    q: float
    u: float


class Azimuth(NamedTuple):
    """An angle from e towards f by its cosine and sine, and the sine of the polar angle from d."""

    cos: float
    sin: float
    sin_polar: float


class Scattered(NamedTuple):
    """Direction and polarization of a ray, a `Stokes` or None, after an encounter."""

    direction: Vector
    stokes: Any


class Estimate(NamedTuple):
    """Density with which light is sent into a direction (1/sr), and its polarization there."""

    density: float
    stokes: Stokes


@part
def unpolarized(d, stokes):
    """Return q = u = v = 0 for light along d, with any reference.

    Parameters
    ----------
    d : Vector
    stokes : Stokes or None
        None comes back, of rays that carry no polarization.
    """
    if stokes is None:
        return stokes
    return Stokes(tangents(d).u, 0.0, 0.0, 0.0)


@part
def turned(q, u, c, s):
    """Return q and u for a reference along c e + s f, of any length but zero."""
    per = 1.0 / (c * c + s * s)
    cos2 = (c - s) * (c + s) * per
    sin2 = 2.0 * c * s * per
    return Linear(q * cos2 + u * sin2, u * cos2 - q * sin2)


@kernel
def rotated_to(stokes, d, t):
    """Return q and u when the reference changes from e to t.

    Q' = Q cos2ψ + U sin2ψ and U' = −Q sin2ψ + U cos2ψ with cosψ = e·t and sinψ = (e × t)·d.

    Parameters
    ----------
    stokes : Stokes
    d, t : Vector
        Direction of travel and new reference; what counts of the latter is its part perpendicular
        to d, whatever its length.
    """
    return turned(stokes.q, stokes.u, dot(stokes.e, t), dot(cross(stokes.e, t), d))


@part
def azimuth_of(t, e, f):
    """Return the `Azimuth` of t in the frame (e, f, d); where t is along ±d, that of e.

    Cosine and sine keep t in the plane of d even where rounding decides which plane that is.
    """
    c = dot(t, e)
    s = dot(t, f)
    square = c * c + s * s
    if square > TINY:
        sine = math.sqrt(square)
        return Azimuth(c / sine, s / sine, sine)
    return Azimuth(1.0, 0.0, 0.0)


@part
def normalised(e, i, q, u, v):
    """Return the `Stokes` of I, Q, U and V; rounding polarises no light beyond completely."""
    per = 1.0 / max(max(i, math.sqrt(q * q + u * u + v * v)), TINY)
    return Stokes(e, q * per, u * per, v * per)


@part
def _reference_behind(mu, sine, t, d, a):
    """Return t turned along with d into the new direction a = µ d + sinΘ t, at right angles to it.

    References are made from references: without the projection errors would grow from one
    scattering to the next.
    """
    e = combined(mu, t, -sine, d)
    return normalized(along(-dot(e, a), a, e))


@kernel
def scatter_polarized(state, phase, d, stokes):
    """Scatter light into a direction drawn from the density of `scattered_towards`.

    The cosine comes from the phase function, to which the density integrates over azimuths φ from
    e towards f; the azimuth from 1 + (m12/m11)(q cos2φ + u sin2φ) by rejection, which keeps at
    least half of the draws.

    Parameters
    ----------
    state : uint64[1]
    phase : Phase
    d : Vector
        Direction of travel.
    stokes : Stokes

    Returns
    -------
    Scattered
        Its reference is in the plane of scattering.
    """
    mu = scattering_cosine(state, phase)
    ratios = polarizing_ratios(phase, mu)
    highest = 1.0 + abs(ratios.m12) * math.sqrt(stokes.q * stokes.q + stokes.u * stokes.u)
    while True:
        c, s = unit_circle(state)
        light = turned(stokes.q, stokes.u, c, s)
        if uniform(state) * highest <= 1.0 + ratios.m12 * light.q:
            break
    sine = math.sqrt((1.0 - mu) * (1.0 + mu))
    t = combined(c, stokes.e, s, cross(d, stokes.e))
    a = normalized(combined(mu, d, sine, t))
    e = _reference_behind(mu, sine, t, d, a)
    part = 1.0 + ratios.m12 * light.q
    return Scattered(a, _scattered_light(e, part, light, stokes.v, ratios))


@part
def _scattered_light(e, intensity, linear, v, ratios):
    """Return the polarization of scattered light, of which `part` is I over the phase function."""
    m12, m33 = ratios
    return normalised(e, intensity, m12 + linear.q, m33 * linear.u, m33 * v)


@kernel
def scattered_towards(phase, d, stokes, t):
    """Return how much light is scattered towards a given direction, and how polarised it is.

    Parameters
    ----------
    phase, d, stokes
        See `scatter_polarized`.
    t : Vector
        Unit vector; along ±d, where every plane is one of scattering, that of e is taken.

    Returns
    -------
    Estimate
        The density has integral 1: phase function times 1 + (m12/m11) q in the plane of scattering,
        where the reference is.  No light has q = u = v = 0.
    """
    f = cross(d, stokes.e)
    at = azimuth_of(t, stokes.e, f)
    mu = min(max(dot(d, t), -1.0), 1.0)
    ratios = polarizing_ratios(phase, mu)
    light = turned(stokes.q, stokes.u, at.cos, at.sin)
    part = max(1.0 + ratios.m12 * light.q, 0.0)
    e = _reference_behind(mu, at.sin_polar, combined(at.cos, stokes.e, at.sin, f), d, t)
    return Estimate(
        phase_density(phase, mu) * part, _scattered_light(e, part, light, stokes.v, ratios)
    )
