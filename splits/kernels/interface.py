"""Reflection and refraction at smooth interfaces, and scattering, polarized or not."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.kernels.arithmetic import (
    cross,
    dot,
    fma,
    linear_combination,
    normalize,
    reflect,
    rsqrt,
    sqrt,
)
from splits.kernels.compiler.jit import FOUR, HALF, ONE, TINY, ZERO, inline, inline_only
from splits.kernels.phase_function import sample_phase_function
from splits.kernels.rng import uniform
from splits.kernels.scene import Vector
from splits.kernels.stokes import (
    DirectionSample,
    compute_azimuth,
    normalize_stokes,
    rotate_reference,
    scatter_polarized,
)

# --------------------------------------------------------------------------------------------------
# Fresnel reflection and Snell refraction of unpolarized light at a plane interface.
#
# Light arrives through a medium of real refractive index n1 at a medium of complex index n2 + i k2.
# Absorption and total reflection on the far side are covered by one formula (Born & Wolf 1999,
# Principles of Optics, 7th ed., sections 1.5.2-1.5.4 and 14.2; SPLITS section 4.3.4).  Rays follow
# the planes of constant real phase, so the side of incidence, too, enters with its real index.
# Total reflection then stays total and no surface emits more than a black body, which a complex
# tangential wave number would violate to first order in k1/n1.  Where k1/n1 is large, hardly any
# light arrives from inside a coating or a grain.


class NormalWave(NamedTuple):
    """Normal component a + i b of the transmitted wave, as a and b²."""

    a: float
    b2: float


class FresnelResult(NamedTuple):
    """Reflectance and refraction at an interface.

    Attributes
    ----------
    reflectance : float
        Unpolarized Fresnel reflectance in [0, 1]; exactly 1 under total internal reflection and
        exactly 0 between equal media.
    sine_ratio : float
        Ratio by which the tangential component of the direction is scaled on refraction into
        the planes of constant real phase: sinθ_t / sinθ_i.
    cos_transmitted : float
        Cosine of the angle of refraction of these planes (0 under total internal reflection).
    """

    reflectance: float
    sine_ratio: float
    cos_transmitted: float


@inline
def normal_component(m, g, k, cos_i, absorbs):
    """Return a and b² of a + i b = (m + i k) cosθ_t, in units of the index of incidence.

    Born & Wolf 1999, Eqs 14.2.(8)-(12).  The real part of its square is cos²θ_i + m² − 1 − k²,
    written with g = m − 1 to preserve the digits of nearly equal indices; with ab = mk both parts
    of the root are free of cancellation.  Without absorption b is nonzero only in total reflection.

    Parameters
    ----------
    m, k : float
        Real and imaginary part of the relative index.
    g : float
        m − 1, from the difference of the indices.
    cos_i : float
        Cosine of the angle of incidence.
    absorbs : bool
        False takes k as 0 and is cheaper.
    """
    real = fma(cos_i, cos_i, g * (m + ONE))
    if absorbs:
        real = fma(-k, k, real)
        mk = m * k
        square = HALF * (sqrt(fma(real, real, FOUR * mk * mk)) + abs(real))
        per_large = rsqrt(max(square, TINY))
        large = square * per_large
        small = mk * per_large
        a = large if real > ZERO else small
        b = small if real > ZERO else large
        return NormalWave(a, b * b)
    return NormalWave(sqrt(max(real, ZERO)), max(-real, ZERO))


@inline
def unpolarized_reflectance(m, g, k, cos_i, sin2, wave):
    """Return numerator and denominator of the unpolarized Fresnel reflectance.

    Born & Wolf 1999: R_s = |(cosθ_i − (a+ib)) / (cosθ_i + (a+ib))|² and R_p = R_s times
    |(a+ib − sinθ_i tanθ_i) / (a+ib + sinθ_i tanθ_i)|²; the reflectance of unpolarized
    light is their mean.  The difference in R_s is |1 − (m+ik)²| / |cosθ_i + (a+ib)|, free of
    cancellation.  With separate numerator and denominator, a random number is compared without a
    division.

    Parameters
    ----------
    m, g, k, cos_i : float
        See `normal_component`.
    sin2 : float
        sin²θ_i.
    wave : NormalWave
    """
    a, b2 = wave
    k2 = k * k
    contrast = fma(g, g, k2) * fma(m + ONE, m + ONE, k2)
    plus = cos_i + a
    s_plus = fma(plus, plus, b2)
    a_cos = a * cos_i
    b2_cos2 = b2 * cos_i * cos_i
    minus = a_cos - sin2
    plus = a_cos + sin2
    p_minus = fma(minus, minus, b2_cos2)
    p_plus = fma(plus, plus, b2_cos2)
    return contrast * (p_minus + p_plus), s_plus * s_plus * (p_plus + p_plus)


@inline
def fresnel(n1, n2, k2, cos_i):
    """Return the `FresnelResult` of an interface.

    Parameters
    ----------
    n1 : float
        Real refractive index on the side of incidence.
    n2, k2 : float
        Complex refractive index n2 + i k2 on the far side.
    cos_i : float
        Cosine of the angle of incidence, in (0, 1].
    """
    m = n2 / n1
    k = k2 / n1
    if m == ONE and k == ZERO:
        return FresnelResult(0.0, 1.0, cos_i)
    g = (n2 - n1) / n1
    sin2 = (ONE - cos_i) * (ONE + cos_i)
    wave = normal_component(m, g, k, cos_i, k != ZERO)
    if wave.a == ZERO:
        return FresnelResult(1.0, 0.0, 0.0)
    numerator, denominator = unpolarized_reflectance(m, g, k, cos_i, sin2, wave)
    ratio = rsqrt(fma(wave.a, wave.a, sin2))
    return FresnelResult(min(numerator / denominator, 1.0), ratio, wave.a * ratio)


@inline
def fresnel_between(n1, k1, n2, k2, cos_i):
    """Return the `FresnelResult` of two media; equal complex indices do not reflect."""
    if n1 == n2 and k1 == k2:
        return FresnelResult(0.0, 1.0, cos_i)
    return fresnel(n1, n2, k2, cos_i)


@inline
def refract(d, n, cos_i, fresnel_result):
    """Return the refracted direction for incidence along d on the facet normal n (d·n < 0)."""
    k = fresnel_result.sine_ratio * cos_i - fresnel_result.cos_transmitted
    return normalize(linear_combination(fresnel_result.sine_ratio, d, k, n))


# --------------------------------------------------------------------------------------------------
# Reflection and refraction of rays at a smooth interface.

MIN_COS_INCIDENCE = 1e-12
"""Smallest cosine of incidence, at which all light is reflected."""


class ComplexIndex(NamedTuple):
    """Complex refractive index n + i k."""

    n: float
    k: float


class InterfaceSample(NamedTuple):
    """Whether a ray was transmitted, and its new direction."""

    transmitted: bool
    direction: Vector


@inline
def sample_interface(d, normal, near, far, u):
    """Sample reflection or refraction of a ray along d.

    Parameters
    ----------
    d, normal : Vector
        The normal is against d.
    near, far : ComplexIndex
        On the side of incidence, and on the far side.
    u : float
        A uniform random number.
    """
    cos_i = min(max(-dot(d, normal), MIN_COS_INCIDENCE), 1.0)
    result = fresnel_between(near.n, near.k, far.n, far.k, cos_i)
    if u < result.reflectance:
        return InterfaceSample(False, reflect(d, normal))
    if result.sine_ratio == 1.0 and result.cos_transmitted == cos_i:
        return InterfaceSample(True, d)
    return InterfaceSample(True, refract(d, normal, cos_i, result))


@inline
def orient_horizontal_normal(d):
    """Return the normal of a horizontal interface that points against a ray along d."""
    return Vector(0.0, 0.0, -1.0 if d.z > 0.0 else 1.0)


# --------------------------------------------------------------------------------------------------
# Reflection and refraction of polarized light at a smooth interface.
#
# The plane of incidence is the reference plane of all beams, see `splits.kernels.stokes`.


class MuellerElements(NamedTuple):
    """Elements of reflection or refraction, see `compute_mueller`.

    R₊, R₋ and a + ib = r_p r_s*, or T₊, T₋ and c + id = √(T_s T_p) e^(iδ).
    """

    plus: float
    minus: float
    real: float
    imaginary: float


class InterfaceMueller(NamedTuple):
    """Mueller matrices of an interface, and its unpolarized `FresnelResult`."""

    reflection: MuellerElements
    transmission: MuellerElements
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
    """Return `compute_mueller` for real refractive indices before and behind the interface."""
    return compute_mueller(n2 / n1, (n2 - n1) / n1, 0.0, cos_i)


@inline
def compute_mueller(m, g, k, cos_i):
    """Return the Mueller matrices of an interface.

    Born & Wolf 1999, sections 1.5 and 14.2, with the plane of incidence as reference of all three
    beams.  Reflection maps (I, Q, U, V) to

        R₊ I + R₋ Q,  R₋ I + R₊ Q,  a U + b V,  a V − b U,   a + ib = r_p r_s*,

    and refraction, in energy flux through the interface, to T₊ I + T₋ Q, T₋ I + T₊ Q, c U + d V,
    c V − d U with c + id = √(T_s T_p) e^(iδ) and the phase δ of t_p t_s*, 0 without absorption.
    Plus and minus denote (R_p ± R_s)/2; r_p = −r_s at normal incidence, where the reference
    reverses with the light.  In units of the index before the interface, which is taken as real,
    with w = (m + ik) cosθ_t, c and σ for cosine and sine of the angle of incidence,

        r_s = (c − w)/(c + w),   r_p = r_s h,   h = (σ² − wc)/(σ² + wc),
        t_p = t_s (m + ik)/(σ² + wc);

    at total reflection r_p r_s* = h = e^(−iδ), tan(δ/2) = c √(σ² − m²)/σ² (their section 1.5.4).
    R₋, T₊ and T₋ are expanded: nothing cancels near normal incidence, at grazing incidence or
    between nearly equal media.

    Parameters
    ----------
    m, k : float
        Real and imaginary part of the relative index.
    g : float
        m − 1, from the difference of the indices.
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].

    Returns
    -------
    InterfaceMueller
        R₊ and the `FresnelResult` agree with `fresnel`; R₋ ≤ 0, T₊ = 1 − R₊, T₋ = −R₋.
    """
    if g == 0.0 and k == 0.0:
        return InterfaceMueller(
            MuellerElements(0.0, 0.0, 0.0, 0.0),
            MuellerElements(1.0, 0.0, 1.0, 0.0),
            FresnelResult(0.0, 1.0, cos_i),
        )
    sin2 = (1.0 - cos_i) * (1.0 + cos_i)
    if k > 0.0:
        return _compute_absorbing_mueller(m, g, k, cos_i, sin2)
    a, b2 = normal_component(m, g, 0.0, cos_i, False)
    if a == 0.0:
        wc = math.sqrt(b2) * cos_i
        per = 1.0 / (sin2 * sin2 + wc * wc)
        reflection = MuellerElements(
            1.0, 0.0, (sin2 - wc) * (sin2 + wc) * per, -2.0 * sin2 * wc * per
        )
        return InterfaceMueller(
            reflection, MuellerElements(0.0, 0.0, 0.0, 0.0), FresnelResult(1.0, 0.0, 0.0)
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
        MuellerElements(r_plus, r_minus, rs * h, 0.0),
        MuellerElements(0.5 * ts * (1.0 + t * t), -r_minus, ts * t, 0.0),
        FresnelResult(r_plus, ratio, a * ratio),
    )


@inline_only
def _compute_absorbing_mueller(m, g, k, cos_i, sin2):
    """Return `compute_mueller` for an absorbing medium behind the interface."""
    a, b2 = normal_component(m, g, k, cos_i, True)
    b = math.sqrt(b2)
    ac, bc = a * cos_i, b * cos_i
    plus, minus = sin2 + ac, sin2 - ac
    per_s = 1.0 / ((cos_i + a) * (cos_i + a) + b2)
    per_h = 1.0 / (plus * plus + bc * bc)
    # |r_s|² = |(1 − (m + ik)²)/(c + w)²|².
    real, imaginary = g * (m + 1.0) - k * k, 2.0 * m * k
    rs = (real * real + imaginary * imaginary) * per_s * per_s
    r_plus = min(0.5 * rs * (1.0 + (minus * minus + bc * bc) * per_h), 1.0)
    r_minus = -2.0 * rs * sin2 * ac * per_h
    reflection = MuellerElements(
        r_plus, r_minus, rs * (minus * plus - bc * bc) * per_h, -2.0 * rs * sin2 * bc * per_h
    )
    t_plus = 1.0 - r_plus
    root = math.sqrt(max((t_plus - r_minus) * (t_plus + r_minus), 0.0))
    x, y = m * plus + k * bc, k * plus - m * bc
    scale = root / math.sqrt(x * x + y * y)
    ratio = 1.0 / math.sqrt(a * a + sin2)
    return InterfaceMueller(
        reflection,
        MuellerElements(t_plus, -r_minus, scale * x, scale * y),
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
    reflectance = mueller.reflection.plus + mueller.reflection.minus * incident.q
    d = normalize(reflect(d, normal))
    return ReflectedLight(reflectance, d, apply_mueller(d, incident, mueller.reflection))


@inline_only
def _refract_light(d, normal, incident, mueller):
    """Return the transmitted `PolarizedInterfaceSample` of an `IncidentLight`."""
    d = refract(d, normal, incident.cos_incidence, mueller.fresnel_result)
    return PolarizedInterfaceSample(True, d, apply_mueller(d, incident, mueller.transmission))


@inline_only
def apply_mueller(d, incident, elements):
    """Return the `Stokes` of an `IncidentLight` reflected or refracted into the direction d.

    Parameters
    ----------
    d : Vector
    incident : IncidentLight
    elements : MuellerElements
    """
    plus, minus, real, imaginary = elements
    _, plane_normal, q, u, v = incident
    e = normalize(cross(plane_normal, d))
    return normalize_stokes(
        e, plus + minus * q, minus + plus * q, real * u + imaginary * v, real * v - imaginary * u
    )


@inline
def compute_mueller_between(near, far, cos_i):
    """Return `compute_mueller` for `ComplexIndex` before and behind the interface."""
    same = near.n == far.n and near.k == far.k
    k = 0.0 if same else far.k / near.n
    return compute_mueller(far.n / near.n, (far.n - near.n) / near.n, k, cos_i)


@inline
def reflect_polarized(d, stokes, normal, near, far):
    """Return the reflectance of a smooth interface, and the reflected light.

    Parameters
    ----------
    d : Vector
        Direction of travel.
    stokes : Stokes
    normal : Vector
        Normal of the interface against the light, d·n ≤ 0.
    near, far : ComplexIndex
        On the side of incidence, whose real part counts, and on the far side.

    Returns
    -------
    ReflectedLight
        The reference is in the plane of incidence.
    """
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    mueller = compute_mueller_between(near, far, light.cos_incidence)
    return _reflect_light(d, normal, light, mueller)


@inline
def sample_polarized_interface(state, d, stokes, normal, near, far):
    """Sample reflection, with the probability R₊ + R₋ q, or refraction at a smooth interface.

    Parameters are those of `reflect_polarized`.

    Returns
    -------
    PolarizedInterfaceSample
        The reference is in the plane of incidence.
    """
    light = rotate_to_plane_of_incidence(d, stokes, normal)
    mueller = compute_mueller_between(near, far, light.cos_incidence)
    reflection = mueller.reflection
    if uniform(state) >= reflection.plus + reflection.minus * light.q:
        return _refract_light(d, normal, light, mueller)
    reflected = _reflect_light(d, normal, light, mueller)
    return PolarizedInterfaceSample(False, reflected.direction, reflected.stokes)


# --------------------------------------------------------------------------------------------------
# Scattering of rays at interfaces and particles, polarized or not.


@inline_only
def reflect_or_refract_ray(state, d, stokes, normal, near, far):
    """Reflect or refract a ray at a facet.

    Parameters
    ----------
    state : uint64[1]
    d : Vector
        Direction of travel.
    stokes : Stokes or None
        Polarization of the ray.
    normal : Vector
        Normal of the facet, against the ray.
    near, far : ComplexIndex
        Refractive indices on the side of incidence and on the far side.

    Returns
    -------
    PolarizedInterfaceSample
    """
    if stokes is None:
        sample = sample_interface(d, normal, near, far, uniform(state))
        return PolarizedInterfaceSample(sample.transmitted, sample.direction, stokes)
    return sample_polarized_interface(state, d, stokes, normal, near, far)


@inline_only
def reflect_only(d, stokes, normal, near, far):
    """Reflect a ray at a facet of an opaque medium.

    Parameters are those of `reflect_or_refract_ray`.

    Returns
    -------
    ReflectedLight
    """
    if stokes is None:
        cos_i = min(max(-dot(d, normal), MIN_COS_INCIDENCE), 1.0)
        reflectance = fresnel(near.n, far.n, far.k, cos_i).reflectance
        return ReflectedLight(reflectance, reflect(d, normal), stokes)
    return reflect_polarized(d, stokes, normal, near, far)


@inline_only
def sample_scattering(state, phase, d, stokes):
    """Sample the `DirectionSample` of a ray after scattering by a particle."""
    if stokes is None:
        return DirectionSample(sample_phase_function(state, phase, d), stokes)
    return scatter_polarized(state, phase, d, stokes)
