"""What becomes of a ray in a layer at the surface, the floor and the particles."""

from __future__ import annotations

import math

from splits.transport.compiling.jit import part
from splits.transport.numerics.rng import uniform
from splits.transport.numerics.vectors import UP, scaled
from splits.transport.particles.encounters import (
    meet_face,
    only_reflected,
    reflect_diffusely,
    scatter,
)
from splits.transport.particles.layer_legs import Ray, ended, levelled, moved, once_more, weighing
from splits.transport.particles.local import listen_bottom
from splits.transport.particles.turbid import OPEN
from splits.transport.rough.march import cleared
from splits.transport.sums.tally import ABSORBED, REFLECTED, TRANSMITTED, TRAVELS

ROULETTE_BELOW = 0.1
ROULETTE_SURVIVAL = 0.3
"""Weight below which a ray plays roulette, and its chance there: low, for detectors hear of every
scattering, and one ray that weighs much is heard over many that weigh little."""


@part
def roulette(ray, u):
    """Return a ray that plays Russian roulette with the uniform random number u."""
    if ray.history.weight == 0.0 or u > ROULETTE_SURVIVAL:
        return ended(ray, ABSORBED)
    past = weighing(ray.history, ray.history.weight / ROULETTE_SURVIVAL)
    return moved(ray, ray.direction, ray.stokes, past, ray.status)


@part
def _crossed(state, ray, normal, layer):
    """Return a ray that is reflected or refracted at a facet of the surface."""
    if layer.extinction == math.inf:
        # What enters an opaque layer need not be followed.
        back = only_reflected(ray.direction, ray.stokes, normal, layer.refractive_index)
        past = weighing(ray.history, ray.history.weight * back.reflectance)
        return moved(ray, back.direction, back.stokes, past, TRAVELS)
    near, far = (layer.refractive_index, 1.0) if ray.inside else (1.0, layer.refractive_index)
    against = scaled(-1.0 if ray.inside else 1.0, normal)
    meeting = meet_face(state, ray.direction, ray.stokes, against, near, far)
    inside = ray.inside != meeting.transmitted
    return Ray(ray.position, meeting.direction, meeting.stokes, inside, ray.history, TRAVELS)


@part
def at_surface(state, ray, layer):
    """Return a ray after a meeting with a smooth surface."""
    ray = _crossed(state, levelled(ray, 0.0), UP, layer)
    return ended(ray, TRAVELS if ray.inside else REFLECTED)


@part
def at_facet(state, ray, normal, layer, max_order):
    """Return a ray after a meeting with a facet of a rough surface."""
    gone = ray.history.order == max_order
    ray = _crossed(state, ray, normal, layer)
    d = cleared(ray.direction, scaled(-1.0 if ray.inside else 1.0, normal))
    ray = moved(ray, d, ray.stokes, once_more(ray.history), TRAVELS)
    opaque = layer.extinction == math.inf
    if opaque and ray.history.order > 1 and ray.history.weight < ROULETTE_BELOW:
        ray = roulette(ray, uniform(state))
    return ended(ray, ABSORBED if gone else ray.status)


@part
def at_floor(state, ray, layer, phase, detectors, max_order):
    """Return a ray after a meeting with the open face or with the bottom."""
    ray = levelled(ray, -layer.depth)
    if layer.bottom_albedo == OPEN:
        meeting = meet_face(state, ray.direction, ray.stokes, UP, layer.refractive_index, 1.0)
        fate = TRANSMITTED if meeting.transmitted else TRAVELS
        return moved(ray, meeting.direction, meeting.stokes, ray.history, fate)
    if detectors is not None:
        weight = ray.history.weight * layer.bottom_albedo
        listen_bottom(state, detectors, layer, phase, ray.stokes, weight)
    if uniform(state) >= layer.bottom_albedo:
        return ended(ray, TRANSMITTED)
    if ray.history.order == max_order:
        return ended(ray, ABSORBED)
    after = reflect_diffusely(state, UP, ray.stokes)
    return moved(ray, after.direction, after.stokes, once_more(ray.history), TRAVELS)


@part
def weakened(ray, layer, u, max_order):
    """Return a ray at a particle, before it is scattered: absorbed, or with less weight.

    Parameters
    ----------
    ray : Ray
    layer : Turbid
    u : float
        A uniform random number; 1 where weights take the place of coin tosses.
    most : int
        See `layer.trace`.
    """
    past = once_more(ray.history)
    if not layer.analog:
        past = weighing(past, past.weight * layer.albedo)
    gone = ray.history.order == max_order or (layer.analog and u >= layer.albedo)
    return moved(ray, ray.direction, ray.stokes, past, ABSORBED if gone else TRAVELS)


@part
def scattered(state, ray, phase):
    """Return a ray that a particle has scattered."""
    after = scatter(state, phase, ray.direction, ray.stokes)
    return moved(ray, after.direction, after.stokes, ray.history, TRAVELS)
