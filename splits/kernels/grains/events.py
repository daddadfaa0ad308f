"""Events in the history of a ray: roulette, interfaces, particles, grains, and the ground."""

from __future__ import annotations

import math

from splits.kernels.compiler.jit import inline_only
from splits.kernels.grains.flight import find_adjacent_layer, record_crossing
from splits.kernels.grains.free_path import RayGeometry, RouletteState, russian_roulette
from splits.kernels.grains.grain_path import trace_through_grain
from splits.kernels.grains.scene import NO_GROUND, NO_PARTICLES
from splits.kernels.grains.state import (
    AttenuationResult,
    EventResult,
    Ray,
    RayPayload,
    attenuate,
    pore_material,
    refractive_index_of,
    sample_scattering_direction,
    terminate,
    with_direction,
)
from splits.kernels.math.rng import uniform
from splits.kernels.math.vectors import ORIGIN, UP, sample_cosine_lobe
from splits.kernels.optics.interface import orient_horizontal_normal, sample_interface
from splits.kernels.tallies.exits import ABSORBED, ALIVE, REFLECTED, TO_GROUND, TRANSMITTED


@inline_only
def apply_roulette(state, roulette_state):
    """Play all due games of Russian roulette, see `splits.kernels.grains.free_path`."""
    alive = True
    while alive and roulette_state.optical_depth > roulette_state.next_roulette:
        result = russian_roulette(roulette_state, uniform(state), True)
        roulette_state, alive = result.roulette, not result.terminated
    return AttenuationResult(roulette_state, alive)


@inline_only
def enter_layer(state, direction, layer, roulette_state, scene, optics):
    """Let a ray enter a layer from outside, through the interface of the sample.

    The pore is sampled first: the interface of a wet pore may reflect the ray.
    """
    layers = scene.layers
    pore_variate = uniform(state)
    near, far = (
        refractive_index_of(optics, layers.first_pore_material[layer]),
        refractive_index_of(optics, pore_material(layers, layer, pore_variate)),
    )
    if not (scene.rules.boundary_fresnel or layers.particle_row[layer] != NO_PARTICLES):
        far = near
    sample = sample_interface(
        direction, orient_horizontal_normal(direction), near, far, uniform(state)
    )
    return EventResult(
        sample.transmitted, RayPayload(sample.direction, layer, pore_variate, roulette_state)
    )


@inline_only
def cross_interface(state, ray, scene, optics, path_lengths, crossings):
    """Return a ray after refraction or reflection at the layer boundary on which it is."""
    layers, payload = scene.layers, ray.payload
    next_layer = find_adjacent_layer(layers, payload.layer, payload.direction)
    inside = 0 <= next_layer < layers.collision_coefficient.size
    near = refractive_index_of(optics, pore_material(layers, payload.layer, payload.pore_variate))
    far = refractive_index_of(optics, layers.first_pore_material[payload.layer])
    has_particles = layers.particle_row[payload.layer] != NO_PARTICLES
    if inside:
        far = refractive_index_of(optics, pore_material(layers, next_layer, payload.pore_variate))
        has_particles |= layers.particle_row[next_layer] != NO_PARTICLES
    # `boundary_fresnel` concerns wet pores; the matrix of particles always has an interface.
    if not (scene.rules.boundary_fresnel or has_particles):
        far = near
    sample = sample_interface(
        payload.direction, orient_horizontal_normal(payload.direction), near, far, uniform(state)
    )
    status, layer, pore_variate = ALIVE, payload.layer, payload.pore_variate
    if sample.transmitted and inside:
        layer = next_layer
        record_crossing(
            crossings, scene, payload.layer, layer < payload.layer, payload.roulette, path_lengths
        )
    elif sample.transmitted:
        exit_status = TRANSMITTED if scene.ground_column == NO_GROUND else TO_GROUND
        status = REFLECTED if next_layer < 0 else exit_status
    if layers.particle_row[layer] != NO_PARTICLES:
        # A layer of particles has one medium.  The new variate selects the pore behind it.
        pore_variate = uniform(state)
    payload = RayPayload(sample.direction, layer, pore_variate, payload.roulette)
    return Ray(
        status,
        with_direction(ray.geometry, payload.direction),
        payload,
        ray.n_segments,
        ray.order,
        ray.max_order,
    )


@inline_only
def scatter_at_particle(state, payload, scene):
    """Scatter a ray at a particle, or absorb it."""
    row = scene.layers.particle_row[payload.layer]
    albedo, roulette_state = scene.particles.albedo[row], payload.roulette
    if albedo == 0.0 or (scene.rules.analog and uniform(state) >= albedo):
        return EventResult(False, payload)
    if not scene.rules.analog:
        # The loss is the same for all wavelengths, and counts as optical depth for the roulette.
        roulette_state = RouletteState(
            roulette_state.optical_depth - math.log(albedo),
            roulette_state.next_roulette,
            roulette_state.weight * albedo,
        )
    direction = sample_scattering_direction(state, scene.particles, row, payload.direction)
    # A new segment starts; its pore matters if the next layer has two kinds of pores.
    return EventResult(True, RayPayload(direction, payload.layer, uniform(state), roulette_state))


@inline_only
def collide(state, ray, event, scene, optics, path_lengths):
    """Return a ray after a collision with a particle or a grain."""
    if ray.order == ray.max_order:
        return terminate(ray, ABSORBED)
    if scene.layers.particle_row[ray.payload.layer] != NO_PARTICLES:
        result = scatter_at_particle(state, ray.payload, scene)
        status = ALIVE if result.continues else ABSORBED
        geometry = with_direction(ray.geometry, result.payload.direction)
        return Ray(status, geometry, result.payload, ray.n_segments, ray.order + 1, ray.max_order)
    transit = trace_through_grain(state, ray.payload, event, scene, optics, path_lengths)
    status = ALIVE if transit.alive else ABSORBED
    exit_offset = ORIGIN if scene.rules.point_grains else transit.displacement
    geometry = RayGeometry(
        ray.geometry.position,
        exit_offset,
        transit.payload.direction,
        ray.geometry.previous_segment,
        0.0,
    )
    return Ray(status, geometry, transit.payload, ray.n_segments, ray.order + 1, ray.max_order)


@inline_only
def reflect_from_ground(state, ray, scene, optics, path_lengths):
    """Return a ray after Lambertian reflection or absorption at the ground.

    If the lower boundary of the sample reflects it, the ray is directed to the ground again.  The
    ground counts as one order of scattering.  Its column of `path_lengths` counts the hits, and its
    absorption coefficient is −ln(albedo), so that a hit is a segment of length 1.
    """
    roulette_state, analog = ray.payload.roulette, scene.rules.analog
    attenuation = attenuate(
        state, roulette_state, 1.0, scene.ground_column, optics, analog, path_lengths
    )
    if not attenuation.alive:
        # Light that the ground absorbs counts as transmitted.
        return terminate(ray, TRANSMITTED)
    survival = apply_roulette(state, attenuation.roulette)
    if not survival.alive or ray.order == ray.max_order:
        return terminate(ray, ABSORBED)
    direction = sample_cosine_lobe(UP, uniform(state), uniform(state))
    bottom_layer = scene.layers.collision_coefficient.size - 1
    entered, payload = enter_layer(state, direction, bottom_layer, survival.roulette, scene, optics)
    status = ALIVE if entered else TO_GROUND
    return Ray(
        status,
        with_direction(ray.geometry, payload.direction),
        payload,
        ray.n_segments,
        ray.order + 1,
        ray.max_order,
    )
