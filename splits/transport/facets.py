"""Microfacets: the normal that a ray meets on a rough grain surface.

SPLITS section 4.2.3, Eq 3 and section 4.3.4; SPLITSnow section 3.3, Eqs 3-4: the facet normal n'
leans from the macroscopic normal n by n·n' = 1 − |ξ|, ξ normal with standard deviation
facetness/2 and n·n' > 0, at a uniform azimuth.  Facets have equal area, so a ray along d strikes
one with probability proportional to its projected area |n'·d|, among those facing the ray.
"""

from __future__ import annotations

from typing import NamedTuple

from splits.transport.arithmetic import fused
from splits.transport.jit import HALF, ONE, TWO, ZERO, kernel
from splits.transport.vectors import along, cross, scaled

PROJECTED = 0
"""Facets facing the ray, struck in proportion to their projected area (SPLITS 4.3.4)."""
UNWEIGHTED = 1
"""Facets facing the ray, each with the same probability."""
ANY = 2
"""Any facet; one that faces away acts through its opposite side."""


class Choice(NamedTuple):
    """A facet, accepted or not.

    Attributes
    ----------
    accepted : bool
        False asks for another.
    cos_azimuth : float
        Of the facet, counted from the tangential part of −d, with its sign.
    cos : float
        Cosine of incidence on the facet, −d·n' (negative only under `ANY`).
    """

    accepted: bool
    cos_azimuth: float
    cos: float


@kernel
def projected_choice(tilt, cos_azimuth, incidence, u):
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
    return Choice(variate < a + b + opposite, -cos_azimuth if mirror else cos_azimuth, cos_facet)


@kernel
def other_choice(tilt, cos_azimuth, incidence, u, rule):
    """Return what `projected_choice` does, for the rules `UNWEIGHTED` and `ANY`."""
    cos_azimuth = -cos_azimuth if u < HALF else cos_azimuth
    cos_facet = fused(tilt.cos, incidence.cos, tilt.sin * incidence.sin * cos_azimuth)
    accepted = (cos_facet > ZERO) | ((rule == ANY) & (cos_facet < ZERO))
    return Choice(accepted, cos_azimuth, cos_facet)


@kernel
def facet_normal(d, n, cos_i, leaned, azimuth):
    """Return the facet's normal, its azimuth counted from the tangential part of −d.

    c n + (s / sinθ) (cosφ t + sinφ d×n), t = −d − cosθ n: both tangents have length sinθ.

    Parameters
    ----------
    d, n : Vector
    cos_i : float
        cosθ.
    leaned : Angle
        Cosine c of the tilt, and s / sinθ in place of its sine.
    azimuth : Angle
    """
    p = leaned.sin * azimuth.cos
    q = leaned.sin * azimuth.sin
    a = fused(-p, cos_i, leaned.cos)
    return along(q, cross(d, n), along(-p, d, scaled(a, n)))
