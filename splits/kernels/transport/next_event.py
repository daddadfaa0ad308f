"""Next-event (local) estimation: every scattering contributes to the detectors.

The method is that of Budak & Grimailo 2020, Eqs 4-5.  Detectors are at infinity, in given
directions above and below layers of particles with smooth boundaries.  A scattering at depth
contributes the density of its phase function towards each detector (Eq 5), and a reflection at the
bottom a cosine over π (Eq 4), attenuated on the way to the next boundary.  From there to the
detector, light is refracted and may be reflected any number of times
(`splits.instruments.next_event.compute_transmission`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from splits.kernels.base.ray import compute_position
from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.vectors import Vector
from splits.kernels.optics.phase_function import PhaseFunction
from splits.kernels.transport.peak_next_event import (
    LastScattering,
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
UPWARD, DOWNWARD = range(2)
"""Senses of light in a layer."""


class Detectors(NamedTuple):
    """Directions of detectors, with the transmission from each layer to them.

    Attributes
    ----------
    direction : float64[layers, detectors, 3]
        Unit directions within each layer, upwards.
    plane : float64[detectors, 2]
        Horizontal unit vector that, with the normal, spans the reference plane of Q.
    transmission : float64[2, 2, layers, detectors, 3]
        To detectors `ABOVE` and `BELOW` of light that arrives `UPWARD` at the upper boundary of a
        layer, or `DOWNWARD` at the lower one: factors of I + Q, of I − Q, and of U and V, after any
        number of reflections, times the ratio of solid angles in the layer and outside, divided by
        the outer cosine.
    refractive_index : float
        Refractive index of the lowest layer, with 1 outside.
    optical_thickness : float
        Vertical optical thickness of the lowest layer; may be infinite.
    has_lower_side : bool
        Whether there are detectors below the sample, too: its lower boundary is open.
    sums : float64[2, detectors, 4]
        Scores of I, Q, U, V `ABOVE` and `BELOW` (1/sr), Q along the plane of the normal; advanced
        in place.
    phase : PhaseFunction
        Phase function of the lowest layer.
    peak : PhaseFunctionPeak or None
        Peak of the phase function of a single layer, None if it has none.
    peak_probability : float
        Probability that light at a particle is scattered into the peak.
    peak_directions : float64[orders, 3]
        Buffer of `peak_next_event.sample_peak_directions`.
    """

    direction: np.ndarray
    plane: np.ndarray
    transmission: np.ndarray
    refractive_index: float
    optical_thickness: float
    has_lower_side: bool
    sums: np.ndarray
    phase: PhaseFunction
    peak: Any
    peak_probability: float
    peak_directions: np.ndarray


@inline_only
def load_direction(detectors, layer, k):
    """Return the direction of the k-th detector in a layer, upwards."""
    x, y, z = detectors.direction[layer, k]
    return Vector(x, y, z)


@inline_only
def load_plane(detectors, k):
    """Return the horizontal unit vector of the reference plane of the k-th detector."""
    along, across = detectors.plane[k]
    return Vector(along, across, 0.0)


@inline_only
def score_detector(sums, transmission, stokes, weight, stokes_vector):
    """Score light that arrives at a boundary at a detector outside."""
    i, q, u, v = stokes_vector
    if stokes is None:
        sums[_I] += weight * transmission[0] * i
        return
    parallel, perpendicular = 0.5 * transmission[0] * (i + q), 0.5 * transmission[1] * (i - q)
    sums[_I] += weight * (parallel + perpendicular)
    sums[_Q] += weight * (parallel - perpendicular)
    sums[_U] += weight * transmission[2] * u
    sums[_V] += weight * transmission[2] * v


@inline_only
def score_light(detectors, layers, layer, k, stokes, weight, last_scattering):
    """Score light in a layer at the k-th detector of each side.

    Parameters
    ----------
    detectors : Detectors
    layers : Layers
    layer, k : int
    stokes : Stokes or None
        None without polarization.
    weight : float
    last_scattering : LastScattering
        In the direction of the detector in the layer, upwards or downwards.
    """
    depth, vertical_sign, stokes_vector = last_scattering
    sense = UPWARD if vertical_sign > 0.0 else DOWNWARD
    if sense == DOWNWARD:
        depth = compute_optical_depth(layers, layer, layers.boundaries[layer + 1]) - depth
    arriving = weight * math.exp(-depth / detectors.direction[layer, k, 2])
    for side in range(2 if detectors.has_lower_side else 1):
        transmission = detectors.transmission[side, sense, layer, k]
        score_detector(detectors.sums[side, k], transmission, stokes, arriving, stokes_vector)


@inline_only
def compute_optical_depth(layers, layer, z):
    """Return the vertical optical depth of a point below the upper boundary of its layer."""
    return layers.collision_coefficient[layer] * (layers.boundaries[layer] - z)


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
    for k in range(detectors.plane.shape[0]):
        score_scattering_at_detector(state, detectors, layers, phase, 0, ray, k)
        order = sample_peak_order(state, detectors)
        if order > 0:
            score_scattering_at_detector(state, detectors, layers, phase, order, ray, k)


@inline_only
def score_scattering_at_detector(state, detectors, layers, phase, peak_order, ray, k):
    """Score a scattering that is followed by `peak_order` scatterings into the peak."""
    t, plane = load_direction(detectors, ray.layer, k), load_plane(detectors, k)
    weight, stokes, layer = ray.weight, ray.stokes, ray.layer
    depth = compute_optical_depth(layers, layer, compute_position(ray).z)
    event = ScatteringEvent(ray.direction, stokes, ray.order, depth)
    up = connect_scattering(state, detectors, phase, peak_order, event, t, plane)
    score_light(detectors, layers, layer, k, stokes, weight, up)
    # Interfaces reflect light that is perpendicular to the plane of incidence at any angle.
    if (
        detectors.has_lower_side
        or detectors.transmission[ABOVE, DOWNWARD, layer, k, 1] > 0.0
        or (peak_order > 0 and detectors.refractive_index != 1.0)
    ):
        t = Vector(t.x, t.y, -t.z)
        down = connect_scattering(state, detectors, phase, peak_order, event, t, plane)
        score_light(detectors, layers, layer, k, stokes, weight, down)


@inline_only
def score_ground(state, scene, ray):
    """Score light that the diffuse bottom reflects at all detectors above."""
    detectors, layers, stokes = scene.detectors, scene.layers, ray.stokes
    if scene.bottom_albedo is None:
        return
    weight, phase = ray.weight * scene.bottom_albedo, detectors.phase
    layer = layers.collision_coefficient.size - 1
    depth = compute_optical_depth(layers, layer, layers.boundaries[layer + 1])
    for k in range(detectors.plane.shape[0]):
        t, plane = load_direction(detectors, layer, k), load_plane(detectors, k)
        reflected = LastScattering(depth, 1.0, StokesVector(t.z / math.pi, 0.0, 0.0, 0.0))
        score_light(detectors, layers, layer, k, stokes, weight, reflected)
        order = sample_peak_order(state, detectors)
        if order > 0:
            last = connect_bottom(state, detectors, phase, order, stokes, t, plane)
            score_light(detectors, layers, layer, k, stokes, weight, last)
        if order > 0 and detectors.refractive_index != 1.0:
            # Light that the upper boundary reflects down may still be scattered upwards.
            t = Vector(t.x, t.y, -t.z)
            last = connect_bottom(state, detectors, phase, order, stokes, t, plane)
            score_light(detectors, layers, layer, k, stokes, weight, last)
