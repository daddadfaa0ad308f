"""Interactions of a ray with the surface, the bottom and the particles of a layer."""

from __future__ import annotations

import math

from splits.kernels.compiler.jit import inline_only
from splits.kernels.compiler.replace import replace
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
from splits.kernels.particle_layer.state import set_height
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
    if ray.weight == 0.0 or u > ROULETTE_SURVIVAL_PROBABILITY:
        return replace(ray, status=ABSORBED)
    return replace(ray, weight=ray.weight / ROULETTE_SURVIVAL_PROBABILITY)


@inline_only
def _reflect_or_refract(state, ray, normal, layer):
    """Return a ray after reflection or refraction at a facet of the surface."""
    if layer.extinction == math.inf:
        # Light that enters an opaque layer is absorbed.
        reflected = reflect_only(ray.direction, ray.stokes, normal, layer.refractive_index)
        return replace(
            ray, direction=reflected.direction, stokes=reflected.stokes,
            weight=ray.weight * reflected.reflectance, status=ALIVE,
        )  # fmt: skip
    near, far = (layer.refractive_index, 1.0) if ray.inside else (1.0, layer.refractive_index)
    facing_normal = scale(-1.0 if ray.inside else 1.0, normal)
    sample = reflect_or_refract_ray(state, ray.direction, ray.stokes, facing_normal, near, far)
    return replace(
        ray, direction=sample.direction, stokes=sample.stokes,
        inside=ray.inside != sample.transmitted, status=ALIVE,
    )  # fmt: skip


@inline_only
def scatter_at_surface(state, ray, layer):
    """Return a ray after reflection or refraction at the smooth surface."""
    ray = _reflect_or_refract(state, set_height(ray, 0.0), UP, layer)
    return replace(ray, status=ALIVE if ray.inside else REFLECTED)


@inline_only
def scatter_at_facet(state, ray, normal, layer, max_order):
    """Return a ray after reflection or refraction at a facet of the rough surface."""
    terminated = ray.order == max_order
    ray = _reflect_or_refract(state, ray, normal, layer)
    d = nudge_off_surface(ray.direction, scale(-1.0 if ray.inside else 1.0, normal))
    ray = replace(ray, direction=d, order=ray.order + 1)
    if layer.extinction == math.inf and ray.order > 1 and ray.weight < ROULETTE_THRESHOLD:
        ray = russian_roulette(ray, uniform(state))
    return replace(ray, status=ABSORBED if terminated else ray.status)


@inline_only
def scatter_at_bottom(state, ray, layer, phase, detectors, max_order):
    """Return a ray after an interaction with the open lower boundary or the diffuse bottom."""
    ray = set_height(ray, -layer.depth)
    if layer.bottom_albedo == OPEN_BOTTOM:
        sample = reflect_or_refract_ray(
            state, ray.direction, ray.stokes, UP, layer.refractive_index, 1.0
        )
        return replace(
            ray, direction=sample.direction, stokes=sample.stokes,
            status=TRANSMITTED if sample.transmitted else ALIVE,
        )  # fmt: skip
    if detectors is not None:
        weight = ray.weight * layer.bottom_albedo
        score_bottom(state, detectors, layer, phase, ray.stokes, weight)
    if uniform(state) >= layer.bottom_albedo:
        return replace(ray, status=TRANSMITTED)
    if ray.order == max_order:
        return replace(ray, status=ABSORBED)
    reflected = sample_lambertian_reflection(state, UP, ray.stokes)
    return replace(ray, direction=reflected.direction, stokes=reflected.stokes, order=ray.order + 1)


@inline_only
def absorb_at_particle(ray, layer, u, max_order):
    """Apply absorption to a ray at a particle: analog, or by implicit capture.

    Parameters
    ----------
    ray : LayerRay
    layer : ScatteringLayer
    u : float
        A uniform random number; 1 without analog absorption.
    max_order : int
        See `particle_history.trace_history`.
    """
    terminated = ray.order == max_order or (layer.analog and u >= layer.albedo)
    return replace(
        ray, weight=ray.weight if layer.analog else ray.weight * layer.albedo,
        order=ray.order + 1, status=ABSORBED if terminated else ALIVE,
    )  # fmt: skip


@inline_only
def scatter_at_particle(state, ray, phase):
    """Return a ray after scattering by a particle."""
    scattered = sample_scattering(state, phase, ray.direction, ray.stokes)
    return replace(ray, direction=scattered.direction, stokes=scattered.stokes)
