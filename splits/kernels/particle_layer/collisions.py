"""What becomes of a ray in a layer at the surface, the floor and the particles."""

from __future__ import annotations

import math

from splits.kernels.compiler.jit import inline_only
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import UP, scale
from splits.kernels.particle_layer.next_event import score_bottom
from splits.kernels.particle_layer.scattering import (
    reflect_only,
    reflect_or_refract_ray,
    sample_lambertian_reflection,
    sample_scattering,
)
from splits.kernels.particle_layer.scene import OPEN_BOTTOM
from splits.kernels.particle_layer.state import (
    LayerRay,
    increment_order,
    set_status,
    snap_to_plane,
    update_ray,
    with_weight,
)
from splits.kernels.rough_surface.intersection import nudge_off_surface
from splits.kernels.tallies.exits import ABSORBED, ALIVE, REFLECTED, TRANSMITTED

ROULETTE_THRESHOLD = 0.1
ROULETTE_SURVIVAL_PROBABILITY = 0.3
"""Weight below which a ray plays roulette, and its chance there: low, for detectors hear of every
scattering, and one ray that weighs much is heard over many that weigh little."""


@inline_only
def russian_roulette(ray, u):
    """Return a ray that plays Russian roulette with the uniform random number u."""
    if ray.history.weight == 0.0 or u > ROULETTE_SURVIVAL_PROBABILITY:
        return set_status(ray, ABSORBED)
    past = with_weight(ray.history, ray.history.weight / ROULETTE_SURVIVAL_PROBABILITY)
    return update_ray(ray, ray.direction, ray.stokes, past, ray.status)


@inline_only
def _reflect_or_refract(state, ray, normal, layer):
    """Return a ray that is reflected or refracted at a facet of the surface."""
    if layer.extinction == math.inf:
        # What enters an opaque layer need not be followed.
        back = reflect_only(ray.direction, ray.stokes, normal, layer.refractive_index)
        past = with_weight(ray.history, ray.history.weight * back.reflectance)
        return update_ray(ray, back.direction, back.stokes, past, ALIVE)
    near, far = (layer.refractive_index, 1.0) if ray.inside else (1.0, layer.refractive_index)
    against = scale(-1.0 if ray.inside else 1.0, normal)
    meeting = reflect_or_refract_ray(state, ray.direction, ray.stokes, against, near, far)
    inside = ray.inside != meeting.transmitted
    return LayerRay(ray.position, meeting.direction, meeting.stokes, inside, ray.history, ALIVE)


@inline_only
def scatter_at_surface(state, ray, layer):
    """Return a ray after a meeting with a smooth surface."""
    ray = _reflect_or_refract(state, snap_to_plane(ray, 0.0), UP, layer)
    return set_status(ray, ALIVE if ray.inside else REFLECTED)


@inline_only
def scatter_at_facet(state, ray, normal, layer, max_order):
    """Return a ray after a meeting with a facet of a rough surface."""
    gone = ray.history.order == max_order
    ray = _reflect_or_refract(state, ray, normal, layer)
    d = nudge_off_surface(ray.direction, scale(-1.0 if ray.inside else 1.0, normal))
    ray = update_ray(ray, d, ray.stokes, increment_order(ray.history), ALIVE)
    opaque = layer.extinction == math.inf
    if opaque and ray.history.order > 1 and ray.history.weight < ROULETTE_THRESHOLD:
        ray = russian_roulette(ray, uniform(state))
    return set_status(ray, ABSORBED if gone else ray.status)


@inline_only
def scatter_at_bottom(state, ray, layer, phase, detectors, max_order):
    """Return a ray after a meeting with the open face or with the bottom."""
    ray = snap_to_plane(ray, -layer.depth)
    if layer.bottom_albedo == OPEN_BOTTOM:
        meeting = reflect_or_refract_ray(
            state, ray.direction, ray.stokes, UP, layer.refractive_index, 1.0
        )
        fate = TRANSMITTED if meeting.transmitted else ALIVE
        return update_ray(ray, meeting.direction, meeting.stokes, ray.history, fate)
    if detectors is not None:
        weight = ray.history.weight * layer.bottom_albedo
        score_bottom(state, detectors, layer, phase, ray.stokes, weight)
    if uniform(state) >= layer.bottom_albedo:
        return set_status(ray, TRANSMITTED)
    if ray.history.order == max_order:
        return set_status(ray, ABSORBED)
    after = sample_lambertian_reflection(state, UP, ray.stokes)
    return update_ray(ray, after.direction, after.stokes, increment_order(ray.history), ALIVE)


@inline_only
def absorb_at_particle(ray, layer, u, max_order):
    """Return a ray at a particle, before it is scattered: absorbed, or with less weight.

    Parameters
    ----------
    ray : Ray
    layer : ScatteringLayer
    u : float
        A uniform random number; 1 where weights take the place of coin tosses.
    max_order : int
        See `layer.trace`.
    """
    past = increment_order(ray.history)
    if not layer.analog:
        past = with_weight(past, past.weight * layer.albedo)
    gone = ray.history.order == max_order or (layer.analog and u >= layer.albedo)
    return update_ray(ray, ray.direction, ray.stokes, past, ABSORBED if gone else ALIVE)


@inline_only
def scatter_at_particle(state, ray, phase):
    """Return a ray that a particle has scattered."""
    after = sample_scattering(state, phase, ray.direction, ray.stokes)
    return update_ray(ray, after.direction, after.stokes, ray.history, ALIVE)
