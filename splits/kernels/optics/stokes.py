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

from splits.kernels.compiler.jit import TINY, inline, inline_only
from splits.kernels.math.rng import sample_azimuth, uniform
from splits.kernels.math.vectors import (
    Vector,
    add_scaled,
    cross,
    dot,
    linear_combination,
    make_tangents,
    normalize,
)
from splits.kernels.optics.phase_function import (
    evaluate_phase_function,
    evaluate_polarization_ratios,
    sample_scattering_cosine,
)


class Stokes(NamedTuple):
    """Polarization of a ray: the reference e, and Q, U and V over I.

    Rays of which nobody asks it carry None in its place, and all that follows it is compiled away.
    """

    e: Vector
    q: float
    u: float
    v: float


UNPOLARIZED = Stokes(Vector(1.0, 0.0, 0.0), 0.0, 0.0, 0.0)
"""Unpolarised light; what its reference is does not matter."""


class LinearPolarization(NamedTuple):
    """Q and U over I, for a reference that is known elsewhere."""

    q: float
    u: float


class Azimuth(NamedTuple):
    """An angle from e towards f by its cosine and sine, and the sine of the polar angle from d."""

    cos: float
    sin: float
    sin_polar: float


class DirectionSample(NamedTuple):
    """Direction and polarization of a ray, a `Stokes` or None, after an encounter."""

    direction: Vector
    stokes: Any


class ScatteredDensity(NamedTuple):
    """Density with which light is sent into a direction (1/sr), and its polarization there."""

    density: float
    stokes: Stokes


@inline_only
def make_unpolarized(d, stokes):
    """Return q = u = v = 0 for light along d, with any reference.

    Parameters
    ----------
    d : Vector
    stokes : Stokes or None
        None comes back, of rays that carry no polarization.
    """
    if stokes is None:
        return stokes
    return Stokes(make_tangents(d).u, 0.0, 0.0, 0.0)


@inline_only
def rotate_reference(q, u, c, s):
    """Return q and u for a reference along c e + s f, of any length but zero."""
    per = 1.0 / (c * c + s * s)
    cos2 = (c - s) * (c + s) * per
    sin2 = 2.0 * c * s * per
    return LinearPolarization(q * cos2 + u * sin2, u * cos2 - q * sin2)


@inline
def rotate_reference_to(stokes, d, t):
    """Return q and u when the reference changes from e to t.

    Q' = Q cos2ψ + U sin2ψ and U' = −Q sin2ψ + U cos2ψ with cosψ = e·t and sinψ = (e × t)·d.

    Parameters
    ----------
    stokes : Stokes
    d, t : Vector
        Direction of travel and new reference; what counts of the latter is its part perpendicular
        to d, whatever its length.
    """
    return rotate_reference(stokes.q, stokes.u, dot(stokes.e, t), dot(cross(stokes.e, t), d))


@inline_only
def compute_azimuth(t, e, f):
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


@inline_only
def normalize_stokes(e, i, q, u, v):
    """Return the `Stokes` of I, Q, U and V; rounding polarises no light beyond completely."""
    per = 1.0 / max(max(i, math.sqrt(q * q + u * u + v * v)), TINY)
    return Stokes(e, q * per, u * per, v * per)


@inline_only
def _transport_reference(mu, sine, t, d, a):
    """Return t turned along with d into the new direction a = µ d + sinΘ t, at right angles to it.

    References are made from references: without the projection errors would grow from one
    scattering to the next.
    """
    e = linear_combination(mu, t, -sine, d)
    return normalize(add_scaled(-dot(e, a), a, e))


@inline
def scatter_polarized(state, phase, d, stokes):
    """Scatter light into a direction drawn from the density of `evaluate_polarized_scattering`.

    The cosine comes from the phase function, to which the density integrates over azimuths φ from
    e towards f; the azimuth from 1 + (m12/m11)(q cos2φ + u sin2φ) by rejection, which keeps at
    least half of the draws.

    Parameters
    ----------
    state : uint64[1]
    phase : PhaseFunction
    d : Vector
        Direction of travel.
    stokes : Stokes

    Returns
    -------
    Scattered
        Its reference is in the plane of scattering.
    """
    mu = sample_scattering_cosine(state, phase)
    ratios = evaluate_polarization_ratios(phase, mu)
    highest = 1.0 + abs(ratios.m12) * math.sqrt(stokes.q * stokes.q + stokes.u * stokes.u)
    while True:
        c, s = sample_azimuth(state)
        light = rotate_reference(stokes.q, stokes.u, c, s)
        if uniform(state) * highest <= 1.0 + ratios.m12 * light.q:
            break
    sine = math.sqrt((1.0 - mu) * (1.0 + mu))
    t = linear_combination(c, stokes.e, s, cross(d, stokes.e))
    a = normalize(linear_combination(mu, d, sine, t))
    e = _transport_reference(mu, sine, t, d, a)
    part = 1.0 + ratios.m12 * light.q
    return DirectionSample(a, _compute_scattered_stokes(e, part, light, stokes.v, ratios))


@inline_only
def _compute_scattered_stokes(e, intensity, linear, v, ratios):
    """Return the polarization of scattered light, of which `inline_only` is I over the phase function."""
    m12, m33 = ratios
    return normalize_stokes(e, intensity, m12 + linear.q, m33 * linear.u, m33 * v)


@inline
def evaluate_polarized_scattering(phase, d, stokes, t):
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
    at = compute_azimuth(t, stokes.e, f)
    mu = min(max(dot(d, t), -1.0), 1.0)
    ratios = evaluate_polarization_ratios(phase, mu)
    light = rotate_reference(stokes.q, stokes.u, at.cos, at.sin)
    part = max(1.0 + ratios.m12 * light.q, 0.0)
    e = _transport_reference(
        mu, at.sin_polar, linear_combination(at.cos, stokes.e, at.sin, f), d, t
    )
    return ScatteredDensity(
        evaluate_phase_function(phase, mu) * part,
        _compute_scattered_stokes(e, part, light, stokes.v, ratios),
    )
