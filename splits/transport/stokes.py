"""Polarised light: Stokes vectors, and what scattering and smooth surfaces make of them.

Light that travels along d has a reference e, a unit vector perpendicular to d; f = d × e completes
the right-handed frame (e, f, d).  With the complex amplitudes of a field that goes as e^(−iωt),

    I = |E_e|² + |E_f|²    Q = |E_e|² − |E_f|²    U = 2 Re(E_e* E_f)    V = 2 Im(E_e* E_f).

Q > 0 is polarised along e; U > 0 at +45° from e towards f, anticlockwise for whom the light
reaches; V > 0 where the field at a fixed point turns from e towards f, anticlockwise again (the
traditional left-handed light, of positive helicity).  Kernels carry q, u, v = Q/I, U/I, V/I and no
weight: what Stokes vectors do to probabilities is in what is drawn.  Unpolarised light has
q = u = v = 0 and any reference, such as `any_reference`.

The plane of scattering or incidence becomes the reference: e' lies in it, so that q' > 0 is
parallel to the plane and q' < 0 perpendicular; the frames of all beams share f' on its normal.
"""

from __future__ import annotations

import math

from splits.transport.frames import dot, mirrored, normalized, orthonormal_basis
from splits.transport.fresnel import normal_component, refracted
from splits.transport.jit import TINY, kernel
from splits.transport.phase import phase_density, polarizing_ratios, scattering_cosine
from splits.transport.rng import uniform, unit_circle


@kernel
def _cross(x1, x2, x3, y1, y2, y3):
    """Return x × y."""
    return x2 * y3 - x3 * y2, x3 * y1 - x1 * y3, x1 * y2 - x2 * y1


@kernel
def any_reference(dx, dy, dz):
    """Return a unit vector perpendicular to the direction d, for unpolarised light."""
    ex, ey, ez, _, _, _ = orthonormal_basis(dx, dy, dz)
    return ex, ey, ez


@kernel
def _turned(q, u, c, s):
    """Return q and u for a reference along c e + s f, of any length but zero."""
    per = 1.0 / (c * c + s * s)
    cos2 = (c - s) * (c + s) * per
    sin2 = 2.0 * c * s * per
    return q * cos2 + u * sin2, u * cos2 - q * sin2


@kernel
def rotated_to(q, u, ex, ey, ez, dx, dy, dz, tx, ty, tz):
    """Return q and u when the reference changes from e to t.

    Q' = Q cos2ψ + U sin2ψ and U' = −Q sin2ψ + U cos2ψ with cosψ = e·t and sinψ = (e × t)·d.

    Parameters
    ----------
    e, d : 3 float each
        Reference and direction of travel.
    t : 3 float
        New reference; what counts is its part perpendicular to d, whatever its length.
    """
    nx, ny, nz = _cross(ex, ey, ez, tx, ty, tz)
    return _turned(q, u, dot(ex, ey, ez, tx, ty, tz), dot(nx, ny, nz, dx, dy, dz))


@kernel
def _normalised(i, q, u, v):
    """Return Q/I, U/I and V/I; rounding of faint light never polarises it beyond completely."""
    per = 1.0 / max(max(i, math.sqrt(q * q + u * u + v * v)), TINY)
    return q * per, u * per, v * per


@kernel
def _direction_in_plane(c, s, dx, dy, dz, ex, ey, ez):
    """Return t = c e + s f."""
    fx, fy, fz = _cross(dx, dy, dz, ex, ey, ez)
    return c * ex + s * fx, c * ey + s * fy, c * ez + s * fz


@kernel
def _reference_behind(mu, sine, tx, ty, tz, dx, dy, dz, ax, ay, az):
    """Return t turned along with d into the new direction a = µ d + sinΘ t, at right angles to it.

    References are made from references: without the projection errors would grow from one
    scattering to the next.
    """
    ex, ey, ez = mu * tx - sine * dx, mu * ty - sine * dy, mu * tz - sine * dz
    k = dot(ex, ey, ez, ax, ay, az)
    return normalized(ex - k * ax, ey - k * ay, ez - k * az)


@kernel
def scatter_polarized(state, phase, dx, dy, dz, ex, ey, ez, q, u, v):
    """Scatter light into a direction drawn from the density of `scattered_towards`.

    The cosine comes from the phase function, to which the density integrates over azimuths φ from
    e towards f; the azimuth from 1 + (m12/m11)(q cos2φ + u sin2φ) by rejection, which keeps at
    least half of the draws.

    Parameters
    ----------
    phase : Phase
    d, e : 3 float each
        Direction of travel and reference.
    q, u, v : float

    Returns
    -------
    d, e : 3 float each
        e is in the plane of scattering.
    q, u, v : float
    """
    mu = scattering_cosine(state, phase)
    ratio, along = polarizing_ratios(phase, mu)
    highest = 1.0 + abs(ratio) * math.sqrt(q * q + u * u)
    while True:
        c, s = unit_circle(state)
        qs, us = _turned(q, u, c, s)
        if uniform(state) * highest <= 1.0 + ratio * qs:
            break
    sine = math.sqrt((1.0 - mu) * (1.0 + mu))
    tx, ty, tz = _direction_in_plane(c, s, dx, dy, dz, ex, ey, ez)
    ax, ay, az = normalized(mu * dx + sine * tx, mu * dy + sine * ty, mu * dz + sine * tz)
    ex, ey, ez = _reference_behind(mu, sine, tx, ty, tz, dx, dy, dz, ax, ay, az)
    qs, us, vs = _normalised(1.0 + ratio * qs, ratio + qs, along * us, along * v)
    return ax, ay, az, ex, ey, ez, qs, us, vs


@kernel
def scattered_towards(phase, dx, dy, dz, ex, ey, ez, q, u, v, tx, ty, tz):
    """Return how much light is scattered towards a given direction, and how polarised it is.

    Parameters
    ----------
    phase, d, e, q, u, v
        See `scatter_polarized`.
    t : 3 float
        Unit vector; along ±d, where every plane is one of scattering, that of e is taken.

    Returns
    -------
    density : float
        Per steradian, of integral 1: phase function times 1 + (m12/m11) q in the plane.
    q, u, v : float
        Of the light scattered; 0 where there is none.
    e : 3 float
        Its reference, in the plane of scattering.
    """
    fx, fy, fz = _cross(dx, dy, dz, ex, ey, ez)
    # c and s keep t in the plane of d even where rounding decides which plane that is.
    c = dot(tx, ty, tz, ex, ey, ez)
    s = dot(tx, ty, tz, fx, fy, fz)
    square = c * c + s * s
    sine = 0.0
    if square > TINY:
        sine = math.sqrt(square)
        c /= sine
        s /= sine
    else:
        c, s = 1.0, 0.0
    mu = min(max(dot(dx, dy, dz, tx, ty, tz), -1.0), 1.0)
    ratio, along = polarizing_ratios(phase, mu)
    qs, us = _turned(q, u, c, s)
    part = max(1.0 + ratio * qs, 0.0)
    density = phase_density(phase, mu) * part
    px, py, pz = _direction_in_plane(c, s, dx, dy, dz, ex, ey, ez)
    ex, ey, ez = _reference_behind(mu, sine, px, py, pz, dx, dy, dz, tx, ty, tz)
    qs, us, vs = _normalised(part, ratio + qs, along * us, along * v)
    return density, qs, us, vs, ex, ey, ez


@kernel
def fresnel_amplitudes(n1, n2, cos_i):
    """Return the Mueller matrices of an interface between media of real refractive index.

    Born & Wolf 1999, section 1.5, with the plane of incidence as reference of all three beams.
    Reflection takes (I, Q, U, V) to

        R₊ I + R₋ Q,  R₋ I + R₊ Q,  a U + b V,  a V − b U,   a + ib = r_p r_s*,

    and refraction, in energy that crosses the surface, to T₊ I + T₋ Q, T₋ I + T₊ Q, T U, T V with
    T = √(T_s T_p).  Plus and minus stand for (R_p ± R_s)/2; r_p = −r_s at normal incidence, where
    the reference turns back with the light.  In units of n₁, with w = (n₂/n₁) cosθ_t, i√ beyond the
    critical angle, and c and σ for cosine and sine of the angle of incidence,

        r_s = (c − w)/(c + w) = (1 − n²)/(c + w)²,   r_p = r_s h,   h = (σ² − wc)/(σ² + wc),

    where n = n₂/n₁; at total reflection r_p r_s* = h = e^(−iδ), tan(δ/2) = c √(σ² − n²)/σ² (their
    section 1.5.4).  R₋, T₊ and T₋ are multiplied out: nothing cancels next to normal incidence, at
    grazing incidence or between nearly equal media.

    Parameters
    ----------
    n1, n2 : float
        On the side of incidence and beyond.
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].

    Returns
    -------
    r_plus, r_minus, r_real, r_imaginary : float
        R₊ = `fresnel.interface`'s reflectance, R₋ ≤ 0, a and b.
    t_plus, t_minus, t_root : float
        T₊ = 1 − R₊, T₋ = −R₋ and T.
    ratio, cos_t : float
        As from `fresnel.interface`.
    """
    m = n2 / n1
    if m == 1.0:
        return 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, cos_i
    g = (n2 - n1) / n1
    sin2 = (1.0 - cos_i) * (1.0 + cos_i)
    a, b2 = normal_component(m, g, 0.0, cos_i, False)
    if a == 0.0:
        wc = math.sqrt(b2) * cos_i
        per = 1.0 / (sin2 * sin2 + wc * wc)
        real = (sin2 - wc) * (sin2 + wc) * per
        return 1.0, 0.0, real, -2.0 * sin2 * wc * per, 0.0, 0.0, 0.0, 0.0, 0.0
    wc = a * cos_i
    per_s = 1.0 / (cos_i + a)
    per_p = 1.0 / (sin2 + wc)
    root_s = g * (m + 1.0) * per_s * per_s
    rs = root_s * root_s
    h = (sin2 - wc) * per_p
    r_minus = -2.0 * rs * (sin2 * per_p) * (wc * per_p)
    ts = 4.0 * wc * per_s * per_s
    t = m * per_p
    ratio = 1.0 / math.sqrt(a * a + sin2)
    return (
        min(0.5 * rs * (1.0 + h * h), 1.0), r_minus, rs * h, 0.0,
        0.5 * ts * (1.0 + t * t), -r_minus, ts * t, ratio, a * ratio,
    )  # fmt: skip


@kernel
def _incidence(dx, dy, dz, ex, ey, ez, q, u, nx, ny, nz):
    """Return cosine of incidence, normal of the plane of incidence, and q and u referred to it.

    At normal incidence it is the plane of e.
    """
    fx, fy, fz = _cross(dx, dy, dz, ex, ey, ez)
    c = dot(nx, ny, nz, ex, ey, ez)
    s = dot(nx, ny, nz, fx, fy, fz)
    square = c * c + s * s
    if square > TINY:
        scale = 1.0 / math.sqrt(square)
        c *= scale
        s *= scale
    else:
        c, s = 1.0, 0.0
    q, u = _turned(q, u, c, s)
    cos_i = min(max(-dot(dx, dy, dz, nx, ny, nz), 0.0), 1.0)
    return cos_i, c * fx - s * ex, c * fy - s * ey, c * fz - s * ez, q, u


@kernel
def _reflected(dx, dy, dz, nx, ny, nz, sx, sy, sz, q, u, v, plus, minus, real, imaginary):
    """Return direction, reference and q, u, v of reflected light."""
    dx, dy, dz = mirrored(dx, dy, dz, nx, ny, nz)
    dx, dy, dz = normalized(dx, dy, dz)
    ex, ey, ez = _cross(sx, sy, sz, dx, dy, dz)
    ex, ey, ez = normalized(ex, ey, ez)
    q, u, v = _normalised(
        plus + minus * q, minus + plus * q, real * u + imaginary * v, real * v - imaginary * u
    )
    return dx, dy, dz, ex, ey, ez, q, u, v


@kernel
def _refracted(
    dx, dy, dz, nx, ny, nz, sx, sy, sz, q, u, v, plus, minus, root, cos_i, ratio, cos_t
):  # fmt: skip
    """Return direction, reference and q, u, v of refracted light."""
    dx, dy, dz = refracted(dx, dy, dz, nx, ny, nz, cos_i, ratio, cos_t)
    ex, ey, ez = _cross(sx, sy, sz, dx, dy, dz)
    ex, ey, ez = normalized(ex, ey, ez)
    q, u, v = _normalised(plus + minus * q, minus + plus * q, root * u, root * v)
    return dx, dy, dz, ex, ey, ez, q, u, v


@kernel
def reflected_polarized(dx, dy, dz, ex, ey, ez, q, u, v, nx, ny, nz, n1, n2):
    """Return the share of light that a smooth interface reflects, and what it becomes.

    Parameters
    ----------
    d, e : 3 float each
        Direction of travel and reference.
    q, u, v : float
    n : 3 float
        Normal of the interface against the light, d·n ≤ 0.
    n1, n2 : float
        Real refractive indices on the side of incidence and beyond.

    Returns
    -------
    share : float
    d, e : 3 float each
        e is in the plane of incidence.
    q, u, v : float
    """
    cos_i, sx, sy, sz, q, u = _incidence(dx, dy, dz, ex, ey, ez, q, u, nx, ny, nz)
    plus, minus, real, imaginary, _, _, _, _, _ = fresnel_amplitudes(n1, n2, cos_i)
    dx, dy, dz, ex, ey, ez, qr, ur, vr = _reflected(
        dx, dy, dz, nx, ny, nz, sx, sy, sz, q, u, v, plus, minus, real, imaginary
    )
    return plus + minus * q, dx, dy, dz, ex, ey, ez, qr, ur, vr


@kernel
def reflect_or_refract_polarized(state, dx, dy, dz, ex, ey, ez, q, u, v, nx, ny, nz, n1, n2):
    """Reflect light at a smooth interface with the probability R₊ + R₋ q, or refract it.

    Parameters are those of `reflected_polarized`.

    Returns
    -------
    passed : bool
    d, e : 3 float each
        e is in the plane of incidence.
    q, u, v : float
    """
    cos_i, sx, sy, sz, q, u = _incidence(dx, dy, dz, ex, ey, ez, q, u, nx, ny, nz)
    plus, minus, real, imaginary, t_plus, t_minus, root, ratio, cos_t = fresnel_amplitudes(
        n1, n2, cos_i
    )
    passed = uniform(state) >= plus + minus * q
    if passed:
        dx, dy, dz, ex, ey, ez, q, u, v = _refracted(
            dx, dy, dz, nx, ny, nz, sx, sy, sz, q, u, v,
            t_plus, t_minus, root, cos_i, ratio, cos_t,
        )  # fmt: skip
    else:
        dx, dy, dz, ex, ey, ez, q, u, v = _reflected(
            dx, dy, dz, nx, ny, nz, sx, sy, sz, q, u, v, plus, minus, real, imaginary
        )
    return passed, dx, dy, dz, ex, ey, ez, q, u, v
