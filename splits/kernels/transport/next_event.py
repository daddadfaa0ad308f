"""Next-event (local) estimation: every scattering contributes to the detectors.

The method is that of Budak & Grimailo 2020, Eqs 4-5.  Detectors are at infinity, in given
directions above and below layers of particles with smooth boundaries.  A scattering at depth
contributes the density of its phase function towards each detector (Eq 5), and a reflection at the
ground a cosine over π (Eq 4), attenuated on the way to the next boundary.  From there to the
detector, light is refracted and may be reflected any number of times
(`splits.instruments.detector_tally.compute_transmission`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from splits.kernels.arithmetic import dot, store_vector
from splits.kernels.compiler.jit import inline_only
from splits.kernels.interface import ComplexIndex, orient_horizontal_normal, reflect_or_refract_ray
from splits.kernels.phase_function import (
    compute_wide_fraction,
    evaluate_phase_function,
    sample_peak_direction,
)
from splits.kernels.rays import compute_position
from splits.kernels.rng import uniform
from splits.kernels.scattering_matrix import PhaseFunction
from splits.kernels.scene import Vector
from splits.kernels.stokes import (
    ScatteredDensity,
    evaluate_polarized_scattering,
    make_unpolarized,
    rotate_reference_to,
)

# --------------------------------------------------------------------------------------------------
# Connection of an event to a detector, with scatterings into the phase-function peak in between.
#
# Without a narrow peak of the phase function, the current event is the last one before the
# detector. With a peak, light may be scattered into it any number n of times in between.  A local
# estimate at the last of these scatterings would be rare and large, because only directions within
# the peak around the direction of the detector contribute.  They are therefore sampled backwards
# from the detector, and the event before all of them is scored with the wide part of the phase
# function, which is small everywhere.  The sum over all orders n is exact; the method is related to
# the n-tuple local estimate of Buras & Mayer 2011 (J.  Quant.  Spectrosc.  Radiat.  Transfer 112,
# 434).  The n scatterings do not count towards the largest order of scattering.


class LastScattering(NamedTuple):
    """Light after its last scattering.

    Attributes
    ----------
    depth : float
        Vertical optical depth of the last scattering.
    vertical_sign : float
        1 if the light travels upwards, −1 downwards.
    stokes_vector : tuple of float
        I, Q, U and V per steradian.
    """

    depth: float
    vertical_sign: float
    stokes_vector: tuple[float, float, float, float]


class DetectorConnection(NamedTuple):
    """Light between an event and a detector.

    Attributes
    ----------
    depth : float
        Vertical optical depth.
    direction : Vector
    contribution : ScatteredDensity
        Density (1/sr), 0 after the light has left elsewhere, and polarization.
    mirror_sign : float
        −1 after an odd number of reflections, which mirror the sampled directions.
    """

    depth: float
    direction: Vector
    contribution: ScatteredDensity
    mirror_sign: float


@inline_only
def sample_peak_order(state, detectors):
    """Sample the number n of scatterings into the peak that follow, with probability (1 − q) qⁿ."""
    order = 0
    if detectors.peak is not None:
        max_order = detectors.peak_directions.shape[0] - 1
        while order < max_order and uniform(state) < detectors.peak_probability:
            order += 1
    return order


@inline_only
def sample_peak_directions(state, detectors, peak_order, t):
    """Sample a direction from which `peak_order` scatterings into the peak lead to t.

    Row 0 of ``detectors.peak_directions`` is set to t, row n to the direction before the last n
    scatterings.
    """
    if detectors.peak is not None:
        store_vector(t, detectors.peak_directions[0], 0)
        for row in range(1, peak_order + 1):
            t = sample_peak_direction(state, detectors.peak, t)
            store_vector(t, detectors.peak_directions[row], 0)
    return t


@inline_only
def advance_to_collision(state, detectors, connection):
    """Return a connection at the next particle, after reflections at smooth interfaces."""
    depth, d, contribution, mirror_sign = connection
    density, stokes = contribution
    matrix, outside = ComplexIndex(detectors.refractive_index, 0.0), ComplexIndex(1.0, 0.0)
    remaining = -math.log(uniform(state))
    while density > 0.0:
        distance = math.inf
        if d.z != 0.0:
            distance = (depth - (0.0 if d.z > 0.0 else detectors.optical_thickness)) / d.z
        if remaining < distance:
            depth -= remaining * d.z
            break
        remaining -= distance
        below = d.z < 0.0
        depth = detectors.optical_thickness if below else 0.0
        normal = orient_horizontal_normal(d)
        sample = reflect_or_refract_ray(state, d, stokes, normal, matrix, outside)
        if sample.transmitted or (below and not detectors.has_lower_side):
            density = 0.0
        d, stokes, mirror_sign = sample.direction, sample.stokes, -mirror_sign
    return DetectorConnection(depth, d, ScatteredDensity(density, stokes), mirror_sign)


@inline_only
def apply_polarization(phase, d, contribution, stokes, t):
    """Return the `ScatteredDensity` after a scattering whose direction was sampled unpolarized.

    Parameters
    ----------
    phase : PhaseFunction
    d : Vector
    contribution : ScatteredDensity
        Before the scattering.
    stokes : Stokes or None
        Polarization before the scattering.
    t : Vector
        The sampled direction.
    """
    if stokes is None:
        return contribution
    scattered = evaluate_polarized_scattering(phase, d, stokes, t)
    relative = scattered.density / evaluate_phase_function(phase, dot(d, t))
    return ScatteredDensity(contribution.density * relative, scattered.stokes)


@inline_only
def trace_peak_directions(state, detectors, phase, peak_order, connection):
    """Return a `DetectorConnection` after the scatterings of `sample_peak_directions`."""
    directions = detectors.peak_directions
    for row in range(peak_order - 1, -1, -1):
        connection = advance_to_collision(state, detectors, connection)
        if connection.contribution.density == 0.0:
            break
        depth, d, contribution, mirror_sign = connection
        t = Vector(directions[row, 0], directions[row, 1], mirror_sign * directions[row, 2])
        contribution = apply_polarization(phase, d, contribution, contribution.stokes, t)
        connection = DetectorConnection(depth, t, contribution, mirror_sign)
    return connection


@inline_only
def complete_connection(state, detectors, phase, peak_order, connection, plane):
    """Return the `LastScattering` of light towards a detector.

    Parameters
    ----------
    state, detectors, phase
        See `score_scattering`.
    peak_order : int
        Number of scatterings into the peak that follow, 0 or from `sample_peak_order`.
    connection : DetectorConnection
        Along the direction before these scatterings.
    plane : Vector
        Horizontal unit vector of the reference plane of Q.
    """
    if detectors.peak is not None and peak_order > 0:
        normalization = 1.0 / (1.0 - detectors.peak_probability)
        connection = trace_peak_directions(state, detectors, phase, peak_order, connection)
        contribution = ScatteredDensity(
            normalization * connection.contribution.density, connection.contribution.stokes
        )
        connection = DetectorConnection(
            connection.depth, connection.direction, contribution, connection.mirror_sign
        )
    density, stokes = connection.contribution
    stokes_vector = resolve_stokes_vector(density, stokes, connection.direction, plane)
    return LastScattering(
        connection.depth, math.copysign(1.0, connection.direction.z), stokes_vector
    )


@inline_only
def resolve_stokes_vector(density, stokes, t, plane):
    """Return I, Q, U and V of light along t (1/sr), Q relative to `plane`."""
    if stokes is None:
        return density, 0.0, 0.0, 0.0
    rotated = rotate_reference_to(stokes, t, plane)
    return density, density * rotated.q, density * rotated.u, density * stokes.v


@inline_only
def evaluate_scattering(phase, d, stokes, t):
    """Return the `ScatteredDensity` of a particle from d towards t."""
    if stokes is None:
        return ScatteredDensity(evaluate_phase_function(phase, dot(d, t)), stokes)
    return evaluate_polarized_scattering(phase, d, stokes, t)


@inline_only
def connect_scattering(state, detectors, phase, peak_order, ray, depth, t, plane):
    """Return the `LastScattering` towards t of light at a particle.

    Light that was not scattered before has a single direction, which none of the directions sampled
    backwards would hit: it contributes with the whole phase function.

    Parameters are those of `complete_connection` and `score_scattering`, and the vertical optical
    depth of the particle below the upper boundary.
    """
    direction = sample_peak_directions(state, detectors, peak_order, t)
    contribution = evaluate_scattering(phase, ray.direction, ray.stokes, direction)
    if detectors.peak is not None and ray.order > 1:
        cosine = dot(ray.direction, direction)
        wide_fraction = compute_wide_fraction(detectors.peak, phase, cosine)
        contribution = ScatteredDensity(contribution.density * wide_fraction, contribution.stokes)
    connection = DetectorConnection(depth, direction, contribution, 1.0)
    return complete_connection(state, detectors, phase, peak_order, connection, plane)


@inline_only
def connect_ground(state, detectors, phase, peak_order, stokes, t, plane):
    """Return the `LastScattering` towards t of light that the ground reflects.

    Parameters are those of `complete_connection`; `stokes` is None without polarization.
    """
    direction = sample_peak_directions(state, detectors, peak_order, t)
    contribution = ScatteredDensity(
        max(direction.z, 0.0) / math.pi, make_unpolarized(direction, stokes)
    )
    connection = DetectorConnection(detectors.optical_thickness, direction, contribution, 1.0)
    return complete_connection(state, detectors, phase, peak_order, connection, plane)


# --------------------------------------------------------------------------------------------------
# Next-event (local) estimation: every scattering contributes to the detectors.

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
        Buffer of `sample_peak_directions`.
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
        Position, direction and polarization before the scattering, its order, and the weight after
        it.
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
    up = connect_scattering(state, detectors, phase, peak_order, ray, depth, t, plane)
    score_light(detectors, layers, layer, k, stokes, weight, up)
    # Interfaces reflect light that is perpendicular to the plane of incidence at any angle.
    if (
        detectors.has_lower_side
        or detectors.transmission[ABOVE, DOWNWARD, layer, k, 1] > 0.0
        or (peak_order > 0 and detectors.refractive_index != 1.0)
    ):
        t = Vector(t.x, t.y, -t.z)
        down = connect_scattering(state, detectors, phase, peak_order, ray, depth, t, plane)
        score_light(detectors, layers, layer, k, stokes, weight, down)


@inline_only
def score_ground(state, scene, ray):
    """Score light that the ground reflects at all detectors above."""
    detectors, layers, stokes = scene.detectors, scene.layers, ray.stokes
    if scene.ground_albedo is None:
        return
    weight, phase = ray.weight * scene.ground_albedo, detectors.phase
    layer = layers.collision_coefficient.size - 1
    depth = compute_optical_depth(layers, layer, layers.boundaries[layer + 1])
    for k in range(detectors.plane.shape[0]):
        t, plane = load_direction(detectors, layer, k), load_plane(detectors, k)
        reflected = LastScattering(depth, 1.0, (t.z / math.pi, 0.0, 0.0, 0.0))
        score_light(detectors, layers, layer, k, stokes, weight, reflected)
        order = sample_peak_order(state, detectors)
        if order > 0:
            last = connect_ground(state, detectors, phase, order, stokes, t, plane)
            score_light(detectors, layers, layer, k, stokes, weight, last)
        if order > 0 and detectors.refractive_index != 1.0:
            # Light that the upper boundary reflects down may still be scattered upwards.
            t = Vector(t.x, t.y, -t.z)
            last = connect_ground(state, detectors, phase, order, stokes, t, plane)
            score_light(detectors, layers, layer, k, stokes, weight, last)
