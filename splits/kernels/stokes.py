"""Polarized light: Stokes vectors and their scattering.

Light that travels along d has a reference e, a unit vector perpendicular to d; f = d × e completes
the right-handed frame (e, f, d).  With the complex amplitudes of a field proportional to e^(−iωt),

    I = |E_e|² + |E_f|²    Q = |E_e|² − |E_f|²    U = 2 Re(E_e* E_f)    V = 2 Im(E_e* E_f).

Q > 0 is polarized along e; U > 0 at +45° from e towards f, anticlockwise for an observer who
receives the light; V > 0 where the field at a fixed point rotates from e towards f, anticlockwise
again (the traditional left-handed light, of positive helicity).  Kernels carry q, u, v = Q/I, U/I,
V/I and no weight: polarization changes the sampling probabilities instead.

The plane of scattering or incidence becomes the reference: e' lies in it, so that q' > 0 is
parallel to the plane and q' < 0 perpendicular; f' is normal to the plane for all beams.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.kernels.arithmetic import (
    add_scaled,
    cross,
    dot,
    linear_combination,
    make_tangents,
    normalize,
)
from splits.kernels.compiler.jit import TINY, inline, inline_only
from splits.kernels.phase_function import (
    evaluate_phase_function,
    evaluate_scattering_ratios,
    sample_scattering_cosine,
)
from splits.kernels.rng import sample_azimuth, uniform
from splits.kernels.scene import Stokes, Vector


class LinearPolarization(NamedTuple):
    """Q and U over I, for a reference defined elsewhere."""

    q: float
    u: float


class Azimuth(NamedTuple):
    """Cosine and sine of the azimuth from e towards f, and the sine of the polar angle from d."""

    cos: float
    sin: float
    sin_polar: float


class DirectionSample(NamedTuple):
    """Direction and polarization (a `Stokes` or None) of a ray after scattering."""

    direction: Vector
    stokes: Any


class ScatteredDensity(NamedTuple):
    """Density of light scattered into a direction (1/sr), and its polarization."""

    density: float
    stokes: Stokes


@inline_only
def make_unpolarized(d, stokes):
    """Return the `Stokes` of unpolarized light along d, with an arbitrary reference.

    Parameters
    ----------
    d : Vector
    stokes : Stokes or None
        None, for rays without polarization, is returned as it is.
    """
    if stokes is None:
        return stokes
    return Stokes(make_tangents(d).u, 0.0, 0.0, 0.0)


@inline_only
def rotate_reference(q, u, c, s):
    """Return q and u for a reference along c e + s f, of any nonzero length."""
    per = 1.0 / (c * c + s * s)
    cos2 = (c - s) * (c + s) * per
    sin2 = 2.0 * c * s * per
    return LinearPolarization(q * cos2 + u * sin2, u * cos2 - q * sin2)


@inline
def rotate_reference_to(stokes, d, t):
    """Return q and u for the reference t in place of e.

    Q' = Q cos2ψ + U sin2ψ and U' = −Q sin2ψ + U cos2ψ with cosψ = e·t and sinψ = (e × t)·d.

    Parameters
    ----------
    stokes : Stokes
    d, t : Vector
        Direction of travel and new reference; only the part of t perpendicular to d counts, of any
        length.
    """
    return rotate_reference(stokes.q, stokes.u, dot(stokes.e, t), dot(cross(stokes.e, t), d))


@inline_only
def compute_azimuth(t, e, f):
    """Return the `Azimuth` of t in the frame (e, f, d), or that of e if t is along ±d.

    Cosine and sine keep t in a plane through d even where rounding determines that plane.
    """
    c = dot(t, e)
    s = dot(t, f)
    square = c * c + s * s
    if square > TINY:
        sine = math.sqrt(square)
        return Azimuth(c / sine, s / sine, sine)
    return Azimuth(1.0, 0.0, 0.0)


@inline_only
def normalize_stokes(e, i, q, u, v):
    """Return the `Stokes` of I, Q, U and V, with a degree of polarization of at most 1."""
    per = 1.0 / max(max(i, math.sqrt(q * q + u * u + v * v)), TINY)
    return Stokes(e, q * per, u * per, v * per)


@inline_only
def _transport_reference(mu, sine, t, d, a):
    """Return t rotated with d into the new direction a = µ d + sinΘ t, perpendicular to it.

    The projection keeps rounding errors of successive references from growing.
    """
    e = linear_combination(mu, t, -sine, d)
    return normalize(add_scaled(-dot(e, a), a, e))


@inline
def scatter_polarized(state, phase, d, stokes):
    """Sample the direction of scattered light from `evaluate_polarized_scattering`.

    The cosine is sampled from the phase function, the integral of the density over azimuths φ from
    e towards f.  The azimuth is sampled from 1 + m12 (q cos2φ + u sin2φ) by rejection, which
    accepts at least half of the samples.

    Parameters
    ----------
    state : uint64[1]
    phase : PhaseFunction
    d : Vector
        Direction of travel.
    stokes : Stokes

    Returns
    -------
    DirectionSample
        Its reference is in the plane of scattering.
    """
    mu = sample_scattering_cosine(state, phase)
    ratios = evaluate_scattering_ratios(phase, mu)
    highest = 1.0 + abs(ratios.m12) * math.sqrt(stokes.q * stokes.q + stokes.u * stokes.u)
    while True:
        c, s = sample_azimuth(state)
        linear = rotate_reference(stokes.q, stokes.u, c, s)
        if uniform(state) * highest <= 1.0 + ratios.m12 * linear.q:
            break
    sine = math.sqrt((1.0 - mu) * (1.0 + mu))
    t = linear_combination(c, stokes.e, s, cross(d, stokes.e))
    a = normalize(linear_combination(mu, d, sine, t))
    e = _transport_reference(mu, sine, t, d, a)
    relative_intensity = 1.0 + ratios.m12 * linear.q
    return DirectionSample(
        a, _compute_scattered_stokes(e, relative_intensity, linear, stokes.v, ratios)
    )


@inline_only
def _compute_scattered_stokes(e, intensity, linear, v, ratios):
    """Return the polarization of scattered light of intensity I over the phase function."""
    m12, m22, m33, m34, m44 = ratios
    q, u = linear
    return normalize_stokes(e, intensity, m12 + m22 * q, m33 * u + m34 * v, m44 * v - m34 * u)


@inline
def evaluate_polarized_scattering(phase, d, stokes, t):
    """Return the density and polarization of light scattered into a given direction.

    Parameters
    ----------
    phase, d, stokes
        See `scatter_polarized`.
    t : Vector
        Unit vector.  Along ±d the scattering plane is undefined, and that of d and e is taken.

    Returns
    -------
    ScatteredDensity
        The density integrates to 1: phase function times 1 + m12 q for the scattering plane,
        which is the reference.  For a density of 0, q = u = v = 0.
    """
    f = cross(d, stokes.e)
    azimuth = compute_azimuth(t, stokes.e, f)
    mu = min(max(dot(d, t), -1.0), 1.0)
    ratios = evaluate_scattering_ratios(phase, mu)
    linear = rotate_reference(stokes.q, stokes.u, azimuth.cos, azimuth.sin)
    relative_intensity = max(1.0 + ratios.m12 * linear.q, 0.0)
    e = _transport_reference(
        mu, azimuth.sin_polar, linear_combination(azimuth.cos, stokes.e, azimuth.sin, f), d, t
    )
    return ScatteredDensity(
        evaluate_phase_function(phase, mu) * relative_intensity,
        _compute_scattered_stokes(e, relative_intensity, linear, stokes.v, ratios),
    )
