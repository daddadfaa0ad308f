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

from splits.transport.compiling.jit import part
from splits.transport.numerics.rng import uniform
from splits.transport.numerics.vectors import UP, Vector, dot, scaled
from splits.transport.optics.peak import wide_fraction
from splits.transport.optics.phase import phase_density, scattered
from splits.transport.optics.stokes import Estimate, rotated_to, scattered_towards, unpolarized
from splits.transport.particles.encounters import meet_face


class Sound(NamedTuple):
    """I, Q, U, V of light that is heard."""

    i: float
    q: float
    u: float
    v: float


class LastScattering(NamedTuple):
    """Light that is scattered no more before it leaves.

    Attributes
    ----------
    z : float
        Height (m).
    up : float
        1 where it travels upwards, −1 downwards.
    sound : Sound
        Per steradian.
    """

    height: float
    vertical_sign: float
    stokes_vector: Sound


class Connection(NamedTuple):
    """Light on its way to a detector.

    Attributes
    ----------
    z : float
        Height (m).
    d : Vector
    light : Estimate
        Its density (1/sr), 0 once it has left the layer elsewhere, and its polarization.
    side : float
        −1 after an odd number of reflections: sampled directions are mirrored then.
    """

    height: float
    direction: Vector
    contribution: Estimate
    mirror_sign: float


@part
def sample_order(state, detectors, layer):
    """Sample how many scatterings into the peak follow: n with the probability (1 − q) qⁿ."""
    order = 0
    if detectors.peak is not None:
        highest = detectors.peak_directions.shape[0] - 1
        going_on = detectors.peak.fraction * layer.albedo
        while order < highest and uniform(state) < going_on:
            order += 1
    return order


@part
def sample_directions(state, detectors, peak_order, t):
    """Return a direction from which so many scatterings into the peak lead to t.

    Row 0 of ``detectors.directions`` becomes t, row n the direction before the last n scatterings.
    """
    if detectors.peak is not None:
        _store(detectors.peak_directions, 0, t)
        for row in range(1, peak_order + 1):
            t = scattered(state, detectors.peak.phase, t)
            _store(detectors.peak_directions, row, t)
    return t


@part
def _store(directions, row, d):
    """Write a direction into a row."""
    directions[row, 0], directions[row, 1], directions[row, 2] = d.x, d.y, d.z


@part
def advance_to_particle(state, layer, connection):
    """Return a `Connection` at the next particle, after reflections at smooth faces."""
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
        meeting = meet_face(state, d, stokes, scaled(1.0 if below else -1.0, UP), layer.refractive_index, 1.0)
        if meeting.transmitted or (below and layer.bottom_albedo >= 0.0):
            density = 0.0
        d, stokes, side = meeting.direction, meeting.stokes, -side
    return Connection(z, d, Estimate(density, stokes), side)


@part
def polarize(phase, d, contribution, stokes, t):
    """Return the `Estimate` of light after a scattering into a direction sampled without it.

    Parameters
    ----------
    phase : Phase
    d : Vector
    light : Estimate
        Before the scattering.
    stokes : Stokes or None
        Its polarization.
    t : Vector
        The sampled direction.
    """
    if stokes is None:
        return contribution
    after = scattered_towards(phase, d, stokes, t)
    relative = after.density / phase_density(phase, dot(d, t))
    return Estimate(contribution.density * relative, after.stokes)


@part
def follow_directions(state, detectors, layer, phase, peak_order, connection):
    """Return a `Connection` after so many scatterings into the peak, see `sample_directions`."""
    directions = detectors.peak_directions
    for row in range(peak_order - 1, -1, -1):
        connection = advance_to_particle(state, layer, connection)
        if connection.contribution.density == 0.0:
            break
        z, d, light, side = connection
        t = Vector(directions[row, 0], directions[row, 1], side * directions[row, 2])
        connection = Connection(z, t, polarize(phase, d, light, light.stokes, t), side)
    return connection


@part
def complete(state, detectors, layer, phase, peak_order, connection, plane):
    """Return the `LastScattering` of light that is sent to a detector.

    Parameters
    ----------
    state, detectors, layer, phase
        See `splits.transport.particles.local.listen_particle`.
    order : int
        How many scatterings into the peak follow, 0 or from `sample_order`.
    connection : Connection
        Along the first of their directions.
    plane : Vector
        Horizontal, of the plane that Q refers to.
    """
    if detectors.peak is not None and peak_order > 0:
        per = 1.0 / (1.0 - detectors.peak.fraction * layer.albedo)
        connection = follow_directions(state, detectors, layer, phase, peak_order, connection)
        light = Estimate(per * connection.contribution.density, connection.contribution.stokes)
        connection = Connection(connection.height, connection.direction, light, connection.mirror_sign)
    density, stokes = connection.contribution
    sound = resolve(density, stokes, connection.direction, plane)
    return LastScattering(connection.height, math.copysign(1.0, connection.direction.z), sound)


@part
def resolve(density, stokes, t, plane):
    """Return the `Sound` of light along t (1/sr), Q along the plane of p and z."""
    if stokes is None:
        return Sound(density, 0.0, 0.0, 0.0)
    seen = rotated_to(stokes, t, plane)
    return Sound(density, density * seen.q, density * seen.u, density * stokes.v)


@part
def scatter_toward(phase, d, stokes, t):
    """Return what a particle sends from d towards t, an `Estimate`."""
    if stokes is None:
        return Estimate(phase_density(phase, dot(d, t)), stokes)
    return scattered_towards(phase, d, stokes, t)


@part
def connect_particle(state, detectors, layer, phase, peak_order, ray, t, plane):
    """Return the `LastScattering` of light that a particle and scatterings into the peak send to t.

    Light that has met no particle before comes from one direction, which none of the directions
    that are sampled backwards would hit: it counts with the whole phase function.

    Parameters are those of `complete`, and the ray before the scattering.
    """
    ahead = sample_directions(state, detectors, peak_order, t)
    light = scatter_toward(phase, ray.direction, ray.stokes, ahead)
    if detectors.peak is not None and ray.history.order > 1:
        wide = wide_fraction(detectors.peak, phase, dot(ray.direction, ahead))
        light = Estimate(light.density * wide, light.stokes)
    connection = Connection(ray.position.z, ahead, light, 1.0)
    return complete(state, detectors, layer, phase, peak_order, connection, plane)


@part
def connect_bottom(state, detectors, layer, phase, peak_order, stokes, t, plane):
    """Return the `LastScattering` of light that the bottom and scatterings into the peak send to t.

    Parameters are those of `complete`; `stokes` is None where nobody asks for polarization.
    """
    ahead = sample_directions(state, detectors, peak_order, t)
    light = Estimate(max(ahead.z, 0.0) / math.pi, unpolarized(ahead, stokes))
    connection = Connection(-layer.depth, ahead, light, 1.0)
    return complete(state, detectors, layer, phase, peak_order, connection, plane)
