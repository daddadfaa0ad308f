"""A scattering layer under a smooth or a randomly rough Fresnel surface, over a diffuse bottom.

Budak & Grimailo 2020, section 3.2: free paths, scattering by small particles, reflection and
refraction at the surface, reflection by the bottom.  Single-scattering albedo is a weight along
the path, or a coin toss.  What a scene does not have, a rough surface, polarization or detectors,
is None and compiled away.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splits.transport.encounters import depolarize, meet_face, only_reflected, scatter
from splits.transport.flight import ROULETTE_BELOW, ROULETTE_SURVIVAL
from splits.transport.frames import cosine_lobe
from splits.transport.granular import ABSORBED, LOST, REFLECTED, TRANSMITTED
from splits.transport.jit import entry, kernel
from splits.transport.local import listen_bottom, listen_particle
from splits.transport.rng import start_stream, uniform
from splits.transport.rough_surface import (
    GONE,
    cleared,
    draw_waves,
    first_crossing,
    normal_of,
)
from splits.transport.rough_surface import LOST as LOST_AT_SURFACE
from splits.transport.stokes import rotated_to
from splits.transport.tally import EXIT_LENGTH, record

OPEN = -1.0
"""In place of the bottom's albedo: the layer ends at a smooth face to the outer medium."""

EXIT_STOKES = EXIT_LENGTH + 1
"""First of three columns of polarized rays: Q, U, V over I, Q along the plane of the normal."""


class Turbid(NamedTuple):
    """The layer between its mean surface z = 0 and z = −depth, and its illumination.

    Attributes
    ----------
    depth : float
        Metres; may be infinite.
    extinction : float
        1/m; infinite where nothing comes back from below the surface.
    albedo : float
        Of single scattering.
    n : float
        Refractive index relative to the outer medium.
    bottom : float
        Albedo of the diffuse bottom, or `OPEN`.
    cos_incidence : float
        In (0, 1]; ignored under diffuse light.
    diffuse : bool
        Equal radiance from the whole hemisphere instead of a beam.
    analog : bool
        Absorption by coin toss.
    """

    depth: float
    extinction: float
    albedo: float
    n: float
    bottom: float
    cos_incidence: float
    diffuse: bool
    analog: bool


@kernel
def trace(state, layer, phase, fields, waves, bounds, polar, detectors, most):
    """Follow one ray from the light source until it leaves the layer or is absorbed.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    layer : Turbid
    phase : Phase
    fields : Fields or None
        The rough surface; every ray meets a realisation of its own.
    waves, bounds : float64 array or None
        Room for a realisation, see `splits.transport.rough_surface`.
    polar : float64[6] or None
        Polarization on the way, see `meet_face`.
    detectors : Detectors or None
        What hears of every scattering, see `splits.transport.local`.
    most : int
        Scatterings, meetings with the bottom or with a rough surface, after which the ray counts
        as absorbed.

    Returns
    -------
    fate : int
        `ABSORBED`, `REFLECTED`, `TRANSMITTED` (through the open face or into the bottom), `LOST`.
    x, y, dx, dy, dz : float
        Point and direction of exit.
    weight : float
    way : float
        Path within the layer (m).
    order, legs : int
        Scatterings and such meetings; legs.
    """
    mu = math.sqrt(uniform(state)) if layer.diffuse else layer.cos_incidence
    dx, dy, dz = math.sqrt(max(0.0, (1.0 - mu) * (1.0 + mu))), 0.0, -mu
    depolarize(dx, dy, dz, polar)
    x, y, z = 0.0, 0.0, 0.0
    weight, way = 1.0, 0.0
    order, legs = 0, 0
    inside = False
    # What enters an opaque layer need not be followed.
    opaque = layer.extinction == math.inf
    low, high = 0.0, 0.0
    if fields is not None:
        low, high = draw_waves(state, fields, waves, bounds)
        # Rays aim at the origin of the mean surface.
        x, z = high * dx / dz, high
    while True:
        legs += 1
        side = -1.0 if inside else 1.0
        leg, floor = math.inf, math.inf
        if inside:
            leg = -math.log(uniform(state)) / layer.extinction
            if dz < 0.0:
                floor = (-layer.depth - z) / dz
        ahead = math.inf
        nx, ny, nz = 0.0, 0.0, 1.0
        if fields is not None:
            # Deep inside, most legs end before the surface can be met.
            if not inside or max(z, z + min(leg, floor) * dz) > low:
                distance, sx, sy = first_crossing(
                    waves, bounds, x, y, z, dx, dy, dz, side, low, high, min(leg, floor)
                )
                if distance == LOST_AT_SURFACE:
                    return LOST, x, y, dx, dy, dz, weight, way, order, legs
                if distance != GONE:
                    ahead = distance
                    nx, ny, nz = normal_of(sx, sy)
        elif inside and dz > 0.0:
            ahead = -z / dz
        elif not inside and dz < 0.0:
            ahead = 0.0
        if not inside and ahead == math.inf:
            fate = REFLECTED if dz > 0.0 else LOST
            return fate, x, y, dx, dy, dz, weight, way, order, legs
        step = min(leg, floor, ahead)
        x += step * dx
        y += step * dy
        z += step * dz
        if inside:
            way += step
        if ahead <= min(leg, floor):
            if fields is None:
                z = 0.0
            else:
                if order == most:
                    return ABSORBED, x, y, dx, dy, dz, weight, way, order, legs
                order += 1
            n1, n2 = (layer.n, 1.0) if inside else (1.0, layer.n)
            if opaque and not inside:
                share, dx, dy, dz = only_reflected(dx, dy, dz, nx, ny, nz, n2, polar)
                weight *= share
                if fields is None:
                    return REFLECTED, x, y, dx, dy, dz, weight, way, order, legs
                if weight < ROULETTE_BELOW and order > 1:
                    if uniform(state) > ROULETTE_SURVIVAL:
                        return ABSORBED, x, y, dx, dy, dz, weight, way, order, legs
                    weight /= ROULETTE_SURVIVAL
                dx, dy, dz = cleared(dx, dy, dz, nx, ny, nz)
                continue
            passed, dx, dy, dz = meet_face(
                state, dx, dy, dz, side * nx, side * ny, side * nz, n1, n2, polar
            )
            if passed:
                inside = not inside
            if fields is None:
                if not inside:
                    return REFLECTED, x, y, dx, dy, dz, weight, way, order, legs
            else:
                away = -1.0 if inside else 1.0
                dx, dy, dz = cleared(dx, dy, dz, away * nx, away * ny, away * nz)
            continue
        if floor <= leg:
            z = -layer.depth
            if layer.bottom == OPEN:
                passed, dx, dy, dz = meet_face(
                    state, dx, dy, dz, 0.0, 0.0, 1.0, layer.n, 1.0, polar
                )
                if passed:
                    return TRANSMITTED, x, y, dx, dy, dz, weight, way, order, legs
                continue
            if detectors is not None:
                listen_bottom(detectors, layer, weight * layer.bottom)
            if uniform(state) >= layer.bottom:
                return TRANSMITTED, x, y, dx, dy, dz, weight, way, order, legs
            if order == most:
                return ABSORBED, x, y, dx, dy, dz, weight, way, order, legs
            order += 1
            dx, dy, dz = cosine_lobe(state, 0.0, 0.0, 1.0)
            depolarize(dx, dy, dz, polar)
            continue
        if order == most:
            return ABSORBED, x, y, dx, dy, dz, weight, way, order, legs
        order += 1
        if layer.analog:
            if uniform(state) >= layer.albedo:
                return ABSORBED, x, y, dx, dy, dz, weight, way, order, legs
        else:
            weight *= layer.albedo
            if detectors is not None:
                listen_particle(detectors, layer, phase, z, dx, dy, dz, weight, polar)
            if weight < ROULETTE_BELOW:
                # A weight of zero always ends here.
                if weight == 0.0 or uniform(state) > ROULETTE_SURVIVAL:
                    return ABSORBED, x, y, dx, dy, dz, weight, way, order, legs
                weight /= ROULETTE_SURVIVAL
        dx, dy, dz = scatter(state, dx, dy, dz, phase, polar)


@entry
def batch(seed, work, layer, phase, fields, waves, bounds, polar, exits):
    """Trace rays and record how they leave.

    Parameters
    ----------
    seed, work
        See `splits.transport.granular.batch`.
    layer, phase, fields, waves, bounds, polar
        See `trace`.
    exits : float64[rays, columns]
        A row for each ray, see `splits.transport.tally`; polarized rays have columns
        `EXIT_STOKES` besides.

    Returns
    -------
    legs : int
        Legs traced.
    lost : bool
        Whether a ray was lost; the batch then ends early.
    """
    legs = 0
    state = np.zeros(1, dtype=np.uint64)
    for ray in range(work[2]):
        start_stream(state, seed, work[0], work[1] + ray)
        fate, x, y, dx, dy, dz, weight, way, order, spent = trace(
            state, layer, phase, fields, waves, bounds, polar, None, work[3]
        )
        legs += spent
        if fate == LOST:
            return legs, True
        if fate == ABSORBED:
            continue
        row = exits[ray]
        record(row, fate == REFLECTED, x, y, dx, dy, dz, weight, order)
        row[EXIT_LENGTH] = way
        if polar is not None:
            # Straight up or down, every plane holds the normal.
            upright = dx == 0.0 and dy == 0.0
            q, u = rotated_to(
                polar[3], polar[4], polar[0], polar[1], polar[2],
                dx, dy, dz, 1.0 if upright else dx, dy, 0.0,
            )  # fmt: skip
            row[EXIT_STOKES] = q
            row[EXIT_STOKES + 1] = u
            row[EXIT_STOKES + 2] = polar[5]
    return legs, False


@entry
def hear(seed, work, layer, phase, polar, detectors, totals):
    """Trace rays under a smooth surface for detectors to hear, and return the legs traced.

    Parameters
    ----------
    seed, work, layer, phase, polar
        See `batch`.
    detectors : Detectors
        Advanced in place.
    totals : float64[2, 2]
        [reflected, transmitted][all light, light that met nothing but smooth faces], advanced in
        place.
    """
    legs = 0
    state = np.zeros(1, dtype=np.uint64)
    for ray in range(work[2]):
        start_stream(state, seed, work[0], work[1] + ray)
        fate, _, _, _, _, _, weight, _, order, spent = trace(
            state, layer, phase, None, None, None, polar, detectors, work[3]
        )
        legs += spent
        if fate != ABSORBED:
            side = 0 if fate == REFLECTED else 1
            totals[side, 0] += weight
            if order == 0:
                totals[side, 1] += weight
    return legs
