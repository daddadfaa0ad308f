"""Polarised light at smooth faces, see `splits.transport.optics.stokes`.

The plane of incidence becomes the reference of both beams.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.transport.compiling.jit import kernel, part
from splits.transport.numerics.rng import uniform
from splits.transport.numerics.vectors import Vector, combined, cross, dot, mirrored, normalized
from splits.transport.optics.fresnel import Passage, normal_component, refracted
from splits.transport.optics.stokes import azimuth_of, normalised, turned


class Reflection(NamedTuple):
    """R₊, R₋, and a + ib = r_p r_s*, see `fresnel_amplitudes`."""

    plus: float
    minus: float
    real: float
    imaginary: float


class Transmission(NamedTuple):
    """T₊, T₋ and √(T_s T_p), see `fresnel_amplitudes`."""

    plus: float
    minus: float
    root: float


class Face(NamedTuple):
    """What an interface makes of polarised light."""

    reflection: Reflection
    transmission: Transmission
    fresnel_result: Passage


class Incidence(NamedTuple):
    """Light as it meets a face.

    Attributes
    ----------
    cos : float
        Cosine of the angle of incidence.
    across : Vector
        Normal of the plane of incidence.
    q, u, v : float
        For a reference in that plane.
    """

    cos_incidence: float
    plane_normal: Vector
    q: float
    u: float
    v: float


class Reflected(NamedTuple):
    """Share of light that is reflected; direction and `Stokes`, or None, after."""

    reflectance: float
    direction: Vector
    stokes: Any


class Meeting(NamedTuple):
    """Whether a ray passed a face; its direction and `Stokes`, or None, after."""

    transmitted: bool
    direction: Vector
    stokes: Any


@kernel
def fresnel_amplitudes(n1, n2, cos_i):
    """Return the Mueller matrices of an interface between media of real refractive index.

    Born & Wolf 1999, section 1.5, with the plane of incidence as reference of all three beams.
    Reflection takes (I, Q, U, V) to

        R₊ I + R₋ Q,  R₋ I + R₊ Q,  a U + b V,  a V − b U,   a + ib = r_p r_s*,

    and refraction, in energy that crosses the surface, to T₊ I + T₋ Q, T₋ I + T₊ Q, T U, T V with
    T = √(T_s T_p).  Plus and minus stand for (R_p ± R_s)/2; r_p = −r_s at normal incidence, where
    the reference turns back with the light.  In units of n₁, with w = (n₂/n₁) cosθ_t, i√ beyond the
    critical angle, and c and σ for cosine and sine of the angle of incidence,

        r_s = (c − w)/(c + w) = (1 − n²)/(c + w)²,   r_p = r_s h,   h = (σ² − wc)/(σ² + wc),

    where n = n₂/n₁; at total reflection r_p r_s* = h = e^(−iδ), tan(δ/2) = c √(σ² − n²)/σ² (their
    section 1.5.4).  R₋, T₊ and T₋ are multiplied out: nothing cancels next to normal incidence, at
    grazing incidence or between nearly equal media.

    Parameters
    ----------
    n1, n2 : float
        On the side of incidence and beyond.
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].

    Returns
    -------
    Face
        R₊ and the passage are those of `fresnel.interface`; R₋ ≤ 0, T₊ = 1 − R₊, T₋ = −R₋.
    """
    m = n2 / n1
    if m == 1.0:
        return Face(
            Reflection(0.0, 0.0, 0.0, 0.0), Transmission(1.0, 0.0, 1.0), Passage(0.0, 1.0, cos_i)
        )
    g = (n2 - n1) / n1
    sin2 = (1.0 - cos_i) * (1.0 + cos_i)
    a, b2 = normal_component(m, g, 0.0, cos_i, False)
    if a == 0.0:
        wc = math.sqrt(b2) * cos_i
        per = 1.0 / (sin2 * sin2 + wc * wc)
        back = Reflection(1.0, 0.0, (sin2 - wc) * (sin2 + wc) * per, -2.0 * sin2 * wc * per)
        return Face(back, Transmission(0.0, 0.0, 0.0), Passage(1.0, 0.0, 0.0))
    wc = a * cos_i
    per_s = 1.0 / (cos_i + a)
    per_p = 1.0 / (sin2 + wc)
    root_s = g * (m + 1.0) * per_s * per_s
    rs = root_s * root_s
    h = (sin2 - wc) * per_p
    r_plus = min(0.5 * rs * (1.0 + h * h), 1.0)
    r_minus = -2.0 * rs * (sin2 * per_p) * (wc * per_p)
    ts = 4.0 * wc * per_s * per_s
    t = m * per_p
    ratio = 1.0 / math.sqrt(a * a + sin2)
    return Face(
        Reflection(r_plus, r_minus, rs * h, 0.0),
        Transmission(0.5 * ts * (1.0 + t * t), -r_minus, ts * t),
        Passage(r_plus, ratio, a * ratio),
    )


@part
def incidence(d, stokes, normal):
    """Return the `Incidence` of light along d; straight onto a face, its plane is that of e."""
    f = cross(d, stokes.e)
    at = azimuth_of(normal, stokes.e, f)
    light = turned(stokes.q, stokes.u, at.cos, at.sin)
    cos_i = min(max(-dot(d, normal), 0.0), 1.0)
    across = combined(at.cos, f, -at.sin, stokes.e)
    return Incidence(cos_i, across, light.q, light.u, stokes.v)


@part
def _reflected(d, normal, incident, mueller):
    """Return what becomes of light, an `Incidence`, that a face reflects."""
    plus, minus, real, imaginary = mueller.reflection
    _, across, q, u, v = incident
    share = plus + minus * q
    d = normalized(mirrored(d, normal))
    e = normalized(cross(across, d))
    stokes = normalised(
        e, share, minus + plus * q, real * u + imaginary * v, real * v - imaginary * u
    )
    return Reflected(share, d, stokes)


@part
def _refracted(d, normal, incident, mueller):
    """Return what becomes of light, an `Incidence`, that passes a face."""
    plus, minus, root = mueller.transmission
    cos_i, across, q, u, v = incident
    d = refracted(d, normal, cos_i, mueller.fresnel_result)
    e = normalized(cross(across, d))
    return Meeting(True, d, normalised(e, plus + minus * q, minus + plus * q, root * u, root * v))


@kernel
def reflected_polarized(d, stokes, normal, n1, n2):
    """Return the share of light that a smooth interface reflects, and what it becomes.

    Parameters
    ----------
    d : Vector
        Direction of travel.
    stokes : Stokes
    normal : Vector
        Of the interface against the light, d·n ≤ 0.
    n1, n2 : float
        Real refractive indices on the side of incidence and beyond.

    Returns
    -------
    Reflected
        The reference is in the plane of incidence.
    """
    light = incidence(d, stokes, normal)
    return _reflected(d, normal, light, fresnel_amplitudes(n1, n2, light.cos_incidence))


@kernel
def reflect_or_refract_polarized(state, d, stokes, normal, n1, n2):
    """Reflect light at a smooth interface with the probability R₊ + R₋ q, or refract it.

    Parameters are those of `reflected_polarized`.

    Returns
    -------
    Meeting
        The reference is in the plane of incidence.
    """
    light = incidence(d, stokes, normal)
    face = fresnel_amplitudes(n1, n2, light.cos_incidence)
    back = face.reflection
    if uniform(state) >= back.plus + back.minus * light.q:
        return _refracted(d, normal, light, face)
    mirrored_light = _reflected(d, normal, light, face)
    return Meeting(False, mirrored_light.direction, mirrored_light.stokes)
