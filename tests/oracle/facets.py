"""Microfacets: sampling of the normal on a rough grain surface.

SPLITS section 4.2.3, Eq 3 and section 4.3.4; SPLITSnow section 3.3, Eqs 3-4: the facet normal n'
is tilted from the macroscopic normal n by n·n' = 1 − |ξ|, ξ normal with standard deviation
facetness/2 and n·n' > 0, at a uniform azimuth.  Facets have equal area, so a ray along d hits one
with probability proportional to its projected area |n'·d|, among those facing the ray.
"""

import math

from oracle.arithmetic import fused, root
from oracle.frames import around, dot, normalized
from oracle.jit import ONE, TWO, ZERO, kernel
from oracle.rng import half_normal, uniform, unit_circle

PROJECTED = 0
"""Facets facing the ray, hit in proportion to their projected area (SPLITS 4.3.4)."""
UNWEIGHTED = 1
"""Facets facing the ray, each with the same probability."""
ANY = 2
"""Any facet; one that faces away is used with the opposite normal."""


@kernel
def sample_tilt(state, facetness):
    """Return 1 − n·n' = |ξ| < 1 for ξ ~ N(0, facetness/2) (SPLITSnow Eqs 3-4)."""
    while True:
        x = 0.5 * facetness * half_normal(state)
        if x < 1.0:
            return x


@kernel
def compute_tilt_sine(tilt):
    """Return the sine of the angle whose cosine is 1 − `tilt`, without cancellation."""
    return root(tilt * (TWO - tilt))


@kernel
def accept_projected_facet(c, s, cos_azimuth, cos_i, sin_i, u):
    """Accept or reject a facet in proportion to its projected area, and sample its azimuth.

    Exact rejection sampling of two mirror azimuths at once: for φ and π − φ the weights are
    max(0, A ± B), A = cosτ cosθ, B = sinτ sinθ |cosφ|; their sum never exceeds max(2 cosθ, 1),
    and the fraction of the second determines the sign of cosφ.

    Parameters
    ----------
    c, s : float
        Cosine and sine of the tilt τ.
    cos_azimuth : float
        |cosφ|.
    cos_i, sin_i : float
        Of the angle θ between −d and n.
    u : float
        A uniform random number.

    Returns
    -------
    accepted : bool
    cos_azimuth : float
        With its sign.
    cos_facet : float
        Cosine of incidence on the facet.
    """
    a = c * cos_i
    b = s * sin_i * cos_azimuth
    opposite = max(ZERO, a - b)
    variate = u * max(TWO * cos_i, ONE)
    takes_opposite = variate < opposite
    cos_facet = a - b if takes_opposite else a + b
    return variate < a + b + opposite, -cos_azimuth if takes_opposite else cos_azimuth, cos_facet


@kernel
def compute_facet_normal(dx, dy, dz, nx, ny, nz, cos_i, per_sin, c, s, cos_azimuth, sin_azimuth):
    """Return the facet's normal, its azimuth counted from the tangential part of −d.

    c n + (s / sinθ) (cosφ t + sinφ d×n), t = −d − cosθ n: both tangents have length sinθ, of
    which `per_sin` is the reciprocal.
    """
    k = s * per_sin
    p = k * cos_azimuth
    q = k * sin_azimuth
    a = fused(-p, cos_i, c)
    return (
        fused(q, fused(dy, nz, -dz * ny), fused(-p, dx, a * nx)),
        fused(q, fused(dz, nx, -dx * nz), fused(-p, dy, a * ny)),
        fused(q, fused(dx, ny, -dy * nx), fused(-p, dz, a * nz)),
    )


@kernel
def sample_facet_angles(state, facetness, cos_i, rule):
    """Sample a facet in the frame whose polar axis is n and whose azimuth 0 faces the ray.

    Parameters
    ----------
    state : uint64[1]
    facetness : float
        In [0, 1]; 0 is a smooth surface.
    cos_i : float
        Cosine between −d and n, in (0, 1].
    rule : int
        `PROJECTED`, `UNWEIGHTED` or `ANY`.

    Returns
    -------
    cos_tilt, sin_tilt, cos_azimuth, sin_azimuth : float
        Facet orientation; the azimuth is counted from the tangential part of −d.
    cos_facet : float
        Cosine of incidence on the facet, −d·n' (negative only under `ANY`).
    """
    sin_i = math.sqrt(max(0.0, 1.0 - cos_i * cos_i))
    while True:
        x = sample_tilt(state, facetness)
        c = 1.0 - x
        s = compute_tilt_sine(x)
        cp, sp = unit_circle(state)
        if rule == PROJECTED:
            accepted, cp, cos_facet = accept_projected_facet(
                c, s, abs(cp), cos_i, sin_i, uniform(state)
            )
            if accepted:
                return c, s, cp, sp, cos_facet
        else:
            cos_facet = c * cos_i + s * sin_i * cp
            if cos_facet > 0.0 or (rule == ANY and cos_facet != 0.0):
                return c, s, cp, sp, cos_facet


@kernel
def sample_facet(state, dx, dy, dz, nx, ny, nz, facetness, rule):
    """Sample the facet hit along d on a surface of normal n (d·n < 0), and return its unit normal.

    The facet's normal is returned on the side of the ray, so that d·n' < 0, together with the
    cosine of incidence on it.
    """
    # Rounding may move a grazing ray to the far side; at 1e-12 all light is reflected.
    cos_i = max(-dot(dx, dy, dz, nx, ny, nz), 1e-12)
    if facetness == 0.0:
        return nx, ny, nz, cos_i
    c, s, cp, sp, _ = sample_facet_angles(state, facetness, cos_i, rule)
    # The sine from the tangential part itself: 1 − cos² has no digits left at normal incidence.
    tx = -dx - cos_i * nx
    ty = -dy - cos_i * ny
    tz = -dz - cos_i * nz
    sin2 = dot(tx, ty, tz, tx, ty, tz)
    if sin2 < 1e-20:
        # At exactly normal incidence all azimuths are equivalent.
        mx, my, mz = around(nx, ny, nz, c, s, cp, sp)
    else:
        per_sin = 1.0 / math.sqrt(sin2)
        mx, my, mz = compute_facet_normal(dx, dy, dz, nx, ny, nz, cos_i, per_sin, c, s, cp, sp)
        mx, my, mz = normalized(mx, my, mz)
    cos_facet = -dot(dx, dy, dz, mx, my, mz)
    if cos_facet < 0.0:
        return -mx, -my, -mz, -cos_facet
    return mx, my, mz, max(cos_facet, 1e-12)
