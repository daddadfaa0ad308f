"""Local estimation: every scattering tells detectors what it sends them (Budak & Grimailo Eqs 4-5).

Detectors stand at infinity, in given directions above and below a layer with smooth faces.  A
scattering at depth sends towards each the density of its phase function (Eq 5), the bottom a cosine
over π (Eq 4), weakened on the way through the layer and at its face; refraction spreads a solid
angle.  Under two smooth faces light also arrives after any number of reflections between them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.jit import kernel
from splits.transport.phase import phase_density
from splits.transport.stokes import rotated_to, scattered_towards


class Detectors(NamedTuple):
    """Directions in which light is heard, and what it goes through to get there.

    Attributes
    ----------
    toward : float64[detectors, 3]
        Unit directions within the layer, upwards.
    plane : float64[detectors, 2]
        Horizontal unit vector that, with the normal, spans the plane that Q refers to.
    passing : float64[detectors, 3]
        Of the face, for its (T₊, T₋, √(T_s T_p)): transmittance times the ratio of solid angles
        inside and outside, over the outer cosine.
    returning : float64[detectors, 4]
        Of the face, from inside: (R₊, R₋, Re r_p r_s*, Im r_p r_s*).
    below : bool
        Whether light is heard below, too.
    sums : float64[2, detectors, 4]
        I, Q, U, V heard above and below (1/sr), Q along the plane of the normal; advanced in place.
    """

    toward: np.ndarray
    plane: np.ndarray
    passing: np.ndarray
    returning: np.ndarray
    below: bool
    sums: np.ndarray


@kernel
def sent(phase, dx, dy, dz, polar, tx, ty, tz, px, py):
    """Return I, Q, U, V that a particle sends towards t (1/sr), Q along the plane of p and z."""
    if polar is None:
        return phase_density(phase, dx * tx + dy * ty + dz * tz), 0.0, 0.0, 0.0
    density, q, u, v, e1, e2, e3 = scattered_towards(
        phase, dx, dy, dz, polar[0], polar[1], polar[2], polar[3], polar[4], polar[5], tx, ty, tz
    )
    q, u = rotated_to(q, u, e1, e2, e3, tx, ty, tz, px, py, 0.0)
    return density, density * q, density * u, density * v


@kernel
def round_trips(face, polar, through, odd, i, q, u, v):
    """Return I, Q, U, V added up over 1, 3, … or over 2, 4, … reflections between two faces.

    Every reflection and the way through the layer after it multiply I + Q and I − Q by R_p t and
    R_s t, and U + iV by (a − ib) t, a + ib = r_p r_s* (`stokes.fresnel_amplitudes`): geometric
    series.
    """
    if polar is None:
        x = face[0] * through
        return i * _series(x, odd), 0.0, 0.0, 0.0
    p = 0.5 * (i + q) * _series((face[0] + face[1]) * through, odd)
    s = 0.5 * (i - q) * _series((face[0] - face[1]) * through, odd)
    x, y = face[2] * through, -face[3] * through
    # z/(1 − z²) or z²/(1 − z²) for z = x + iy.
    square_x, square_y = x * x - y * y, 2.0 * x * y
    top_x, top_y = (x, y) if odd else (square_x, square_y)
    below_x, below_y = 1.0 - square_x, -square_y
    per = 1.0 / (below_x * below_x + below_y * below_y)
    c = (top_x * below_x + top_y * below_y) * per
    d = (top_y * below_x - top_x * below_y) * per
    return p + s, p - s, c * u - d * v, c * v + d * u


@kernel
def _series(x, odd):
    """Return the sum of all odd or of all even powers of x."""
    return (x if odd else x * x) / ((1.0 - x) * (1.0 + x))


@kernel
def put(sums, passing, polar, weight, i, q, u, v):
    """Add light that arrives at a face from inside to what a detector behind it has heard."""
    if polar is None:
        sums[0] += weight * passing[0] * i
        return
    sums[0] += weight * (passing[0] * i + passing[1] * q)
    sums[1] += weight * (passing[1] * i + passing[0] * q)
    sums[2] += weight * passing[2] * u
    sums[3] += weight * passing[2] * v


@kernel
def listen_particle(detectors, layer, phase, z, dx, dy, dz, weight, polar):
    """Let all detectors hear a scattering at height z of a ray of direction d.

    Parameters
    ----------
    detectors : Detectors
    layer : Turbid
    phase : Phase
    z, dx, dy, dz : float
        Height and direction before.
    weight : float
        After scattering.
    polar : float64[6] or None
        See `splits.transport.encounters.meet_face`.
    """
    for k in range(detectors.toward.shape[0]):
        tx, ty, tz = detectors.toward[k]
        px, py = detectors.plane[k]
        face = detectors.returning[k]
        through = math.exp(-layer.extinction * layer.depth / tz)
        for below in range(2 if detectors.below else 1):
            up = 1.0 if below == 0 else -1.0
            way = -z if below == 0 else layer.depth + z
            i, q, u, v = sent(phase, dx, dy, dz, polar, tx, ty, up * tz, px, py)
            sums, passing = detectors.sums[below, k], detectors.passing[k]
            put(sums, passing, polar, weight * math.exp(-layer.extinction * way / tz), i, q, u, v)
            if layer.bottom >= 0.0 or face[0] == 0.0:
                continue
            # Two smooth faces: light that first went towards this one, and light that went away.
            more = round_trips(face, polar, through, False, i, q, u, v)
            put(sums, passing, polar, weight * math.exp(-layer.extinction * way / tz), *more)
            i, q, u, v = sent(phase, dx, dy, dz, polar, tx, ty, -up * tz, px, py)
            more = round_trips(face, polar, through, True, i, q, u, v)
            way = layer.depth - way
            put(sums, passing, polar, weight * math.exp(-layer.extinction * way / tz), *more)


@kernel
def listen_bottom(detectors, layer, weight):
    """Let all detectors above hear light of this weight that the diffuse bottom reflects."""
    for k in range(detectors.toward.shape[0]):
        tz = detectors.toward[k, 2]
        share = weight * math.exp(-layer.extinction * layer.depth / tz) * tz / math.pi
        put_plain(detectors.sums[0, k], detectors.passing[k], share)


@kernel
def put_plain(sums, passing, weight):
    """Add unpolarized light."""
    sums[0] += weight * passing[0]
    sums[1] += weight * passing[1]
