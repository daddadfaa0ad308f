"""Next-event (local) estimation: every scattering contributes to the detectors.

The method is that of Budak & Grimailo 2020, Eqs 4-5.  Detectors are at infinity, in given
directions above and below layers of particles in one matrix, with smooth boundaries.  A scattering
at depth contributes the density of its phase function towards each detector (Eq 5), and a
reflection at the bottom a cosine over π (Eq 4), attenuated on the way and transmitted through the
boundary, where refraction changes the solid angle.  Between two smooth boundaries, light after any
number of reflections contributes, too.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from splits.kernels.base.ray import compute_position
from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.phase_function import PhaseFunction
from splits.kernels.optics.polarized_interface import ReflectionMueller, TransmissionMueller
from splits.kernels.transport.peak_next_event import (
    ScatteringEvent,
    StokesVector,
    connect_bottom,
    connect_scattering,
    sample_peak_order,
)

_I, _Q, _U, _V = range(4)
"""Columns of the Stokes parameters of detectors."""
ABOVE, BELOW = range(2)
"""Sides of the sample with detectors."""


class Detectors(NamedTuple):
    """Directions of detectors, with the transmission and reflection of the boundary on the way.

    Attributes
    ----------
    direction : float64[detectors, 3]
        Unit directions within the matrix, upwards.
    plane : float64[detectors, 2]
        Horizontal unit vector that, with the normal, spans the reference plane of Q.
    transmission : float64[detectors, 3]
        `TransmissionMueller` of the boundary: transmittance times the ratio of solid angles inside
        and outside, divided by the outer cosine.
    reflection : float64[detectors, 4]
        `ReflectionMueller` of the boundary, from inside.
    transmittance : float64[detectors]
        Direct transmittance of all layers in the direction of the detector.
    refractive_index : float
        Refractive index of the matrix, with 1 outside.
    optical_thickness : float
        Vertical optical thickness of all layers; may be infinite.
    has_lower_side : bool
        Whether there are detectors below the sample, too: its lower boundary is open.
    sums : float64[2, detectors, 4]
        Scores of I, Q, U, V `ABOVE` and `BELOW` (1/sr), Q along the plane of the normal; advanced
        in place.
    phase : PhaseFunction
        Phase function of the lowest layer.
    peak : PhaseFunctionPeak or None
        Peak of the phase function, None if it has none.
    peak_probability : float
        Probability that light at a particle is scattered into the peak.
    peak_directions : float64[orders, 3]
        Buffer of `peak_next_event.sample_peak_directions`.
    """

    direction: np.ndarray
    plane: np.ndarray
    transmission: np.ndarray
    reflection: np.ndarray
    transmittance: np.ndarray
    refractive_index: float
    optical_thickness: float
    has_lower_side: bool
    sums: np.ndarray
    phase: PhaseFunction
    peak: Any
    peak_probability: float
    peak_directions: np.ndarray


class Detector(NamedTuple):
    """One of the detectors, see `Detectors`."""

    direction: Vector
    plane: Vector
    transmission: TransmissionMueller
    reflection: ReflectionMueller
    transmittance: float


@inline_only
def compute_optical_depth(layers, layer, z):
    """Return the vertical optical depth of a point in a layer below the upper boundary."""
    depth = layers.collision_coefficient[layer] * (layers.boundaries[layer] - z)
    for above in range(layer):
        thickness = layers.boundaries[above] - layers.boundaries[above + 1]
        depth += layers.collision_coefficient[above] * thickness
    return depth


@inline_only
def load_detector(detectors, k):
    """Return the k-th detector."""
    x, y, z = detectors.direction[k]
    along, across = detectors.plane[k]
    plus, minus, root = detectors.transmission[k]
    transmission = TransmissionMueller(plus, minus, root)
    plus, minus, real, imaginary = detectors.reflection[k]
    reflection = ReflectionMueller(plus, minus, real, imaginary)
    return Detector(
        Vector(x, y, z), Vector(along, across, 0.0), transmission, reflection,
        detectors.transmittance[k],
    )  # fmt: skip


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
def score_direct(detectors, detector, k, stokes, weight, last_scattering):
    """Score light from its last scattering, and after 2, 4, … internal reflections.

    Parameters
    ----------
    detectors : Detectors
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
        depth = _find_depth_from_side(detectors, last_scattering, side)
        arriving = weight * math.exp(-depth / detector.direction.z)
        sums, stokes_vector = detectors.sums[side, k], last_scattering.stokes_vector
        score_detector(sums, detector.transmission, stokes, arriving, stokes_vector)
        if detectors.has_lower_side and detector.reflection.plus != 0.0:
            reflected = sum_interreflections(
                detector.reflection, stokes, detector.transmittance, False, stokes_vector
            )
            score_detector(sums, detector.transmission, stokes, arriving, reflected)


@inline_only
def score_reflected(detectors, detector, k, stokes, weight, last_scattering):
    """Score light that leaves on the other side, after 1, 3, … internal reflections.

    Parameters are those of `score_direct`.
    """
    if detectors.has_lower_side and detector.reflection.plus != 0.0:
        side = BELOW if last_scattering.vertical_sign > 0.0 else ABOVE
        depth = detectors.optical_thickness - _find_depth_from_side(
            detectors, last_scattering, side
        )
        arriving = weight * math.exp(-depth / detector.direction.z)
        reflected = sum_interreflections(
            detector.reflection, stokes, detector.transmittance, True, last_scattering.stokes_vector
        )
        score_detector(detectors.sums[side, k], detector.transmission, stokes, arriving, reflected)


@inline_only
def _find_depth_from_side(detectors, last_scattering, side):
    """Return the vertical optical depth of the last scattering from the boundary of a side."""
    depth = last_scattering.depth
    return depth if side == ABOVE else detectors.optical_thickness - depth


@inline_only
def score_scattering(state, detectors, layers, phase, ray):
    """Score a scattering at all detectors.

    Parameters
    ----------
    state : uint64[1]
        Random stream, used for scatterings into the peak of the phase function.
    detectors : Detectors
    layers : Layers
    phase : PhaseFunction
    ray : Ray
        Position, direction and polarization before the scattering, and the weight after it.
    """
    depth = compute_optical_depth(layers, ray.layer, compute_position(ray).z)
    for k in range(detectors.direction.shape[0]):
        score_scattering_at_detector(state, detectors, phase, 0, ray, depth, k)
        order = sample_peak_order(state, detectors)
        if order > 0:
            score_scattering_at_detector(state, detectors, phase, order, ray, depth, k)


@inline_only
def score_scattering_at_detector(state, detectors, phase, peak_order, ray, depth, k):
    """Score a scattering that is followed by `peak_order` scatterings into the peak."""
    detector = load_detector(detectors, k)
    weight, stokes, t, plane = ray.weight, ray.stokes, detector.direction, detector.plane
    event = ScatteringEvent(ray.direction, stokes, ray.order, depth)
    up = connect_scattering(state, detectors, phase, peak_order, event, t, plane)
    score_direct(detectors, detector, k, stokes, weight, up)
    if detectors.has_lower_side or (peak_order > 0 and detector.reflection.plus > 0.0):
        t = Vector(t.x, t.y, -t.z)
        down = connect_scattering(state, detectors, phase, peak_order, event, t, plane)
        score_direct(detectors, detector, k, stokes, weight, down)
        score_reflected(detectors, detector, k, stokes, weight, up)
        score_reflected(detectors, detector, k, stokes, weight, down)


@inline_only
def score_ground(state, scene, ray):
    """Score light that the diffuse bottom reflects at all detectors above."""
    detectors, stokes = scene.detectors, ray.stokes
    if scene.bottom_albedo is None:
        return
    weight, phase = ray.weight * scene.bottom_albedo, detectors.phase
    for k in range(detectors.direction.shape[0]):
        detector = load_detector(detectors, k)
        t, plane = detector.direction, detector.plane
        weight_at_boundary = weight * detector.transmittance * t.z / math.pi
        sums = detectors.sums[ABOVE, k]
        sums[_I] += weight_at_boundary * detector.transmission.plus
        sums[_Q] += weight_at_boundary * detector.transmission.minus
        order = sample_peak_order(state, detectors)
        if order > 0:
            last = connect_bottom(state, detectors, phase, order, stokes, t, plane)
            score_direct(detectors, detector, k, stokes, weight, last)
        if order > 0 and detector.reflection.plus > 0.0:
            # Light that the upper boundary reflects down may still be scattered upwards.
            t = Vector(t.x, t.y, -t.z)
            last = connect_bottom(state, detectors, phase, order, stokes, t, plane)
            score_direct(detectors, detector, k, stokes, weight, last)
