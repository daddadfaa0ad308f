"""Local estimation: every scattering tells detectors what it sends them (Budak & Grimailo Eqs 4-5).

Detectors stand at infinity, in given directions above and below a layer with smooth faces.  A
scattering at depth sends towards each the density of its phase function (Eq 5), the bottom a cosine
over π (Eq 4), weakened on the way through the layer and at its face; refraction spreads a solid
angle.  Under two smooth faces light also arrives after any number of reflections between them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from splits.transport.compiling.jit import part
from splits.transport.numerics.vectors import Vector
from splits.transport.optics.polarized_faces import Reflection, Transmission
from splits.transport.particles.last_scattering import (
    Sound,
    connect_bottom,
    connect_particle,
    sample_order,
)

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
    peak : Peak or None
        Of the phase function, None where it has none.
    directions : float64[orders, 3]
        Room for `last_scattering.sample_directions`.
    """

    toward: np.ndarray
    plane: np.ndarray
    passing: np.ndarray
    returning: np.ndarray
    below: bool
    sums: np.ndarray
    peak: Any
    directions: np.ndarray


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
def score_direct(detectors, layer, one, k, stokes, weight, last):
    """Add light after its last scattering, and after 2, 4, … reflections between two faces.

    Parameters
    ----------
    detectors, layer
        See `listen_particle`.
    one : Listener
        The k-th detector, on whose line the light is.
    k : int
    stokes : Stokes or None
        None where nobody asks for polarization.
    weight : float
    last : LastScattering
    """
    side = ABOVE if last.up > 0.0 else BELOW
    if side == ABOVE or detectors.below:
        arriving = weight * math.exp(-layer.extinction * _way(layer, last, side) / one.toward.z)
        sums = detectors.sums[side, k]
        put(sums, one.passing, stokes, arriving, last.sound)
        if layer.bottom < 0.0 and one.returning.plus != 0.0:
            more = round_trips(one.returning, stokes, one.through, False, last.sound)
            put(sums, one.passing, stokes, arriving, more)


@part
def score_reflected(detectors, layer, one, k, stokes, weight, last):
    """Add light that leaves on the other side, after 1, 3, … reflections between two faces.

    Parameters are those of `score_direct`.
    """
    if layer.bottom < 0.0 and one.returning.plus != 0.0:
        side = BELOW if last.up > 0.0 else ABOVE
        way = layer.depth - _way(layer, last, side)
        arriving = weight * math.exp(-layer.extinction * way / one.toward.z)
        more = round_trips(one.returning, stokes, one.through, True, last.sound)
        put(detectors.sums[side, k], one.passing, stokes, arriving, more)


@part
def _way(layer, last, side):
    """Return the height between the last scattering and the face of a side (m)."""
    return -last.z if side == ABOVE else layer.depth + last.z


@part
def listen_particle(state, detectors, layer, phase, ray):
    """Let all detectors hear a scattering.

    Parameters
    ----------
    state : uint64[1]
        Draws scatterings into the peak of the phase function, if it has one.
    detectors : Detectors
    layer : Turbid
    phase : Phase
    ray : Ray
        Its place, direction and polarization before the scattering, and its weight after.
    """
    for k in range(detectors.toward.shape[0]):
        one = listener(detectors, layer, k)
        score_particle(state, detectors, layer, phase, 0, ray, one, k)
        order = sample_order(state, detectors, layer)
        if order > 0:
            score_particle(state, detectors, layer, phase, order, ray, one, k)


@part
def score_particle(state, detectors, layer, phase, order, ray, one, k):
    """Let a detector hear a scattering that so many scatterings into the peak follow."""
    weight, stokes, t, plane = ray.past.weight, ray.stokes, one.toward, one.plane
    up = connect_particle(state, detectors, layer, phase, order, ray, t, plane)
    score_direct(detectors, layer, one, k, stokes, weight, up)
    if detectors.below or (order > 0 and one.returning.plus > 0.0):
        t = Vector(t.x, t.y, -t.z)
        down = connect_particle(state, detectors, layer, phase, order, ray, t, plane)
        score_direct(detectors, layer, one, k, stokes, weight, down)
        score_reflected(detectors, layer, one, k, stokes, weight, up)
        score_reflected(detectors, layer, one, k, stokes, weight, down)


@part
def listen_bottom(state, detectors, layer, phase, stokes, weight):
    """Let all detectors above hear light of this weight that the diffuse bottom reflects."""
    for k in range(detectors.toward.shape[0]):
        one = listener(detectors, layer, k)
        t, plane = one.toward, one.plane
        share = weight * one.through * t.z / math.pi
        sums = detectors.sums[ABOVE, k]
        sums[_I] += share * one.passing.plus
        sums[_Q] += share * one.passing.minus
        order = sample_order(state, detectors, layer)
        if order > 0:
            last = connect_bottom(state, detectors, layer, phase, order, stokes, t, plane)
            score_direct(detectors, layer, one, k, stokes, weight, last)
        if order > 0 and one.returning.plus > 0.0:
            # Light that the upper face sends down may still be scattered upwards.
            t = Vector(t.x, t.y, -t.z)
            last = connect_bottom(state, detectors, layer, phase, order, stokes, t, plane)
            score_direct(detectors, layer, one, k, stokes, weight, last)
