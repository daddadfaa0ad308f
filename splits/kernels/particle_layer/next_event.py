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

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.polarized_interface import ReflectionMueller, TransmissionMueller
from splits.kernels.particle_layer.peak_next_event import (
    StokesVector,
    connect_bottom,
    connect_scattering,
    sample_peak_order,
)

_I, _Q, _U, _V = range(4)
"""Columns of what detectors hear."""
ABOVE, BELOW = range(2)
"""Sides on which they hear it."""


class Detectors(NamedTuple):
    """Directions in which light is heard, and what it goes through to get there.

    Attributes
    ----------
    direction : float64[detectors, 3]
        Unit directions within the layer, upwards.
    plane : float64[detectors, 2]
        Horizontal unit vector that, with the normal, spans the plane that Q refers to.
    transmission : float64[detectors, 3]
        Of the face, a `TransmissionMueller`: transmittance times the ratio of solid angles
        inside and outside, over the outer cosine.
    reflection : float64[detectors, 4]
        Of the face, from inside, a `ReflectionMueller`.
    has_lower_side : bool
        Whether light is heard below, too.
    sums : float64[2, detectors, 4]
        I, Q, U, V heard `ABOVE` and `BELOW` (1/sr), Q along the plane of the normal; advanced in
        place.
    peak : PhaseFunctionPeak or None
        Of the phase function, None where it has none.
    peak_directions : float64[orders, 3]
        Room for `last_scattering.sample_directions`.
    """

    direction: np.ndarray
    plane: np.ndarray
    transmission: np.ndarray
    reflection: np.ndarray
    has_lower_side: bool
    sums: np.ndarray
    peak: Any
    peak_directions: np.ndarray


class Detector(NamedTuple):
    """One of the detectors, see `Detectors`; `layer_transmittance` is what the whole layer lets through."""

    direction: Vector
    plane: Vector
    transmission: TransmissionMueller
    reflection: ReflectionMueller
    layer_transmittance: float


@inline_only
def load_detector(detectors, layer, k):
    """Return the k-th detector."""
    x, y, z = detectors.direction[k]
    along, across = detectors.plane[k]
    plus, minus, root = detectors.transmission[k]
    passing = TransmissionMueller(plus, minus, root)
    plus, minus, real, imaginary = detectors.reflection[k]
    returning = ReflectionMueller(plus, minus, real, imaginary)
    through = math.exp(-layer.extinction * layer.depth / z)
    return Detector(Vector(x, y, z), Vector(along, across, 0.0), passing, returning, through)


@inline_only
def sum_interreflections(reflection, stokes, transmittance, odd, stokes_vector):
    """Return the `StokesVector` added up over 1, 3, … or over 2, 4, … reflections between two faces.

    Every reflection and the way through the layer after it multiply I + Q and I − Q by R_p t and
    R_s t, and U + iV by (a − ib) t, a + ib = r_p r_s* (`polarized_faces.fresnel_amplitudes`):
    geometric series.
    """
    i, q, u, v = stokes_vector
    if stokes is None:
        x = reflection.plus * transmittance
        return StokesVector(i * _sum_geometric_series(x, odd), 0.0, 0.0, 0.0)
    p = (
        0.5
        * (i + q)
        * _sum_geometric_series((reflection.plus + reflection.minus) * transmittance, odd)
    )
    s = (
        0.5
        * (i - q)
        * _sum_geometric_series((reflection.plus - reflection.minus) * transmittance, odd)
    )
    x, y = reflection.real * transmittance, -reflection.imaginary * transmittance
    # z/(1 − z²) or z²/(1 − z²) for z = x + iy.
    square_x, square_y = x * x - y * y, 2.0 * x * y
    top_x, top_y = (x, y) if odd else (square_x, square_y)
    below_x, below_y = 1.0 - square_x, -square_y
    per = 1.0 / (below_x * below_x + below_y * below_y)
    c = (top_x * below_x + top_y * below_y) * per
    d = (top_y * below_x - top_x * below_y) * per
    return StokesVector(p + s, p - s, c * u - d * v, c * v + d * u)


@inline_only
def _sum_geometric_series(x, odd):
    """Return the sum of all odd or of all even powers of x."""
    return (x if odd else x * x) / ((1.0 - x) * (1.0 + x))


@inline_only
def score_detector(sums, transmission, stokes, weight, stokes_vector):
    """Add light that arrives at a face from inside to what a detector behind it has heard."""
    i, q, u, v = stokes_vector
    if stokes is None:
        sums[_I] += weight * transmission.plus * i
        return
    sums[_I] += weight * (transmission.plus * i + transmission.minus * q)
    sums[_Q] += weight * (transmission.minus * i + transmission.plus * q)
    sums[_U] += weight * transmission.root * u
    sums[_V] += weight * transmission.root * v


@inline_only
def score_direct(detectors, layer, detector, k, stokes, weight, last_scattering):
    """Add light after its last scattering, and after 2, 4, … reflections between two faces.

    Parameters
    ----------
    detectors, layer
        See `score_scattering`.
    detector : Detector
        The k-th detector, on whose line the light is.
    k : int
    stokes : Stokes or None
        None where nobody asks for polarization.
    weight : float
    last_scattering : LastScattering
    """
    side = ABOVE if last_scattering.vertical_sign > 0.0 else BELOW
    if side == ABOVE or detectors.has_lower_side:
        arriving = weight * math.exp(
            -layer.extinction
            * _vertical_distance(layer, last_scattering, side)
            / detector.direction.z
        )
        sums = detectors.sums[side, k]
        score_detector(sums, detector.transmission, stokes, arriving, last_scattering.stokes_vector)
        if layer.bottom_albedo < 0.0 and detector.reflection.plus != 0.0:
            more = sum_interreflections(
                detector.reflection,
                stokes,
                detector.layer_transmittance,
                False,
                last_scattering.stokes_vector,
            )
            score_detector(sums, detector.transmission, stokes, arriving, more)


@inline_only
def score_reflected(detectors, layer, detector, k, stokes, weight, last_scattering):
    """Add light that leaves on the other side, after 1, 3, … reflections between two faces.

    Parameters are those of `score_direct`.
    """
    if layer.bottom_albedo < 0.0 and detector.reflection.plus != 0.0:
        side = BELOW if last_scattering.vertical_sign > 0.0 else ABOVE
        way = layer.depth - _vertical_distance(layer, last_scattering, side)
        arriving = weight * math.exp(-layer.extinction * way / detector.direction.z)
        more = sum_interreflections(
            detector.reflection,
            stokes,
            detector.layer_transmittance,
            True,
            last_scattering.stokes_vector,
        )
        score_detector(detectors.sums[side, k], detector.transmission, stokes, arriving, more)


@inline_only
def _vertical_distance(layer, last_scattering, side):
    """Return the height between the last scattering and the face of a side (m)."""
    return -last_scattering.height if side == ABOVE else layer.depth + last_scattering.height


@inline_only
def score_scattering(state, detectors, layer, phase, ray):
    """Let all detectors hear a scattering.

    Parameters
    ----------
    state : uint64[1]
        Draws scatterings into the peak of the phase function, if it has one.
    detectors : Detectors
    layer : ScatteringLayer
    phase : PhaseFunction
    ray : Ray
        Its place, direction and polarization before the scattering, and its weight after.
    """
    for k in range(detectors.direction.shape[0]):
        one = load_detector(detectors, layer, k)
        score_scattering_at_detector(state, detectors, layer, phase, 0, ray, one, k)
        order = sample_peak_order(state, detectors, layer)
        if order > 0:
            score_scattering_at_detector(state, detectors, layer, phase, order, ray, one, k)


@inline_only
def score_scattering_at_detector(state, detectors, layer, phase, peak_order, ray, detector, k):
    """Let a detector hear a scattering that so many scatterings into the peak follow."""
    weight, stokes, t, plane = ray.history.weight, ray.stokes, detector.direction, detector.plane
    up = connect_scattering(state, detectors, layer, phase, peak_order, ray, t, plane)
    score_direct(detectors, layer, detector, k, stokes, weight, up)
    if detectors.has_lower_side or (peak_order > 0 and detector.reflection.plus > 0.0):
        t = Vector(t.x, t.y, -t.z)
        down = connect_scattering(state, detectors, layer, phase, peak_order, ray, t, plane)
        score_direct(detectors, layer, detector, k, stokes, weight, down)
        score_reflected(detectors, layer, detector, k, stokes, weight, up)
        score_reflected(detectors, layer, detector, k, stokes, weight, down)


@inline_only
def score_bottom(state, detectors, layer, phase, stokes, weight):
    """Let all detectors above hear light of this weight that the diffuse bottom reflects."""
    for k in range(detectors.direction.shape[0]):
        one = load_detector(detectors, layer, k)
        t, plane = one.direction, one.plane
        share = weight * one.layer_transmittance * t.z / math.pi
        sums = detectors.sums[ABOVE, k]
        sums[_I] += share * one.transmission.plus
        sums[_Q] += share * one.transmission.minus
        order = sample_peak_order(state, detectors, layer)
        if order > 0:
            last = connect_bottom(state, detectors, layer, phase, order, stokes, t, plane)
            score_direct(detectors, layer, one, k, stokes, weight, last)
        if order > 0 and one.reflection.plus > 0.0:
            # Light that the upper face sends down may still be scattered upwards.
            t = Vector(t.x, t.y, -t.z)
            last = connect_bottom(state, detectors, layer, phase, order, stokes, t, plane)
            score_direct(detectors, layer, one, k, stokes, weight, last)
