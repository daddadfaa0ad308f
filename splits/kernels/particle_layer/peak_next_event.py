"""Light on its way from one event to a detector, with scatterings into the peak in between.

Where the phase function has no narrow peak, the event at hand is the last one before the detector.
With a peak, light may be scattered into it any number n of times in between.  A local estimate at
the last of these would be rare and large: only directions within the peak of the detector's count.
So they are sampled from the detector backwards, and the event before all of them counts, with the
wide part of the phase function, which is small everywhere.  All orders n together are exact; the
method is akin to the n-tuple local estimate of Buras & Mayer 2011 (J. Quant. Spectrosc. Radiat.
Transfer 112, 434).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import UP, Vector, dot, scale
from splits.kernels.optics.forward_peak import compute_wide_fraction
from splits.kernels.optics.phase_function import evaluate_phase_function, sample_phase_function
from splits.kernels.optics.stokes import (
    ScatteredDensity,
    evaluate_polarized_scattering,
    make_unpolarized,
    rotate_reference_to,
)
from splits.kernels.particle_layer.scattering import reflect_or_refract_ray


class StokesVector(NamedTuple):
    """I, Q, U, V of light that is heard."""

    i: float
    q: float
    u: float
    v: float


class LastScattering(NamedTuple):
    """Light that is scattered no more before it leaves.

    Attributes
    ----------
    height : float
        Height (m).
    vertical_sign : float
        1 where it travels upwards, −1 downwards.
    stokes_vector : StokesVector
        Per steradian.
    """

    height: float
    vertical_sign: float
    stokes_vector: StokesVector


class DetectorConnection(NamedTuple):
    """Light on its way to a detector.

    Attributes
    ----------
    height : float
        Height (m).
    direction : Vector
    contribution : Estimate
        Its density (1/sr), 0 once it has left the layer elsewhere, and its polarization.
    mirror_sign : float
        −1 after an odd number of reflections: sampled directions are mirrored then.
    """

    height: float
    direction: Vector
    contribution: ScatteredDensity
    mirror_sign: float


@inline_only
def sample_peak_order(state, detectors, layer):
    """Sample how many scatterings into the peak follow: n with the probability (1 − q) qⁿ."""
    order = 0
    if detectors.peak is not None:
        highest = detectors.peak_directions.shape[0] - 1
        going_on = detectors.peak.fraction * layer.albedo
        while order < highest and uniform(state) < going_on:
            order += 1
    return order


@inline_only
def sample_peak_directions(state, detectors, peak_order, t):
    """Return a direction from which so many scatterings into the peak lead to t.

    Row 0 of ``detectors.directions`` becomes t, row n the direction before the last n scatterings.
    """
    if detectors.peak is not None:
        _store_direction(detectors.peak_directions, 0, t)
        for row in range(1, peak_order + 1):
            t = sample_phase_function(state, detectors.peak.phase, t)
            _store_direction(detectors.peak_directions, row, t)
    return t


@inline_only
def _store_direction(directions, row, d):
    """Write a direction into a row."""
    directions[row, 0], directions[row, 1], directions[row, 2] = d.x, d.y, d.z


@inline_only
def advance_to_collision(state, layer, connection):
    """Return a `DetectorConnection` at the next particle, after reflections at smooth faces."""
    z, d, light, side = connection
    density, stokes = light
    left = -math.log(uniform(state)) / layer.extinction
    while density > 0.0:
        way = math.inf
        if d.z != 0.0:
            way = -(z if d.z > 0.0 else z + layer.depth) / d.z
        if left < way:
            z += left * d.z
            break
        left -= way
        below = d.z < 0.0
        z = -layer.depth if below else 0.0
        meeting = reflect_or_refract_ray(
            state, d, stokes, scale(1.0 if below else -1.0, UP), layer.refractive_index, 1.0
        )
        if meeting.transmitted or (below and layer.bottom_albedo >= 0.0):
            density = 0.0
        d, stokes, side = meeting.direction, meeting.stokes, -side
    return DetectorConnection(z, d, ScatteredDensity(density, stokes), side)


@inline_only
def apply_polarization(phase, d, contribution, stokes, t):
    """Return the `ScatteredDensity` of light after a scattering into a direction sampled without it.

    Parameters
    ----------
    phase : PhaseFunction
    d : Vector
    contribution : Estimate
        Before the scattering.
    stokes : Stokes or None
        Its polarization.
    t : Vector
        The sampled direction.
    """
    if stokes is None:
        return contribution
    after = evaluate_polarized_scattering(phase, d, stokes, t)
    relative = after.density / evaluate_phase_function(phase, dot(d, t))
    return ScatteredDensity(contribution.density * relative, after.stokes)


@inline_only
def trace_peak_directions(state, detectors, layer, phase, peak_order, connection):
    """Return a `DetectorConnection` after so many scatterings into the peak, see `sample_peak_directions`."""
    directions = detectors.peak_directions
    for row in range(peak_order - 1, -1, -1):
        connection = advance_to_collision(state, layer, connection)
        if connection.contribution.density == 0.0:
            break
        z, d, light, side = connection
        t = Vector(directions[row, 0], directions[row, 1], side * directions[row, 2])
        connection = DetectorConnection(
            z, t, apply_polarization(phase, d, light, light.stokes, t), side
        )
    return connection


@inline_only
def complete_connection(state, detectors, layer, phase, peak_order, connection, plane):
    """Return the `LastScattering` of light that is sent to a detector.

    Parameters
    ----------
    state, detectors, layer, phase
        See `splits.kernels.particle_layer.next_event.score_scattering`.
    peak_order : int
        How many scatterings into the peak follow, 0 or from `sample_peak_order`.
    connection : DetectorConnection
        Along the first of their directions.
    plane : Vector
        Horizontal, of the plane that Q refers to.
    """
    if detectors.peak is not None and peak_order > 0:
        per = 1.0 / (1.0 - detectors.peak.fraction * layer.albedo)
        connection = trace_peak_directions(state, detectors, layer, phase, peak_order, connection)
        light = ScatteredDensity(
            per * connection.contribution.density, connection.contribution.stokes
        )
        connection = DetectorConnection(
            connection.height, connection.direction, light, connection.mirror_sign
        )
    density, stokes = connection.contribution
    sound = resolve_stokes_vector(density, stokes, connection.direction, plane)
    return LastScattering(connection.height, math.copysign(1.0, connection.direction.z), sound)


@inline_only
def resolve_stokes_vector(density, stokes, t, plane):
    """Return the `StokesVector` of light along t (1/sr), Q along the plane of p and z."""
    if stokes is None:
        return StokesVector(density, 0.0, 0.0, 0.0)
    seen = rotate_reference_to(stokes, t, plane)
    return StokesVector(density, density * seen.q, density * seen.u, density * stokes.v)


@inline_only
def evaluate_scattering(phase, d, stokes, t):
    """Return what a particle sends from d towards t, an `ScatteredDensity`."""
    if stokes is None:
        return ScatteredDensity(evaluate_phase_function(phase, dot(d, t)), stokes)
    return evaluate_polarized_scattering(phase, d, stokes, t)


@inline_only
def connect_scattering(state, detectors, layer, phase, peak_order, ray, t, plane):
    """Return the `LastScattering` of light that a particle and scatterings into the peak send to t.

    Light that has met no particle before comes from one direction, which none of the directions
    that are sampled backwards would hit: it counts with the whole phase function.

    Parameters are those of `complete_connection`, and the ray before the scattering.
    """
    ahead = sample_peak_directions(state, detectors, peak_order, t)
    light = evaluate_scattering(phase, ray.direction, ray.stokes, ahead)
    if detectors.peak is not None and ray.history.order > 1:
        wide = compute_wide_fraction(detectors.peak, phase, dot(ray.direction, ahead))
        light = ScatteredDensity(light.density * wide, light.stokes)
    connection = DetectorConnection(ray.position.z, ahead, light, 1.0)
    return complete_connection(state, detectors, layer, phase, peak_order, connection, plane)


@inline_only
def connect_bottom(state, detectors, layer, phase, peak_order, stokes, t, plane):
    """Return the `LastScattering` of light that the bottom and scatterings into the peak send to t.

    Parameters are those of `complete_connection`; `stokes` is None where nobody asks for polarization.
    """
    ahead = sample_peak_directions(state, detectors, peak_order, t)
    light = ScatteredDensity(max(ahead.z, 0.0) / math.pi, make_unpolarized(ahead, stokes))
    connection = DetectorConnection(-layer.depth, ahead, light, 1.0)
    return complete_connection(state, detectors, layer, phase, peak_order, connection, plane)
