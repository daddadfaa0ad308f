"""Fresnel reflection and Snell refraction of unpolarised light at a plane interface.

The light arrives through a medium of real refractive index n1 and meets a medium of complex
index n2 + i k2.  The far side may absorb, totally reflect, or both: one formula covers all of
it (Born & Wolf 1999, Principles of Optics, 7th ed., sections 1.5.2-1.5.4 and 14.2; SPLITS section
4.3.4).  Rays follow the planes of constant real phase, so the side of incidence, too, is taken by
its real index: total reflection then stays total and no surface outshines a black body, which
a complex tangential wave number would violate to first order in k1/n1.  Against the flux of an
inhomogeneous wave the neglect is below 1 % of diffuse light up to k1/n1 = 0.1, beyond which a
coating or a grain lets hardly any light arrive from inside.
"""

from __future__ import annotations

import math

from splits.transport.jit import kernel


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
def between(n1, k1, n2, k2, cos_i):
    """Return what `interface` returns; media of equal complex index have no interface at all."""
    if n1 == n2 and k1 == k2:
        return 0.0, 1.0, cos_i
    return interface(n1, n2, k2, cos_i)


@kernel
def refracted(dx, dy, dz, nx, ny, nz, cos_i, ratio, cos_t):
    """Return the refracted direction for incidence along d on the facet normal n (d·n < 0)."""
    k = ratio * cos_i - cos_t
    tx = ratio * dx + k * nx
    ty = ratio * dy + k * ny
    tz = ratio * dz + k * nz
    scale = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
    return tx * scale, ty * scale, tz * scale
