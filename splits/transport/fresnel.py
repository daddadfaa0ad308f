"""Fresnel reflection and Snell refraction of unpolarised light at a plane interface.

Both sides may absorb (Born & Wolf 1999, Principles of Optics, 7th ed., sections 1.5.2-1.5.4 and
14.2; SPLITS section 4.3.4).  Rays follow the planes of constant real phase.  `interface` takes
the side of incidence as transparent, in real arithmetic; `absorbing_interface` does not, and
`between` picks the one that a pair of media needs.
"""

from __future__ import annotations

import math

import numpy as np

from splits.transport.jit import kernel

NEARLY_TRANSPARENT = 3e-3
"""Up to this k1/n1 the side of incidence counts as transparent, which moves the reflectance of
diffuse light by 1.5 % at most, through total reflection that absorption makes incomplete.  Ice and
water stay below it up to 2.6 µm."""


@kernel
def interface(n1, n2, k2, cos_i):
    """Return reflectance and refraction at an interface.

    Born & Wolf 1999: with n2' cosθ_t = a + i b in units of n1 (Eqs 14.2.(8)-(12)), the
    reflectances are |(cosθ_i − (a+ib)) / (cosθ_i + (a+ib))|² for s polarisation and, for p, that
    times |(a+ib − sinθ_i tanθ_i) / (a+ib + sinθ_i tanθ_i)|²; unpolarised light sees the mean.

    Parameters
    ----------
    n1 : float
        Real refractive index on the side of incidence.
    n2, k2 : float
        Complex refractive index n2 + i k2 beyond.
    cos_i : float
        Cosine of the angle of incidence, in (0, 1].

    Returns
    -------
    reflectance : float
        Unpolarised Fresnel reflectance in [0, 1]; exactly 1 under total internal reflection and
        exactly 0 between equal media.
    ratio : float
        Ratio by which the tangential component of the direction is scaled on refraction into
        the planes of constant real phase: sinθ_t / sinθ_i.
    cos_t : float
        Cosine of the angle of refraction of these planes (0 under total internal reflection).
    """
    m = n2 / n1
    k = k2 / n1
    if m == 1.0 and k == 0.0:
        return 0.0, 1.0, cos_i
    sin2 = max(0.0, 1.0 - cos_i * cos_i)
    real = m * m - k * k - sin2
    if k == 0.0:
        if real <= 0.0:
            return 1.0, 0.0, 0.0
        a = math.sqrt(real)
        b2 = 0.0
    else:
        root = math.sqrt(real * real + 4.0 * m * m * k * k)
        # Both halves of the root without cancellation: a b = m k exactly.
        if real > 0.0:
            a = math.sqrt(0.5 * (root + real))
            b2 = (m * k / a) ** 2
        else:
            b2 = 0.5 * (root - real)
            a = m * k / math.sqrt(b2)
    r_s = ((cos_i - a) ** 2 + b2) / ((cos_i + a) ** 2 + b2)
    t = sin2 / cos_i
    r_p = r_s * ((a - t) ** 2 + b2) / ((a + t) ** 2 + b2)
    ratio = 1.0 / math.sqrt(sin2 + a * a)
    return 0.5 * (r_s + r_p), ratio, a * ratio


@kernel
def absorbing_interface(n1, k1, n2, k2, cos_i):
    """Return reflectance and refraction at an interface between two absorbing media.

    With complex indices m1, m2 and a homogeneous wave incident at a real angle, the normal
    component of the refracted wave vector is q = √(m2² − m1² sin²θ_i), Re q ≥ 0, and

        r_s = (m1 cosθ_i − q)/(m1 cosθ_i + q),
        r_p = (m2² m1 cosθ_i − m1² q)/(m2² m1 cosθ_i + m1² q).

    Parameters and returns are those of `interface`, with the index n1 + i k1 on the side of
    incidence.  In an absorbing medium incident and reflected waves interfere, so that |r|² alone
    can exceed 1 by O(k1/n1) near total reflection; as a probability it then is 1.
    """
    m1 = complex(n1, k1)
    m2 = complex(n2, k2)
    sin2 = max(0.0, 1.0 - cos_i * cos_i)
    q = np.sqrt(m2 * m2 - m1 * m1 * sin2)
    near = m1 * cos_i
    s = (near - q) / (near + q)
    p = (m2 * m2 * near - m1 * m1 * q) / (m2 * m2 * near + m1 * m1 * q)
    reflectance = 0.5 * (s.real**2 + s.imag**2 + p.real**2 + p.imag**2)
    scale = 1.0 / math.sqrt(n1 * n1 * sin2 + q.real * q.real)
    return min(reflectance, 1.0), n1 * scale, q.real * scale


@kernel
def between(n1, k1, n2, k2, cos_i):
    """Return what `interface` returns, for a side of incidence of index n1 + i k1.

    Equal indices on both sides are no interface at all.
    """
    if n1 == n2 and k1 == k2:
        return 0.0, 1.0, cos_i
    if k1 <= NEARLY_TRANSPARENT * n1:
        return interface(n1, n2, k2, cos_i)
    return absorbing_interface(n1, k1, n2, k2, cos_i)


@kernel
def refracted(dx, dy, dz, nx, ny, nz, cos_i, ratio, cos_t):
    """Return the refracted direction for incidence along d on the facet normal n (d·n < 0)."""
    k = ratio * cos_i - cos_t
    tx = ratio * dx + k * nx
    ty = ratio * dy + k * ny
    tz = ratio * dz + k * nz
    scale = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
    return tx * scale, ty * scale, tz * scale
