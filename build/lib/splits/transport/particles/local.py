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

from splits.transport.compiling.jit import part
from splits.transport.numerics.vectors import Vector, dot
from splits.transport.optics.phase import phase_density
from splits.transport.optics.polarized_faces import Reflection, Transmission
from splits.transport.optics.stokes import rotated_to, scattered_towards

_I, _Q, _U, _V = range(4)
"""Columns of what detectors hear."""
ABOVE, BELOW = range(2)
"""Sides on which they hear it."""


class Detectors(NamedTuple):
    """Directions in which light is heard, and what it goes through to get there.

    Attributes
    ----------
    toward : float64[detectors, 3]
        Unit directions within the layer, upwards.
    plane : float64[detectors, 2]
        Horizontal unit vector that, with the normal, spans the plane that Q refers to.
    passing : float64[detectors, 3]
        Of the face, a `Transmission`: transmittance times the ratio of solid angles
        inside and outside, over the outer cosine.
    returning : float64[detectors, 4]
        Of the face, from inside, a `Reflection`.
    below : bool
        Whether light is heard below, too.
    sums : float64[2, detectors, 4]
        I, Q, U, V heard `ABOVE` and `BELOW` (1/sr), Q along the plane of the normal; advanced in
        place.
    """

    toward: np.ndarray
    plane: np.ndarray
    passing: np.ndarray
    returning: np.ndarray
    below: bool
    sums: np.ndarray


class Sound(NamedTuple):
    """I, Q, U, V of light that is heard."""

    i: float
    q: float
    u: float
    v: float


class Listener(NamedTuple):
    """One of the detectors, see `Detectors`; `through` is what the whole layer lets through."""

    toward: Vector
    plane: Vector
    passing: Transmission
    returning: Reflection
    through: float


@part
def listener(detectors, layer, k):
    """Return the k-th detector."""
    x, y, z = detectors.toward[k]
    along, across = detectors.plane[k]
    plus, minus, root = detectors.passing[k]
    passing = Transmission(plus, minus, root)
    plus, minus, real, imaginary = detectors.returning[k]
    returning = Reflection(plus, minus, real, imaginary)
    through = math.exp(-layer.extinction * layer.depth / z)
    return Listener(Vector(x, y, z), Vector(along, across, 0.0), passing, returning, through)


@part
def sent(phase, d, stokes, t, plane):
    """Return the `Sound` that a particle sends towards t (1/sr), Q along the plane of p and z."""
    if stokes is None:
        return Sound(phase_density(phase, dot(d, t)), 0.0, 0.0, 0.0)
    light = scattered_towards(phase, d, stokes, t)
    seen = rotated_to(light.stokes, t, plane)
    density = light.density
    return Sound(density, density * seen.q, density * seen.u, density * light.stokes.v)


@part
def round_trips(face, stokes, through, odd, sound):
    """Return the `Sound` added up over 1, 3, … or over 2, 4, … reflections between two faces.

    Every reflection and the way through the layer after it multiply I + Q and I − Q by R_p t and
    R_s t, and U + iV by (a − ib) t, a + ib = r_p r_s* (`polarized_faces.fresnel_amplitudes`):
    geometric series.
    """
    i, q, u, v = sound
    if stokes is None:
        x = face.plus * through
        return Sound(i * _series(x, odd), 0.0, 0.0, 0.0)
    p = 0.5 * (i + q) * _series((face.plus + face.minus) * through, odd)
    s = 0.5 * (i - q) * _series((face.plus - face.minus) * through, odd)
    x, y = face.real * through, -face.imaginary * through
    # z/(1 − z²) or z²/(1 − z²) for z = x + iy.
    square_x, square_y = x * x - y * y, 2.0 * x * y
    top_x, top_y = (x, y) if odd else (square_x, square_y)
    below_x, below_y = 1.0 - square_x, -square_y
    per = 1.0 / (below_x * below_x + below_y * below_y)
    c = (top_x * below_x + top_y * below_y) * per
    d = (top_y * below_x - top_x * below_y) * per
    return Sound(p + s, p - s, c * u - d * v, c * v + d * u)


@part
def _series(x, odd):
    """Return the sum of all odd or of all even powers of x."""
    return (x if odd else x * x) / ((1.0 - x) * (1.0 + x))


@part
def put(sums, passing, stokes, weight, sound):
    """Add light that arrives at a face from inside to what a detector behind it has heard."""
    i, q, u, v = sound
    if stokes is None:
        sums[_I] += weight * passing.plus * i
        return
    sums[_I] += weight * (passing.plus * i + passing.minus * q)
    sums[_Q] += weight * (passing.minus * i + passing.plus * q)
    sums[_U] += weight * passing.root * u
    sums[_V] += weight * passing.root * v


@part
def listen_particle(detectors, layer, phase, ray):
    """Let all detectors hear a scattering.

    Parameters
    ----------
    detectors : Detectors
    layer : Turbid
    phase : Phase
    ray : Ray
        Its place, direction and polarization before the scattering, and its weight after.
    """
    weight, place, stokes = ray.past.weight, ray.place, ray.stokes
    for k in range(detectors.toward.shape[0]):
        one = listener(detectors, layer, k)
        t, plane, face = one.toward, one.plane, one.returning
        for side in range(2 if detectors.below else 1):
            up = 1.0 if side == ABOVE else -1.0
            way = -place.z if side == ABOVE else layer.depth + place.z
            arriving = weight * math.exp(-layer.extinction * way / t.z)
            sums = detectors.sums[side, k]
            sound = sent(phase, ray.d, stokes, Vector(t.x, t.y, up * t.z), plane)
            put(sums, one.passing, stokes, arriving, sound)
            if layer.bottom >= 0.0 or face.plus == 0.0:
                continue
            # Two smooth faces: light that first went towards this one, and light that went away.
            more = round_trips(face, stokes, one.through, False, sound)
            put(sums, one.passing, stokes, arriving, more)
            sound = sent(phase, ray.d, stokes, Vector(t.x, t.y, -up * t.z), plane)
            more = round_trips(face, stokes, one.through, True, sound)
            way = layer.depth - way
            arriving = weight * math.exp(-layer.extinction * way / t.z)
            put(sums, one.passing, stokes, arriving, more)


@part
def listen_bottom(detectors, layer, weight):
    """Let all detectors above hear light of this weight that the diffuse bottom reflects."""
    for k in range(detectors.toward.shape[0]):
        one = listener(detectors, layer, k)
        share = weight * one.through * one.toward.z / math.pi
        sums = detectors.sums[ABOVE, k]
        sums[_I] += share * one.passing.plus
        sums[_Q] += share * one.passing.minus
