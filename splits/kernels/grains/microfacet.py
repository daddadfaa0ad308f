"""Microfacets: the normal that a ray meets on a rough grain surface.

SPLITS section 4.2.3, Eq 3 and section 4.3.4; SPLITSnow section 3.3, Eqs 3-4: the facet normal n'
leans from the macroscopic normal n by n·n' = 1 − |ξ|, ξ normal with standard deviation
facetness/2 and n·n' > 0, at a uniform azimuth.  Facets have equal area, so a ray along d strikes
one with probability proportional to its projected area |n'·d|, among those facing the ray.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.compiler.jit import HALF, ONE, TWO, ZERO, inline
from splits.kernels.grains.spheroid import compute_outward_normal
from splits.kernels.math.arithmetic import fma, get_precision, rsqrt, sqrt
from splits.kernels.math.elementary import Angle
from splits.kernels.math.vectors import Vector, add_scaled, cross, dot, scale

PROJECTED_FACETS = 0
"""Facets facing the ray, struck in proportion to their projected area (SPLITS 4.3.4)."""
UNWEIGHTED_FACETS = 1
"""Facets facing the ray, each with the same probability."""
ANY_FACETS = 2
"""Any facet; one that faces away acts through its opposite side."""


class FacetSample(NamedTuple):
    """A facet, accepted or not.

    Attributes
    ----------
    accepted : bool
        False asks for another.
    cos_azimuth : float
        Of the facet, counted from the tangential part of −d, with its sign.
    cos_incidence : float
        Cosine of incidence on the facet, −d·n' (negative only under `ANY_FACETS`).
    """

    accepted: bool
    cos_azimuth: float
    cos_incidence: float


class Microfacet(NamedTuple):
    """A surface and a facet on it as a ray meets them.

    Attributes
    ----------
    normal : Vector
        Of the macroscopic surface, on the ray's side.
    cos_i : float
        Cosine of incidence on it.
    accepted : bool
    back_side : bool
        The facet's opposite side is struck.
    cos_facet : float
        Cosine of incidence on the facet.
    leaned, azimuth, cos_lobe
        See `compute_facet_normal`, for a facet or a lobe; the cosine of the lobe's azimuth, whose
        sine is the facet's.
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
    """Accept or reject a facet in proportion to its projected area, and settle its azimuth.

    Exact rejection sampling of two mirror azimuths at once: for φ and π − φ the weights are
    max(0, A ± B), A = cosτ cosθ, B = sinτ sinθ |cosφ|; their sum never exceeds max(2 cosθ, 1),
    and the share of the second decides the sign of cosφ.

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
    """Return what `sample_projected_facet` does, for the rules `UNWEIGHTED_FACETS` and `ANY_FACETS`."""
    cos_azimuth = -cos_azimuth if u < HALF else cos_azimuth
    cos_facet = fma(tilt.cos, incidence.cos, tilt.sin * incidence.sin * cos_azimuth)
    accepted = (cos_facet > ZERO) | ((rule == ANY_FACETS) & (cos_facet < ZERO))
    return FacetSample(accepted, cos_azimuth, cos_facet)


@inline
def compute_facet_normal(d, n, cos_i, tilt, azimuth):
    """Return the facet's normal, its azimuth counted from the tangential part of −d.

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
    """Return the smooth surface where a ray along d is, as its own only facet."""
    normal = scale(side, compute_outward_normal(grain))
    cos_i = max(-dot(d, normal), get_precision(d.x).min_cos_incidence)
    numbers = get_precision(d.x)
    flat = Angle(numbers.one, numbers.zero)
    return Microfacet(normal, cos_i, True, False, cos_i, flat, flat, numbers.one)


@inline
def sample_microfacet(d, smooth, roughness, variates, in_lobe, rule):
    """Return a facet of a rough surface, drawn by a rule; by default `PROJECTED_FACETS`."""
    normal, cos_i = smooth.normal, smooth.cos_i
    tangential = add_scaled(cos_i, normal, d)
    square = max(dot(tangential, tangential), get_precision(d.x).min_sin2_incidence)
    per_sin = rsqrt(square)
    incidence = Angle(cos_i, square * per_sin)
    # 1 − n·n' = |ξ|, ξ ~ N(0, facetness/2) (SPLITSnow Eqs 3-4), below 1.
    lean = roughness * variates.half_normal
    # A lobe's sine takes the same root.
    tilt = Angle(
        ONE - lean, sqrt(max(ONE - variates.u_fresnel if in_lobe else lean * (TWO - lean), ZERO))
    )
    half = variates.azimuth
    cos_lobe = -half.cos if variates.u_facet < HALF else half.cos
    if rule != PROJECTED_FACETS:
        choice = sample_unweighted_facet(tilt, half.cos, incidence, variates.u_facet, rule)
    else:
        choice = sample_projected_facet(tilt, half.cos, incidence, variates.u_facet)
    return Microfacet(
        normal,
        cos_i,
        choice.accepted & (lean < ONE),
        choice.cos_incidence < ZERO,
        max(abs(choice.cos_incidence), get_precision(d.x).min_cos_incidence),
        Angle(tilt.cos, tilt.sin * per_sin),
        Angle(choice.cos_azimuth, half.sin),
        cos_lobe,
    )
