"""Fresnel reflection and Snell refraction of unpolarized light at a plane interface.

Light arrives through a medium of real refractive index n1 at a medium of complex index n2 + i k2.
Absorption and total reflection on the far side are covered by one formula (Born & Wolf 1999,
Principles of Optics, 7th ed., sections 1.5.2-1.5.4 and 14.2; SPLITS section 4.3.4).  Rays follow
the planes of constant real phase, so the side of incidence, too, enters with its real index.  Total
reflection then stays total and no surface emits more than a black body, which a complex tangential
wave number would violate to first order in k1/n1.  Where k1/n1 is large, hardly any light arrives
from inside a coating or a grain.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.jit import FOUR, HALF, ONE, TINY, ZERO, inline
from splits.kernels.math.arithmetic import fma, rsqrt, sqrt
from splits.kernels.math.vectors import linear_combination, normalize


class NormalWave(NamedTuple):
    """Normal component a + i b of the transmitted wave, as a and b²."""

    a: float
    b2: float


class ReflectanceFraction(NamedTuple):
    """Numerator and denominator of a reflectance."""

    numerator: float
    denominator: float


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
    return ReflectanceFraction(contrast * (p_minus + p_plus), s_plus * s_plus * (p_plus + p_plus))


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
    reflectance = unpolarized_reflectance(m, g, k, cos_i, sin2, wave)
    ratio = rsqrt(fma(wave.a, wave.a, sin2))
    return FresnelResult(
        min(reflectance.numerator / reflectance.denominator, 1.0), ratio, wave.a * ratio
    )


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
