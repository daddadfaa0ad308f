"""Polarised light at smooth faces, see `splits.kernels.optics.stokes`.

The plane of incidence becomes the reference of both beams.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.kernels.compiler.jit import inline, inline_only
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import Vector, cross, dot, linear_combination, normalize, reflect
from splits.kernels.optics.fresnel import FresnelResult, normal_component, refract
from splits.kernels.optics.stokes import compute_azimuth, normalize_stokes, rotate_reference


class ReflectionMueller(NamedTuple):
    """R₊, R₋, and a + ib = r_p r_s*, see `compute_fresnel_mueller`."""

    plus: float
    minus: float
    real: float
    imaginary: float


class TransmissionMueller(NamedTuple):
    """T₊, T₋ and √(T_s T_p), see `compute_fresnel_mueller`."""

    plus: float
    minus: float
    root: float


class InterfaceMueller(NamedTuple):
    """What an interface makes of polarised light."""

    reflection: ReflectionMueller
    transmission: TransmissionMueller
    fresnel_result: FresnelResult


class IncidentLight(NamedTuple):
    """Light as it meets a face.

    Attributes
    ----------
    cos_incidence : float
        Cosine of the angle of incidence.
    plane_normal : Vector
        Normal of the plane of incidence.
    q, u, v : float
        For a reference in that plane.
    """

    cos_incidence: float
    plane_normal: Vector
    q: float
    u: float
    v: float


class ReflectedLight(NamedTuple):
    """Share of light that is reflected; direction and `Stokes`, or None, after."""

    reflectance: float
    direction: Vector
    stokes: Any


class PolarizedInterfaceSample(NamedTuple):
    """Whether a ray passed a face; its direction and `Stokes`, or None, after."""

    transmitted: bool
    direction: Vector
    stokes: Any


@inline
def compute_fresnel_mueller(n1, n2, cos_i):
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
        return InterfaceMueller(
            ReflectionMueller(0.0, 0.0, 0.0, 0.0),
            TransmissionMueller(1.0, 0.0, 1.0),
            FresnelResult(0.0, 1.0, cos_i),
        )
    g = (n2 - n1) / n1
    sin2 = (1.0 - cos_i) * (1.0 + cos_i)
    a, b2 = normal_component(m, g, 0.0, cos_i, False)
    if a == 0.0:
        wc = math.sqrt(b2) * cos_i
        per = 1.0 / (sin2 * sin2 + wc * wc)
        back = ReflectionMueller(1.0, 0.0, (sin2 - wc) * (sin2 + wc) * per, -2.0 * sin2 * wc * per)
        return InterfaceMueller(
            back, TransmissionMueller(0.0, 0.0, 0.0), FresnelResult(1.0, 0.0, 0.0)
        )
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
    return InterfaceMueller(
        ReflectionMueller(r_plus, r_minus, rs * h, 0.0),
        TransmissionMueller(0.5 * ts * (1.0 + t * t), -r_minus, ts * t),
        FresnelResult(r_plus, ratio, a * ratio),
    )


@inline_only
def rotate_to_plane_of_incidence(d, stokes, normal):
    """Return the `IncidentLight` of light along d; straight onto a face, its plane is that of e."""
    f = cross(d, stokes.e)
    at = compute_azimuth(normal, stokes.e, f)
    light = rotate_reference(stokes.q, stokes.u, at.cos, at.sin)
    cos_i = min(max(-dot(d, normal), 0.0), 1.0)
    across = linear_combination(at.cos, f, -at.sin, stokes.e)
    return IncidentLight(cos_i, across, light.q, light.u, stokes.v)


@inline_only
def _reflect_light(d, normal, incident, mueller):
    """Return what becomes of light, an `IncidentLight`, that a face reflects."""
    plus, minus, real, imaginary = mueller.reflection
    _, across, q, u, v = incident
    share = plus + minus * q
    d = normalize(reflect(d, normal))
    e = normalize(cross(across, d))
    stokes = normalize_stokes(
        e, share, minus + plus * q, real * u + imaginary * v, real * v - imaginary * u
    )
    return ReflectedLight(share, d, stokes)


@inline_only
def _refract_light(d, normal, incident, mueller):
    """Return what becomes of light, an `IncidentLight`, that passes a face."""
    plus, minus, root = mueller.transmission
    cos_i, across, q, u, v = incident
    d = refract(d, normal, cos_i, mueller.fresnel_result)
    e = normalize(cross(across, d))
    return PolarizedInterfaceSample(
        True, d, normalize_stokes(e, plus + minus * q, minus + plus * q, root * u, root * v)
    )


@inline
def reflect_polarized(d, stokes, normal, n1, n2):
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
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    return _reflect_light(d, normal, light, compute_fresnel_mueller(n1, n2, light.cos_incidence))


@inline
def sample_polarized_interface(state, d, stokes, normal, n1, n2):
    """Reflect light at a smooth interface with the probability R₊ + R₋ q, or refract it.

    Parameters are those of `reflect_polarized`.

    Returns
    -------
    Meeting
        The reference is in the plane of incidence.
    """
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    face = compute_fresnel_mueller(n1, n2, light.cos_incidence)
    back = face.reflection
    if uniform(state) >= back.plus + back.minus * light.q:
        return _refract_light(d, normal, light, face)
    mirrored_light = _reflect_light(d, normal, light, face)
    return PolarizedInterfaceSample(False, mirrored_light.direction, mirrored_light.stokes)
