"""Reflection and refraction of polarized light at a smooth interface.

The plane of incidence is the reference plane of all beams, see `splits.kernels.optics.stokes`.
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
    """Elements R₊, R₋ and a + ib = r_p r_s* of reflection, see `compute_fresnel_mueller`."""

    plus: float
    minus: float
    real: float
    imaginary: float


class TransmissionMueller(NamedTuple):
    """Elements T₊, T₋ and √(T_s T_p) of refraction, see `compute_fresnel_mueller`."""

    plus: float
    minus: float
    root: float


class InterfaceMueller(NamedTuple):
    """Mueller matrices of an interface, and its unpolarized `FresnelResult`."""

    reflection: ReflectionMueller
    transmission: TransmissionMueller
    fresnel_result: FresnelResult


class IncidentLight(NamedTuple):
    """Light incident on an interface, with the plane of incidence as reference.

    Attributes
    ----------
    cos_incidence : float
        Cosine of the angle of incidence.
    plane_normal : Vector
        Normal of the plane of incidence.
    q, u, v : float
        Q, U, V over I.
    """

    cos_incidence: float
    plane_normal: Vector
    q: float
    u: float
    v: float


class ReflectedLight(NamedTuple):
    """Reflectance, and direction and `Stokes` (or None) of the reflected light."""

    reflectance: float
    direction: Vector
    stokes: Any


class PolarizedInterfaceSample(NamedTuple):
    """Whether a ray was transmitted, and its new direction and `Stokes` (or None)."""

    transmitted: bool
    direction: Vector
    stokes: Any


@inline
def compute_fresnel_mueller(n1, n2, cos_i):
    """Return the Mueller matrices of an interface between media of real refractive index.

    Born & Wolf 1999, section 1.5, with the plane of incidence as reference of all three beams.
    Reflection maps (I, Q, U, V) to

        R₊ I + R₋ Q,  R₋ I + R₊ Q,  a U + b V,  a V − b U,   a + ib = r_p r_s*,

    and refraction, in energy flux through the interface, to T₊ I + T₋ Q, T₋ I + T₊ Q, T U, T V with
    T = √(T_s T_p).  Plus and minus denote (R_p ± R_s)/2; r_p = −r_s at normal incidence, where
    the reference reverses with the light.  In units of n₁, with w = (n₂/n₁) cosθ_t, imaginary above
    the critical angle, and c and σ for cosine and sine of the angle of incidence,

        r_s = (c − w)/(c + w) = (1 − n²)/(c + w)²,   r_p = r_s h,   h = (σ² − wc)/(σ² + wc),

    where n = n₂/n₁; at total reflection r_p r_s* = h = e^(−iδ), tan(δ/2) = c √(σ² − n²)/σ² (their
    section 1.5.4).  R₋, T₊ and T₋ are expanded: nothing cancels near normal incidence, at grazing
    incidence or between nearly equal media.

    Parameters
    ----------
    n1, n2 : float
        On the side of incidence and on the far side.
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].

    Returns
    -------
    InterfaceMueller
        R₊ and the `FresnelResult` agree with `fresnel.fresnel`; R₋ ≤ 0, T₊ = 1 − R₊, T₋ = −R₋.
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
        reflection = ReflectionMueller(
            1.0, 0.0, (sin2 - wc) * (sin2 + wc) * per, -2.0 * sin2 * wc * per
        )
        return InterfaceMueller(
            reflection, TransmissionMueller(0.0, 0.0, 0.0), FresnelResult(1.0, 0.0, 0.0)
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
    """Return the `IncidentLight` of light along d.

    At normal incidence the plane of incidence is that of d and e.
    """
    f = cross(d, stokes.e)
    azimuth = compute_azimuth(normal, stokes.e, f)
    light = rotate_reference(stokes.q, stokes.u, azimuth.cos, azimuth.sin)
    cos_i = min(max(-dot(d, normal), 0.0), 1.0)
    plane_normal = linear_combination(azimuth.cos, f, -azimuth.sin, stokes.e)
    return IncidentLight(cos_i, plane_normal, light.q, light.u, stokes.v)


@inline_only
def _reflect_light(d, normal, incident, mueller):
    """Return the `ReflectedLight` of an `IncidentLight`."""
    plus, minus, real, imaginary = mueller.reflection
    _, plane_normal, q, u, v = incident
    reflectance = plus + minus * q
    d = normalize(reflect(d, normal))
    e = normalize(cross(plane_normal, d))
    stokes = normalize_stokes(
        e, reflectance, minus + plus * q, real * u + imaginary * v, real * v - imaginary * u
    )
    return ReflectedLight(reflectance, d, stokes)


@inline_only
def _refract_light(d, normal, incident, mueller):
    """Return the transmitted `PolarizedInterfaceSample` of an `IncidentLight`."""
    plus, minus, root = mueller.transmission
    cos_i, plane_normal, q, u, v = incident
    d = refract(d, normal, cos_i, mueller.fresnel_result)
    e = normalize(cross(plane_normal, d))
    return PolarizedInterfaceSample(
        True, d, normalize_stokes(e, plus + minus * q, minus + plus * q, root * u, root * v)
    )


@inline
def reflect_polarized(d, stokes, normal, n1, n2):
    """Return the reflectance of a smooth interface, and the reflected light.

    Parameters
    ----------
    d : Vector
        Direction of travel.
    stokes : Stokes
    normal : Vector
        Normal of the interface against the light, d·n ≤ 0.
    n1, n2 : float
        Real refractive indices on the side of incidence and on the far side.

    Returns
    -------
    ReflectedLight
        The reference is in the plane of incidence.
    """
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    return _reflect_light(d, normal, light, compute_fresnel_mueller(n1, n2, light.cos_incidence))


@inline
def sample_polarized_interface(state, d, stokes, normal, n1, n2):
    """Sample reflection, with the probability R₊ + R₋ q, or refraction at a smooth interface.

    Parameters are those of `reflect_polarized`.

    Returns
    -------
    PolarizedInterfaceSample
        The reference is in the plane of incidence.
    """
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    mueller = compute_fresnel_mueller(n1, n2, light.cos_incidence)
    reflection = mueller.reflection
    if uniform(state) >= reflection.plus + reflection.minus * light.q:
        return _refract_light(d, normal, light, mueller)
    reflected = _reflect_light(d, normal, light, mueller)
    return PolarizedInterfaceSample(False, reflected.direction, reflected.stokes)
