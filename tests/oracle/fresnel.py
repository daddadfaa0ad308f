"""Fresnel reflection and Snell refraction of unpolarized light at a plane interface.

Light is incident from a medium of real refractive index n1 on a medium of complex index
n2 + i k2.  The far side may absorb, reflect totally, or both; one formula covers these cases
(Born & Wolf 1999, Principles of Optics, 7th ed., sections 1.5.2-1.5.4 and 14.2; SPLITS section
4.3.4).  Rays follow the planes of constant real phase, so the side of incidence, too, is taken by
its real index: total reflection then stays total and no surface outshines a black body, which
a complex tangential wave number would violate to first order in k1/n1.  Against the flux of an
inhomogeneous wave the neglect is below 1 % of diffuse light up to k1/n1 = 0.1; for larger ratios
a coating or a grain transmits hardly any light from inside.
"""

from oracle.arithmetic import fused, reciprocal_root, root
from oracle.frames import normalized
from oracle.jit import FOUR, HALF, ONE, TINY, ZERO, kernel


@kernel
def compute_normal_component(m, g, k, cos_i, absorbs):
    """Return a and b² of a + i b = (m + i k) cosθ_t, in units of the index of incidence.

    Born & Wolf 1999, Eqs 14.2.(8)-(12).  The real part of its square is cos²θ_i + m² − 1 − k²,
    written with g = m − 1 so that nearly equal indices keep their digits; with ab = mk both parts
    of the root come without cancellation.  Without absorption b is that of total reflection.

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
    real = fused(cos_i, cos_i, g * (m + ONE))
    if absorbs:
        real = fused(-k, k, real)
        mk = m * k
        square = HALF * (root(fused(real, real, FOUR * mk * mk)) + abs(real))
        per_large = reciprocal_root(max(square, TINY))
        large = square * per_large
        small = mk * per_large
        a = large if real > ZERO else small
        b = small if real > ZERO else large
        return a, b * b
    return root(max(real, ZERO)), max(-real, ZERO)


@kernel
def compute_reflectance_ratio(m, g, k, cos_i, sin2, a, b2):
    """Return numerator and denominator of the unpolarized Fresnel reflectance.

    Born & Wolf 1999: R_s = |(cosθ_i − (a+ib)) / (cosθ_i + (a+ib))|² and R_p = R_s times
    |(a+ib − sinθ_i tanθ_i) / (a+ib + sinθ_i tanθ_i)|²; the mean is that of unpolarized light.  The
    difference in R_s is |1 − (m+ik)²| / |cosθ_i + (a+ib)|, free of cancellation.  Kept apart, the
    two can be compared with a random number without a division.

    Parameters
    ----------
    m, g, k, cos_i, a, b2 : float
        See `compute_normal_component`.
    sin2 : float
        sin²θ_i.
    """
    k2 = k * k
    contrast = fused(g, g, k2) * fused(m + ONE, m + ONE, k2)
    plus = cos_i + a
    s_plus = fused(plus, plus, b2)
    product = a * cos_i
    b2_cos2 = b2 * cos_i * cos_i
    minus = product - sin2
    plus = product + sin2
    p_minus = fused(minus, minus, b2_cos2)
    p_plus = fused(plus, plus, b2_cos2)
    return contrast * (p_minus + p_plus), s_plus * s_plus * (p_plus + p_plus)


@kernel
def compute_interface(n1, n2, k2, cos_i):
    """Return reflectance and refraction at an interface.

    Parameters
    ----------
    n1 : float
        Real refractive index on the side of incidence.
    n2, k2 : float
        Complex refractive index n2 + i k2 of the far side.
    cos_i : float
        Cosine of the angle of incidence, in (0, 1].

    Returns
    -------
    reflectance : float
        Unpolarized Fresnel reflectance in [0, 1]; exactly 1 under total internal reflection and
        exactly 0 between equal media.
    ratio : float
        Ratio by which the tangential component of the direction is scaled on refraction into
        the planes of constant real phase: sinθ_t / sinθ_i.
    cos_t : float
        Cosine of the angle of refraction of these planes (0 under total internal reflection).
    """
    m = n2 / n1
    k = k2 / n1
    if m == ONE and k == ZERO:
        return 0.0, 1.0, cos_i
    g = (n2 - n1) / n1
    sin2 = (ONE - cos_i) * (ONE + cos_i)
    a, b2 = compute_normal_component(m, g, k, cos_i, k != ZERO)
    if a == ZERO:
        return 1.0, 0.0, 0.0
    numerator, denominator = compute_reflectance_ratio(m, g, k, cos_i, sin2, a, b2)
    ratio = reciprocal_root(fused(a, a, sin2))
    return min(numerator / denominator, 1.0), ratio, a * ratio


@kernel
def compute_media_interface(n1, k1, n2, k2, cos_i):
    """Return what `interface` returns; media of equal complex index have no interface at all."""
    if n1 == n2 and k1 == k2:
        return 0.0, 1.0, cos_i
    return compute_interface(n1, n2, k2, cos_i)


@kernel
def refract(dx, dy, dz, nx, ny, nz, cos_i, ratio, cos_t):
    """Return the refracted direction for incidence along d on the facet normal n (d·n < 0)."""
    k = ratio * cos_i - cos_t
    return normalized(fused(ratio, dx, k * nx), fused(ratio, dy, k * ny), fused(ratio, dz, k * nz))
