"""Events in the history of a ray: roulette, interfaces, particles, grains, and the ground."""

from __future__ import annotations

import math

from splits.kernels.compiler.jit import inline_only
from splits.kernels.compiler.replace import replace
from splits.kernels.grains.flight import find_adjacent_layer, record_crossing
from splits.kernels.grains.free_path import russian_roulette
from splits.kernels.grains.grain_path import trace_through_grain
from splits.kernels.grains.scene import NO_GROUND, NO_PARTICLES
from splits.kernels.grains.state import (
    attenuate,
    pore_material,
    refractive_index_of,
    sample_scattering_direction,
)
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import ORIGIN, UP, sample_cosine_lobe
from splits.kernels.optics.interface import orient_horizontal_normal, sample_interface
from splits.kernels.tallies.exits import ABSORBED, ALIVE, REFLECTED, TO_GROUND, TRANSMITTED


@inline_only
def apply_roulette(state, ray):
    """Play all due games of Russian roulette, see `splits.kernels.grains.free_path`."""
    while ray.status == ALIVE and ray.optical_depth > ray.next_roulette:
        result = russian_roulette(ray, uniform(state), True)
        ray = replace(
            ray, weight=result.weight, next_roulette=result.next_roulette,
            status=ABSORBED if result.terminated else ALIVE,
        )  # fmt: skip
    return ray


@inline_only
def enter_layer(state, ray, scene, optics):
    """Let a ray enter its layer from outside, through the interface of the sample.

    The pore is sampled first: the interface of a wet pore may reflect the ray, whose status is then
    `REFLECTED`.
    """
    layers, layer = scene.layers, ray.layer
    pore_variate = uniform(state)
    near = refractive_index_of(optics, layers.first_pore_material[layer])
    far = refractive_index_of(optics, pore_material(layers, layer, pore_variate))
    if not (scene.rules.boundary_fresnel or layers.particle_row[layer] != NO_PARTICLES):
        far = near
    normal = orient_horizontal_normal(ray.direction)
    sample = sample_interface(ray.direction, normal, near, far, uniform(state))
    return replace(
        ray, direction=sample.direction, pore_variate=pore_variate,
        status=ALIVE if sample.transmitted else REFLECTED,
    )  # fmt: skip


@inline_only
def cross_interface(state, ray, scene, optics, path_lengths, crossings):
    """Return a ray after refraction or reflection at the layer boundary on which it is."""
    layers = scene.layers
    next_layer = find_adjacent_layer(ray.layer, ray.direction)
    inside = 0 <= next_layer < layers.collision_coefficient.size
    near = refractive_index_of(optics, pore_material(layers, ray.layer, ray.pore_variate))
    far = refractive_index_of(optics, layers.first_pore_material[ray.layer])
    has_particles = layers.particle_row[ray.layer] != NO_PARTICLES
    if inside:
        far = refractive_index_of(optics, pore_material(layers, next_layer, ray.pore_variate))
        has_particles |= layers.particle_row[next_layer] != NO_PARTICLES
    # `boundary_fresnel` concerns wet pores; the matrix of particles always has an interface.
    if not (scene.rules.boundary_fresnel or has_particles):
        far = near
    normal = orient_horizontal_normal(ray.direction)
    sample = sample_interface(ray.direction, normal, near, far, uniform(state))
    status, layer, pore_variate = ALIVE, ray.layer, ray.pore_variate
    if sample.transmitted and inside:
        record_crossing(ray, next_layer < layer, scene, path_lengths, crossings)
        layer = next_layer
    elif sample.transmitted:
        exit_status = TRANSMITTED if scene.ground_column == NO_GROUND else TO_GROUND
        status = REFLECTED if next_layer < 0 else exit_status
    if layers.particle_row[layer] != NO_PARTICLES:
        # A layer of particles has one medium.  The new variate selects the pore behind it.
        pore_variate = uniform(state)
    return replace(
        ray, status=status, direction=sample.direction, layer=layer, pore_variate=pore_variate
    )


@inline_only
def scatter_at_particle(state, ray, scene):
    """Scatter a ray at a particle, or absorb it."""
    row = scene.layers.particle_row[ray.layer]
    albedo = scene.particles.albedo[row]
    if albedo == 0.0 or (scene.rules.analog and uniform(state) >= albedo):
        return replace(ray, status=ABSORBED)
    if not scene.rules.analog:
        # The loss is the same for all wavelengths, and counts as optical depth for the roulette.
        ray = replace(
            ray, weight=ray.weight * albedo, optical_depth=ray.optical_depth - math.log(albedo)
        )
    direction = sample_scattering_direction(state, scene.particles, row, ray.direction)
    # A new segment starts; its pore matters if the next layer has two kinds of pores.
    return replace(ray, direction=direction, pore_variate=uniform(state))


@inline_only
def collide(state, ray, event, scene, optics, path_lengths):
    """Return a ray after a collision with a particle or a grain."""
    if ray.order == ray.max_order:
        return replace(ray, status=ABSORBED)
    ray = replace(ray, order=ray.order + 1)
    if scene.layers.particle_row[ray.layer] != NO_PARTICLES:
        return scatter_at_particle(state, ray, scene)
    ray = trace_through_grain(state, ray, event, scene, optics, path_lengths)
    return replace(ray, exit_offset=ORIGIN) if scene.rules.point_grains else ray


@inline_only
def reflect_from_ground(state, ray, scene, optics, path_lengths):
    """Return a ray after Lambertian reflection or absorption at the ground.

    If the lower boundary of the sample reflects it, the ray is directed to the ground again.  The
    ground counts as one order of scattering.  Its column of `path_lengths` counts the hits, and its
    absorption coefficient is −ln(albedo), so that a hit is a segment of length 1.
    """
    ray = replace(ray, status=ALIVE)
    ray = attenuate(state, ray, 1.0, scene.ground_column, optics, scene.rules.analog, path_lengths)
    if ray.status != ALIVE:
        # Light that the ground absorbs counts as transmitted.
        return replace(ray, status=TRANSMITTED)
    ray = apply_roulette(state, ray)
    if ray.status != ALIVE or ray.order == ray.max_order:
        return replace(ray, status=ABSORBED)
    direction = sample_cosine_lobe(UP, uniform(state), uniform(state))
    bottom_layer = scene.layers.collision_coefficient.size - 1
    ray = replace(ray, direction=direction, layer=bottom_layer, order=ray.order + 1)
    ray = enter_layer(state, ray, scene, optics)
    return replace(ray, status=ALIVE if ray.status == ALIVE else TO_GROUND)
