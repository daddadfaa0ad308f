"""Microfacets: sampling of the facet normal at a rough grain surface.

SPLITS section 4.2.3, Eq 3 and section 4.3.4; SPLITSnow section 3.3, Eqs 3-4: the facet normal n' is
tilted from the macroscopic normal n by n·n' = 1 − |ξ|, ξ normal with standard deviation facetness/2
and n·n' > 0, at a uniform azimuth.  Facets have equal area, so a ray along d hits one with
probability proportional to its projected area |n'·d|, among those facing the ray.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.base.sampling_rules import ANY_FACETS, PROJECTED_FACETS
from splits.kernels.compiler.jit import HALF, ONE, TWO, ZERO, inline
from splits.kernels.grains.spheroid import compute_outward_normal
from splits.kernels.math.arithmetic import fma, get_precision, rsqrt, sqrt
from splits.kernels.math.elementary import Angle
from splits.kernels.math.vectors import Vector, add_scaled, cross, dot, scale


class FacetSample(NamedTuple):
    """Sampled facet, accepted or not.

    Attributes
    ----------
    accepted : bool
        False requires another sample.
    cos_azimuth : float
        Cosine of the azimuth of the facet from the tangential part of −d, with its sign.
    cos_incidence : float
        Cosine of incidence on the facet, −d·n' (negative only under `ANY_FACETS`).
    """

    accepted: bool
    cos_azimuth: float
    cos_incidence: float


class Microfacet(NamedTuple):
    """Surface and facet at the hit point of a ray.

    Attributes
    ----------
    normal : Vector
        Normal of the macroscopic surface, on the side of the ray.
    cos_i : float
        Cosine of incidence on it.
    accepted : bool
    back_side : bool
        The ray hits the back side of the facet.
    cos_facet : float
        Cosine of incidence on the facet.
    tilt, azimuth : Angle
        See `compute_facet_normal`, for a facet or a lobe.
    cos_lobe_azimuth : float
        Cosine of the azimuth of a lobe; its sine is that of the facet.
    """

    normal: Vector
    cos_i: float
    accepted: bool
    back_side: bool
    cos_facet: float
    tilt: Angle
    azimuth: Angle
    cos_lobe_azimuth: float


@inline
def sample_projected_facet(tilt, cos_azimuth, incidence, u):
    """Accept or reject a facet in proportion to its projected area, and determine its azimuth.

    Exact rejection sampling of two mirror azimuths at once: for φ and π − φ the weights are
    max(0, A ± B), A = cosτ cosθ, B = sinτ sinθ |cosφ|; their sum never exceeds max(2 cosθ, 1),
    and the fraction of the second determines the sign of cosφ.

    Parameters
    ----------
    tilt : Angle
        τ, from n.
    cos_azimuth : float
        |cosφ|.
    incidence : Angle
        θ, between −d and n.
    u : float
        A uniform random number.
    """
    a = tilt.cos * incidence.cos
    b = tilt.sin * incidence.sin * cos_azimuth
    opposite = max(ZERO, a - b)
    variate = u * max(TWO * incidence.cos, ONE)
    mirror = variate < opposite
    cos_facet = a - b if mirror else a + b
    return FacetSample(
        variate < a + b + opposite, -cos_azimuth if mirror else cos_azimuth, cos_facet
    )


@inline
def sample_unweighted_facet(tilt, cos_azimuth, incidence, u, rule):
    """Sample a facet with the rule `UNWEIGHTED_FACETS` or `ANY_FACETS`."""
    cos_azimuth = -cos_azimuth if u < HALF else cos_azimuth
    cos_facet = fma(tilt.cos, incidence.cos, tilt.sin * incidence.sin * cos_azimuth)
    accepted = (cos_facet > ZERO) | ((rule == ANY_FACETS) & (cos_facet < ZERO))
    return FacetSample(accepted, cos_azimuth, cos_facet)


@inline
def compute_facet_normal(d, n, cos_i, tilt, azimuth):
    """Return the normal of a facet, with azimuths from the tangential part of −d.

    c n + (s / sinθ) (cosφ t + sinφ d×n), t = −d − cosθ n: both tangents have length sinθ.

    Parameters
    ----------
    d, n : Vector
    cos_i : float
        cosθ.
    tilt : Angle
        Cosine c of the tilt, and s / sinθ in place of its sine.
    azimuth : Angle
    """
    p = tilt.sin * azimuth.cos
    q = tilt.sin * azimuth.sin
    a = fma(-p, cos_i, tilt.cos)
    return add_scaled(q, cross(d, n), add_scaled(-p, d, scale(a, n)))


@inline
def make_smooth_facet(d, grain, side):
    """Return the smooth surface at the position of a ray along d, as its only facet."""
    normal = scale(side, compute_outward_normal(grain))
    cos_i = max(-dot(d, normal), get_precision(d.x).min_cos_incidence)
    precision = get_precision(d.x)
    flat = Angle(precision.one, precision.zero)
    return Microfacet(normal, cos_i, True, False, cos_i, flat, flat, precision.one)


@inline
def sample_microfacet(d, smooth, roughness, variates, in_lobe, rule):
    """Sample a facet of a rough surface with a rule, by default `PROJECTED_FACETS`."""
    normal, cos_i = smooth.normal, smooth.cos_i
    tangential = add_scaled(cos_i, normal, d)
    square = max(dot(tangential, tangential), get_precision(d.x).min_sin2_incidence)
    per_sin = rsqrt(square)
    incidence = Angle(cos_i, square * per_sin)
    # 1 − n·n' = |ξ|, ξ ~ N(0, facetness/2) (SPLITSnow Eqs 3-4), below 1.
    one_minus_cos_tilt = roughness * variates.half_normal
    # One root serves the sine of a facet or of a lobe.
    tilt = Angle(
        ONE - one_minus_cos_tilt,
        sqrt(
            max(
                ONE - variates.u_fresnel
                if in_lobe
                else one_minus_cos_tilt * (TWO - one_minus_cos_tilt),
                ZERO,
            )
        ),
    )
    half = variates.azimuth
    cos_lobe = -half.cos if variates.u_facet < HALF else half.cos
    if rule != PROJECTED_FACETS:
        sample = sample_unweighted_facet(tilt, half.cos, incidence, variates.u_facet, rule)
    else:
        sample = sample_projected_facet(tilt, half.cos, incidence, variates.u_facet)
    return Microfacet(
        normal,
        cos_i,
        sample.accepted & (one_minus_cos_tilt < ONE),
        sample.cos_incidence < ZERO,
        max(abs(sample.cos_incidence), get_precision(d.x).min_cos_incidence),
        Angle(tilt.cos, tilt.sin * per_sin),
        Angle(sample.cos_azimuth, half.sin),
        cos_lobe,
    )
