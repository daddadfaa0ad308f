"""Microfacets: the normal that a ray meets on a rough grain surface.

SPLITS section 4.2.3, Eq 3 and section 4.3.4; SPLITSnow section 3.3, Eqs 3-4: the facet normal n'
leans from the macroscopic normal n by n·n' = 1 − |ξ|, ξ normal with standard deviation
facetness/2 and n·n' > 0, at a uniform azimuth.  Facets have equal area, so a ray along d strikes
one with probability proportional to its projected area |n'·d|, among those facing the ray.
"""

from __future__ import annotations

import math

from splits.transport.frames import around
from splits.transport.jit import kernel
from splits.transport.rng import half_normal, uniform, unit_circle

PROJECTED = 0
"""Facets facing the ray, struck in proportion to their projected area (SPLITS 4.3.4)."""
UNWEIGHTED = 1
"""Facets facing the ray, each with the same probability."""
ANY = 2
"""Any facet; one that faces away acts through its opposite side."""


@kernel
def tilt_cosine(state, facetness):
    """Return n·n' = 1 − |ξ| > 0 for ξ ~ N(0, facetness/2) (SPLITSnow Eqs 3-4)."""
    while True:
        x = 0.5 * facetness * half_normal(state)
        if x < 1.0:
            return 1.0 - x


@kernel
def facet_angles(state, facetness, cos_i, rule):
    """Draw a facet in the frame whose polar axis is n and whose azimuth 0 faces the ray.

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

    Notes
    -----
    The projected rule is exact rejection sampling of the two mirror azimuths at once: for
    azimuths φ and π − φ the weights are max(0, A ± B), A = cosτ cosθ, B = sinτ sinθ |cosφ|; their
    sum never exceeds max(2 cosθ, 1), and the share of the second decides the sign of cosφ.
    """
    sin_i = math.sqrt(max(0.0, 1.0 - cos_i * cos_i))
    while True:
        c = tilt_cosine(state, facetness)
        s = math.sqrt(max(0.0, 1.0 - c * c))
        cp, sp = unit_circle(state)
        a = c * cos_i
        if rule != PROJECTED:
            cos_facet = a + s * sin_i * cp
            if cos_facet > 0.0 or (rule == ANY and cos_facet != 0.0):
                return c, s, cp, sp, cos_facet
            continue
        cp = abs(cp)
        b = s * sin_i * cp
        opposite = max(0.0, a - b)
        variate = uniform(state) * max(2.0 * cos_i, 1.0)
        if variate < a + b + opposite:
            if variate < opposite:
                return c, s, -cp, sp, a - b
            return c, s, cp, sp, a + b


@kernel
def struck_facet(state, dx, dy, dz, nx, ny, nz, facetness, rule):
    """Return the unit normal of the facet struck along d on a surface of normal n (d·n < 0).

    The facet's normal is returned on the side of the ray, so that d·n' < 0, together with the
    cosine of incidence on it.
    """
    # Rounding may turn a grazing ray to the far side; at 1e-12 all light is reflected anyway.
    cos_i = max(-(dx * nx + dy * ny + dz * nz), 1e-12)
    if facetness == 0.0:
        return nx, ny, nz, cos_i
    c, s, cp, sp, cos_facet = facet_angles(state, facetness, cos_i, rule)
    # Tangential part of −d; at exactly normal incidence every azimuth is alike.
    tx = -dx - cos_i * nx
    ty = -dy - cos_i * ny
    tz = -dz - cos_i * nz
    length2 = tx * tx + ty * ty + tz * tz
    if length2 < 1e-20:
        mx, my, mz = around(nx, ny, nz, c, s, cp, sp)
    else:
        scale = 1.0 / math.sqrt(length2)
        tx *= scale
        ty *= scale
        tz *= scale
        p = s * cp
        q = s * sp
        mx = c * nx + p * tx + q * (ny * tz - nz * ty)
        my = c * ny + p * ty + q * (nz * tx - nx * tz)
        mz = c * nz + p * tz + q * (nx * ty - ny * tx)
    cos_facet = -(dx * mx + dy * my + dz * mz)
    if cos_facet < 0.0:
        return -mx, -my, -mz, -cos_facet
    return mx, my, mz, max(cos_facet, 1e-12)
