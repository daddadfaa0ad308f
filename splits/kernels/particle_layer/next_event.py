"""Next-event (local) estimation: every scattering contributes to the detectors.

The method is that of Budak & Grimailo 2020, Eqs 4-5.  Detectors are at infinity, in given
directions above and below a layer with smooth boundaries.  A scattering at depth contributes the
density of its phase function towards each detector (Eq 5), and a reflection at the bottom a cosine
over π (Eq 4), attenuated by the layer and transmitted through its boundary, where refraction
changes the solid angle.  Between two smooth boundaries, light after any number of reflections
contributes, too.
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
"""Columns of the Stokes parameters of detectors."""
ABOVE, BELOW = range(2)
"""Sides of the layer with detectors."""


class Detectors(NamedTuple):
    """Directions of detectors, with the transmission and reflection of the boundary on the way.

    Attributes
    ----------
    direction : float64[detectors, 3]
        Unit directions within the layer, upwards.
    plane : float64[detectors, 2]
        Horizontal unit vector that, with the normal, spans the reference plane of Q.
    transmission : float64[detectors, 3]
        `TransmissionMueller` of the boundary: transmittance times the ratio of solid angles inside
        and outside, divided by the outer cosine.
    reflection : float64[detectors, 4]
        `ReflectionMueller` of the boundary, from inside.
    has_lower_side : bool
        Whether there are detectors below the layer, too.
    sums : float64[2, detectors, 4]
        Scores of I, Q, U, V `ABOVE` and `BELOW` (1/sr), Q along the plane of the normal; advanced
        in place.
    peak : PhaseFunctionPeak or None
        Peak of the phase function, None if it has none.
    peak_directions : float64[orders, 3]
        Buffer of `peak_next_event.sample_peak_directions`.
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
    """One of the detectors, see `Detectors`.

    `layer_transmittance` is the direct transmittance of the whole layer in its direction.
    """

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
    transmission = TransmissionMueller(plus, minus, root)
    plus, minus, real, imaginary = detectors.reflection[k]
    reflection = ReflectionMueller(plus, minus, real, imaginary)
    transmittance = math.exp(-layer.extinction * layer.depth / z)
    return Detector(
        Vector(x, y, z), Vector(along, across, 0.0), transmission, reflection, transmittance
    )


@inline_only
def sum_interreflections(reflection, stokes, transmittance, odd, stokes_vector):
    """Return the `StokesVector` summed over 1, 3, … or over 2, 4, … internal reflections.

    Every reflection and the following passage through the layer multiply I + Q and I − Q by R_p t
    and R_s t, and U + iV by (a − ib) t, a + ib = r_p r_s*
    (`polarized_interface.compute_fresnel_mueller`), which gives geometric series.
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
    numerator_x, numerator_y = (x, y) if odd else (square_x, square_y)
    denominator_x, denominator_y = 1.0 - square_x, -square_y
    per = 1.0 / (denominator_x * denominator_x + denominator_y * denominator_y)
    c = (numerator_x * denominator_x + numerator_y * denominator_y) * per
    d = (numerator_y * denominator_x - numerator_x * denominator_y) * per
    return StokesVector(p + s, p - s, c * u - d * v, c * v + d * u)


@inline_only
def _sum_geometric_series(x, odd):
    """Return the sum of all odd or of all even powers of x."""
    return (x if odd else x * x) / ((1.0 - x) * (1.0 + x))


@inline_only
def score_detector(sums, transmission, stokes, weight, stokes_vector):
    """Score light that arrives at the boundary from inside at a detector outside."""
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
    """Score light from its last scattering, and after 2, 4, … internal reflections.

    Parameters
    ----------
    detectors, layer
        See `score_scattering`.
    detector : Detector
        The k-th detector, in whose direction the light travels.
    k : int
    stokes : Stokes or None
        None without polarization.
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
            reflected = sum_interreflections(
                detector.reflection,
                stokes,
                detector.layer_transmittance,
                False,
                last_scattering.stokes_vector,
            )
            score_detector(sums, detector.transmission, stokes, arriving, reflected)


@inline_only
def score_reflected(detectors, layer, detector, k, stokes, weight, last_scattering):
    """Score light that leaves on the other side, after 1, 3, … internal reflections.

    Parameters are those of `score_direct`.
    """
    if layer.bottom_albedo < 0.0 and detector.reflection.plus != 0.0:
        side = BELOW if last_scattering.vertical_sign > 0.0 else ABOVE
        distance = layer.depth - _vertical_distance(layer, last_scattering, side)
        arriving = weight * math.exp(-layer.extinction * distance / detector.direction.z)
        reflected = sum_interreflections(
            detector.reflection,
            stokes,
            detector.layer_transmittance,
            True,
            last_scattering.stokes_vector,
        )
        score_detector(detectors.sums[side, k], detector.transmission, stokes, arriving, reflected)


@inline_only
def _vertical_distance(layer, last_scattering, side):
    """Return the vertical distance of the last scattering from the boundary of a side (m)."""
    return -last_scattering.height if side == ABOVE else layer.depth + last_scattering.height


@inline_only
def score_scattering(state, detectors, layer, phase, ray):
    """Score a scattering at all detectors.

    Parameters
    ----------
    state : uint64[1]
        Random stream, used for scatterings into the peak of the phase function.
    detectors : Detectors
    layer : ScatteringLayer
    phase : PhaseFunction
    ray : LayerRay
        Position, direction and polarization before the scattering, and the weight after it.
    """
    for k in range(detectors.direction.shape[0]):
        detector = load_detector(detectors, layer, k)
        score_scattering_at_detector(state, detectors, layer, phase, 0, ray, detector, k)
        order = sample_peak_order(state, detectors, layer)
        if order > 0:
            score_scattering_at_detector(state, detectors, layer, phase, order, ray, detector, k)


@inline_only
def score_scattering_at_detector(state, detectors, layer, phase, peak_order, ray, detector, k):
    """Score a scattering that is followed by `peak_order` scatterings into the peak."""
    weight, stokes, t, plane = ray.weight, ray.stokes, detector.direction, detector.plane
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
    """Score light that the diffuse bottom reflects at all detectors above."""
    for k in range(detectors.direction.shape[0]):
        detector = load_detector(detectors, layer, k)
        t, plane = detector.direction, detector.plane
        weight_at_boundary = weight * detector.layer_transmittance * t.z / math.pi
        sums = detectors.sums[ABOVE, k]
        sums[_I] += weight_at_boundary * detector.transmission.plus
        sums[_Q] += weight_at_boundary * detector.transmission.minus
        order = sample_peak_order(state, detectors, layer)
        if order > 0:
            last = connect_bottom(state, detectors, layer, phase, order, stokes, t, plane)
            score_direct(detectors, layer, detector, k, stokes, weight, last)
        if order > 0 and detector.reflection.plus > 0.0:
            # Light that the upper boundary reflects down may still be scattered upwards.
            t = Vector(t.x, t.y, -t.z)
            last = connect_bottom(state, detectors, layer, phase, order, stokes, t, plane)
            score_direct(detectors, layer, detector, k, stokes, weight, last)
