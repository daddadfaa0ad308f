"""Connection of an event to a detector, with scatterings into the phase-function peak in between.

Without a narrow peak of the phase function, the current event is the last one before the detector.
With a peak, light may be scattered into it any number n of times in between.  A local estimate at
the last of these scatterings would be rare and large, because only directions within the peak
around the direction of the detector contribute.  They are therefore sampled backwards from the
detector, and the event before all of them is scored with the wide part of the phase function, which
is small everywhere.  The sum over all orders n is exact; the method is related to the n-tuple local
estimate of Buras & Mayer 2011 (J.  Quant.  Spectrosc.  Radiat.  Transfer 112, 434).  The n
scatterings do not count towards the largest order of scattering.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import Vector, dot
from splits.kernels.optics.forward_peak import compute_wide_fraction, sample_peak_direction
from splits.kernels.optics.interface import ComplexIndex, orient_horizontal_normal
from splits.kernels.optics.phase_function import evaluate_phase_function
from splits.kernels.optics.scattering import reflect_or_refract_ray
from splits.kernels.optics.stokes import (
    ScatteredDensity,
    evaluate_polarized_scattering,
    make_unpolarized,
    rotate_reference_to,
)


class StokesVector(NamedTuple):
    """Stokes parameters I, Q, U, V."""

    i: float
    q: float
    u: float
    v: float


class ScatteringEvent(NamedTuple):
    """Light at a particle.

    Attributes
    ----------
    direction : Vector
        Direction before the scattering.
    stokes : Stokes or None
        Polarization before the scattering.
    order : int
        Order of scattering, including this one.
    depth : float
        Vertical optical depth below the upper boundary.
    """

    direction: Vector
    stokes: Any
    order: int
    depth: float


class LastScattering(NamedTuple):
    """Light after its last scattering.

    Attributes
    ----------
    depth : float
        Vertical optical depth of the last scattering.
    vertical_sign : float
        1 if the light travels upwards, −1 downwards.
    stokes_vector : StokesVector
        Per steradian.
    """

    depth: float
    vertical_sign: float
    stokes_vector: StokesVector


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
        _store_direction(detectors.peak_directions, 0, t)
        for row in range(1, peak_order + 1):
            t = sample_peak_direction(state, detectors.peak, t)
            _store_direction(detectors.peak_directions, row, t)
    return t


@inline_only
def _store_direction(directions, row, d):
    """Write a direction into a row."""
    directions[row, 0], directions[row, 1], directions[row, 2] = d.x, d.y, d.z


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
        See `splits.kernels.transport.next_event.score_scattering`.
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
    """Return the `StokesVector` of light along t (1/sr), Q relative to `plane`."""
    if stokes is None:
        return StokesVector(density, 0.0, 0.0, 0.0)
    rotated = rotate_reference_to(stokes, t, plane)
    return StokesVector(density, density * rotated.q, density * rotated.u, density * stokes.v)


@inline_only
def evaluate_scattering(phase, d, stokes, t):
    """Return the `ScatteredDensity` of a particle from d towards t."""
    if stokes is None:
        return ScatteredDensity(evaluate_phase_function(phase, dot(d, t)), stokes)
    return evaluate_polarized_scattering(phase, d, stokes, t)


@inline_only
def connect_scattering(state, detectors, phase, peak_order, event, t, plane):
    """Return the `LastScattering` towards t of light at a particle.

    Light that was not scattered before has a single direction, which none of the directions sampled
    backwards would hit: it contributes with the whole phase function.

    Parameters are those of `complete_connection`, and the `ScatteringEvent`.
    """
    direction = sample_peak_directions(state, detectors, peak_order, t)
    contribution = evaluate_scattering(phase, event.direction, event.stokes, direction)
    if detectors.peak is not None and event.order > 1:
        cosine = dot(event.direction, direction)
        wide_fraction = compute_wide_fraction(detectors.peak, phase, cosine)
        contribution = ScatteredDensity(contribution.density * wide_fraction, contribution.stokes)
    connection = DetectorConnection(event.depth, direction, contribution, 1.0)
    return complete_connection(state, detectors, phase, peak_order, connection, plane)


@inline_only
def connect_bottom(state, detectors, phase, peak_order, stokes, t, plane):
    """Return the `LastScattering` towards t of light that the bottom reflects.

    Parameters are those of `complete_connection`; `stokes` is None without polarization.
    """
    direction = sample_peak_directions(state, detectors, peak_order, t)
    contribution = ScatteredDensity(
        max(direction.z, 0.0) / math.pi, make_unpolarized(direction, stokes)
    )
    connection = DetectorConnection(detectors.optical_thickness, direction, contribution, 1.0)
    return complete_connection(state, detectors, phase, peak_order, connection, plane)
