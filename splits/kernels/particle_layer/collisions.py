"""Interactions of a ray with the surface, the bottom and the particles of a layer."""

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
"""Weight below which Russian roulette is played, and the probability to survive it.

Both are low: every scattering contributes to the detectors, and rays of low weight hardly do.
"""


@inline_only
def russian_roulette(ray, u):
    """Play Russian roulette with the uniform random number u, and return the ray."""
    if ray.history.weight == 0.0 or u > ROULETTE_SURVIVAL_PROBABILITY:
        return set_status(ray, ABSORBED)
    history = with_weight(ray.history, ray.history.weight / ROULETTE_SURVIVAL_PROBABILITY)
    return update_ray(ray, ray.direction, ray.stokes, history, ray.status)


@inline_only
def _reflect_or_refract(state, ray, normal, layer):
    """Return a ray after reflection or refraction at a facet of the surface."""
    if layer.extinction == math.inf:
        # Light that enters an opaque layer is absorbed.
        reflected = reflect_only(ray.direction, ray.stokes, normal, layer.refractive_index)
        history = with_weight(ray.history, ray.history.weight * reflected.reflectance)
        return update_ray(ray, reflected.direction, reflected.stokes, history, ALIVE)
    near, far = (layer.refractive_index, 1.0) if ray.inside else (1.0, layer.refractive_index)
    facing_normal = scale(-1.0 if ray.inside else 1.0, normal)
    sample = reflect_or_refract_ray(state, ray.direction, ray.stokes, facing_normal, near, far)
    inside = ray.inside != sample.transmitted
    return LayerRay(ray.position, sample.direction, sample.stokes, inside, ray.history, ALIVE)


@inline_only
def scatter_at_surface(state, ray, layer):
    """Return a ray after reflection or refraction at the smooth surface."""
    ray = _reflect_or_refract(state, snap_to_plane(ray, 0.0), UP, layer)
    return set_status(ray, ALIVE if ray.inside else REFLECTED)


@inline_only
def scatter_at_facet(state, ray, normal, layer, max_order):
    """Return a ray after reflection or refraction at a facet of the rough surface."""
    terminated = ray.history.order == max_order
    ray = _reflect_or_refract(state, ray, normal, layer)
    d = nudge_off_surface(ray.direction, scale(-1.0 if ray.inside else 1.0, normal))
    ray = update_ray(ray, d, ray.stokes, increment_order(ray.history), ALIVE)
    opaque = layer.extinction == math.inf
    if opaque and ray.history.order > 1 and ray.history.weight < ROULETTE_THRESHOLD:
        ray = russian_roulette(ray, uniform(state))
    return set_status(ray, ABSORBED if terminated else ray.status)


@inline_only
def scatter_at_bottom(state, ray, layer, phase, detectors, max_order):
    """Return a ray after an interaction with the open lower boundary or the diffuse bottom."""
    ray = snap_to_plane(ray, -layer.depth)
    if layer.bottom_albedo == OPEN_BOTTOM:
        sample = reflect_or_refract_ray(
            state, ray.direction, ray.stokes, UP, layer.refractive_index, 1.0
        )
        status = TRANSMITTED if sample.transmitted else ALIVE
        return update_ray(ray, sample.direction, sample.stokes, ray.history, status)
    if detectors is not None:
        weight = ray.history.weight * layer.bottom_albedo
        score_bottom(state, detectors, layer, phase, ray.stokes, weight)
    if uniform(state) >= layer.bottom_albedo:
        return set_status(ray, TRANSMITTED)
    if ray.history.order == max_order:
        return set_status(ray, ABSORBED)
    reflected = sample_lambertian_reflection(state, UP, ray.stokes)
    return update_ray(
        ray, reflected.direction, reflected.stokes, increment_order(ray.history), ALIVE
    )


@inline_only
def absorb_at_particle(ray, layer, u, max_order):
    """Apply absorption to a ray at a particle: terminate it or reduce its weight.

    Parameters
    ----------
    ray : LayerRay
    layer : ScatteringLayer
    u : float
        A uniform random number; 1 without analog absorption.
    max_order : int
        See `particle_history.trace_history`.
    """
    history = increment_order(ray.history)
    if not layer.analog:
        history = with_weight(history, history.weight * layer.albedo)
    terminated = ray.history.order == max_order or (layer.analog and u >= layer.albedo)
    return update_ray(ray, ray.direction, ray.stokes, history, ABSORBED if terminated else ALIVE)


@inline_only
def scatter_at_particle(state, ray, phase):
    """Return a ray after scattering by a particle."""
    scattered = sample_scattering(state, phase, ray.direction, ray.stokes)
    return update_ray(ray, scattered.direction, scattered.stokes, ray.history, ALIVE)
