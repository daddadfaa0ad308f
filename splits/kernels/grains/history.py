"""The scalar kernel: one ray at a time through layers of grains, in double precision.

It repeats the trials of `flight.py` and `surface.py` until a ray is done.  Between their extended
faces layers reach to infinity sideways.  Above them may be a rough surface, below a ground; what
that keeps of a ray's light is noted as the ray meets it.
"""

from __future__ import annotations

import math

import numpy as np

from splits.kernels.compiler.jit import entry_point, inline_only
from splits.kernels.grains.flight import (
    attenuate_segment,
    find_adjacent_layer,
    locate_layer,
    move_to_event,
    record_crossing,
    sample_next_event,
)
from splits.kernels.grains.free_path import (
    FIRST_ROULETTE_DEPTH,
    RayGeometry,
    RouletteState,
    russian_roulette,
)
from splits.kernels.grains.grain_path import trace_through_grain
from splits.kernels.grains.rough_top import (
    interact_at_rough_top,
    intersect_rough_top,
    make_incident_ray,
    stop_at_facet,
    trace_above_surface,
)
from splits.kernels.grains.scene import NO_GROUND, NO_PARTICLES
from splits.kernels.grains.spheroid import Segment
from splits.kernels.grains.state import (
    NO_SEGMENT,
    AttenuationResult,
    EventResult,
    Ray,
    RayPayload,
    attenuate,
    get_layer_geometry,
    pore_material,
    refractive_index_of,
    sample_scattering_direction,
    terminate,
    with_direction,
)
from splits.kernels.grains.weight_window import check_weight_window
from splits.kernels.math.rng import start_stream, uniform
from splits.kernels.math.vectors import ORIGIN, UP, sample_cosine_lobe
from splits.kernels.optics.interface import orient_horizontal_normal, sample_interface
from splits.kernels.optics.source import sample_source_direction
from splits.kernels.rough_surface.intersection import NO_HIT
from splits.kernels.rough_surface.realization import sample_realization_if_rough
from splits.kernels.tallies.crossings import (
    allocate_bank,
    append_crossing,
    copy_into_row,
    encode_crossing,
    ensure_capacity,
    get_recorded,
    has_capacity,
    set_current_ray,
)
from splits.kernels.tallies.exits import (
    ABSORBED,
    ALIVE,
    EXIT_LENGTH,
    LOST,
    REFLECTED,
    TO_GROUND,
    TRANSMITTED,
    BatchResult,
    record_exit,
)


@inline_only
def cross_interface(state, ray, scene, optics, path_lengths, crossings):
    """Return a ray that passes the face at which it stands, or is sent back there."""
    layers, beam = scene.layers, ray.payload
    other = find_adjacent_layer(layers, beam.layer, beam.direction)
    inside = 0 <= other < layers.attenuation.size
    near = refractive_index_of(optics, pore_material(layers, beam.layer, beam.pore_variate))
    far = refractive_index_of(optics, layers.pore[beam.layer])
    matrix = layers.particle_row[beam.layer] != NO_PARTICLES
    if inside:
        far = refractive_index_of(optics, pore_material(layers, other, beam.pore_variate))
        matrix |= layers.particle_row[other] != NO_PARTICLES
    # The reading is about wet pores; what particles lie in has a face in any case.
    if not (scene.rules.boundary_fresnel or matrix):
        far = near
    crossing = sample_interface(
        beam.direction, orient_horizontal_normal(beam.direction), near, far, uniform(state)
    )
    fate, layer, u = ALIVE, beam.layer, beam.pore_variate
    if crossing.transmitted and inside:
        layer = other
        record_crossing(
            crossings, scene, beam.layer, layer < beam.layer, beam.roulette, path_lengths
        )
    elif crossing.transmitted:
        below = TRANSMITTED if scene.ground_column == NO_GROUND else TO_GROUND
        fate = REFLECTED if other < 0 else below
    if layers.particle_row[layer] != NO_PARTICLES:
        # Light that comes from there to pores, now or after another reflection, comes to new ones.
        u = uniform(state)
    beam = RayPayload(crossing.direction, layer, u, beam.roulette)
    return Ray(
        fate,
        with_direction(ray.geometry, beam.direction),
        beam,
        ray.n_segments,
        ray.order,
        ray.max_order,
    )


@inline_only
def scatter_at_particle(state, payload, scene):
    """Return the beam that a particle scatters, if it is not absorbed there."""
    row = scene.layers.particle_row[payload.layer]
    albedo, purse = scene.particles.albedo[row], payload.roulette
    if albedo == 0.0 or (scene.rules.analog and uniform(state) >= albedo):
        return EventResult(False, payload)
    if not scene.rules.analog:
        # Roulette must hear of it; all wavelengths lose as much.
        purse = RouletteState(
            purse.optical_depth - math.log(albedo), purse.next_roulette, purse.weight * albedo
        )
    d = sample_scattering_direction(state, scene.particles, row, payload.direction)
    # Another leg begins; its pore matters in the next layer, if that has two.
    return EventResult(True, RayPayload(d, payload.layer, uniform(state), purse))


@inline_only
def collide(state, ray, event, scene, optics, path_lengths):
    """Return a ray after the particle or the grain that it has met."""
    if ray.order == ray.max_order:
        return terminate(ray, ABSORBED)
    if scene.layers.particle_row[ray.payload.layer] != NO_PARTICLES:
        after = scatter_at_particle(state, ray.payload, scene)
        fate = ALIVE if after.continues else ABSORBED
        flier = with_direction(ray.geometry, after.payload.direction)
        return Ray(fate, flier, after.payload, ray.n_segments, ray.order + 1, ray.max_order)
    walked = trace_through_grain(state, ray.payload, event, scene, optics, path_lengths)
    fate = ALIVE if walked.alive else ABSORBED
    way = ORIGIN if scene.rules.point_grains else walked.displacement
    flier = RayGeometry(
        ray.geometry.position, way, walked.payload.direction, ray.geometry.previous_segment, 0.0
    )
    return Ray(fate, flier, walked.payload, ray.n_segments, ray.order + 1, ray.max_order)


@inline_only
def apply_roulette(state, roulette_state):
    """Let a ray play roulette as often as it is due, see `splits.kernels.grains.free_path`."""
    alive = True
    while alive and roulette_state.optical_depth > roulette_state.next_roulette:
        result = russian_roulette(roulette_state, uniform(state), True)
        roulette_state, alive = result.roulette, not result.terminated
    return AttenuationResult(roulette_state, alive)


@inline_only
def trace_history(state, ray, scene, optics, path_lengths, crossings, window, rough_top):
    """Follow a ray until it leaves the scene or is absorbed, or until its worth wants a decision.

    Parameters
    ----------
    state : uint64[1]
        The ray's random stream.
    ray : Ray
    scene, optics
        See `splits.kernels.grains.scene`.
    path_lengths : float64[materials]
        Path lengths (m), advanced in place.
    crossings : CrossingBank or None
        Taken where rays pass faces between layers; None where nobody listens, at no cost.
    window : WeightWindow or None
        None asks for no decisions, at no cost.
    rough_top : SurfaceRealization or None
        The rough surface on top; None where it is smooth, at no cost.

    Returns
    -------
    Ray
        Its fate `ABSORBED`, `REFLECTED`, `TRANSMITTED`, `TO_GROUND`, `LOST`, or `ALIVE` where the
        window is left, or where there might not be room for the next leg's notes.
    """
    layers = scene.layers
    while ray.status == ALIVE:
        if crossings is not None and not has_capacity(crossings, 2 * layers.boundaries.size):
            break
        payment = apply_roulette(state, ray.payload.roulette)
        if not payment.alive:
            return terminate(ray, ABSORBED)
        beam = RayPayload(
            ray.payload.direction, ray.payload.layer, ray.payload.pore_variate, payment.roulette
        )
        flier, beam = locate_layer(ray.geometry, beam, scene, optics, path_lengths, crossings)
        found = sample_next_event(state, flier, beam, scene, optics)
        arrival = move_to_event(flier, found, get_layer_geometry(layers, found.layer))
        hit = intersect_rough_top(rough_top, flier, found, arrival.previous_segment.length)
        if hit.distance != NO_HIT:
            arrival, found = stop_at_facet(flier, found, hit, layers.boundaries[1])
        ray = Ray(ALIVE, arrival, beam, ray.n_segments + 1, ray.order, ray.max_order)
        if found.lost:
            return terminate(ray, LOST)
        leg = Segment(arrival.position, beam.direction, arrival.previous_segment.length)
        payment = attenuate_segment(state, beam, found, leg, scene, optics, path_lengths, crossings)
        beam = RayPayload(beam.direction, found.layer, beam.pore_variate, payment.roulette)
        ray = Ray(ALIVE, arrival, beam, ray.n_segments, ray.order, ray.max_order)
        if not payment.alive:
            return terminate(ray, ABSORBED)
        if hit.distance != NO_HIT:
            ray = interact_at_rough_top(state, ray, hit.slope, scene, optics, rough_top)
        elif found.collision.leaves_layer:
            ray = cross_interface(state, ray, scene, optics, path_lengths, crossings)
        else:
            ray = collide(state, ray, found, scene, optics, path_lengths)
            if (
                window is not None
                and ray.status == ALIVE
                and check_weight_window(window, ray, layers)
            ):
                break
    return ray


@inline_only
def enter_layer(state, direction, layer, roulette_state, scene, optics):
    """Return the beam of a ray that comes from outside to a layer, if that lets it in.

    Its pore there is drawn first: the boundary of a wet one may reflect it at once.
    """
    layers = scene.layers
    u = uniform(state)
    near, far = (
        refractive_index_of(optics, layers.pore[layer]),
        refractive_index_of(optics, pore_material(layers, layer, u)),
    )
    if not (scene.rules.boundary_fresnel or layers.particle_row[layer] != NO_PARTICLES):
        far = near
    crossing = sample_interface(
        direction, orient_horizontal_normal(direction), near, far, uniform(state)
    )
    return EventResult(
        crossing.transmitted, RayPayload(crossing.direction, layer, u, roulette_state)
    )


@inline_only
def sample_source(state, scene, optics, rough_top, max_order):
    """Start a ray at the top, which may meet so many grains."""
    light = scene.source
    d = sample_source_direction(light, uniform(state) if light.diffuse_fraction > 0.0 else 1.0)
    purse = RouletteState(0.0, math.inf if scene.rules.analog else FIRST_ROULETTE_DEPTH, 1.0)
    if rough_top is not None:
        return trace_above_surface(
            state, make_incident_ray(d, purse, rough_top, max_order), scene, optics, rough_top
        )
    passed, beam = enter_layer(state, d, 0, purse, scene, optics)
    fate = ALIVE if passed else REFLECTED
    return Ray(
        fate, RayGeometry(ORIGIN, ORIGIN, beam.direction, NO_SEGMENT, 0.0), beam, 0, 0, max_order
    )


@inline_only
def reflect_from_ground(state, ray, scene, optics, path_lengths):
    """Return a ray that comes back from the ground by Lambert's law, or stays there.

    One that the sample's lower face sends down again is still below.  Among the grains that it may
    meet the ground counts as one.
    """
    purse, analog = ray.payload.roulette, scene.rules.analog
    payment = attenuate(state, purse, 1.0, scene.ground_column, optics, analog, path_lengths)
    if not payment.alive:
        return terminate(ray, TRANSMITTED)
    payment = apply_roulette(state, payment.roulette)
    if not payment.alive or ray.order == ray.max_order:
        return terminate(ray, ABSORBED)
    d = sample_cosine_lobe(UP, uniform(state), uniform(state))
    lowest = scene.layers.attenuation.size - 1
    passed, beam = enter_layer(state, d, lowest, payment.roulette, scene, optics)
    fate = ALIVE if passed else TO_GROUND
    return Ray(
        fate,
        with_direction(ray.geometry, beam.direction),
        beam,
        ray.n_segments,
        ray.order + 1,
        ray.max_order,
    )


@entry_point
def trace_batch(seed, work, scene, optics, exits, height_fields, surface_buffer):
    """Trace rays and record how they leave.

    Parameters
    ----------
    seed : int
    work : int64[4]
        Ensemble, first ray, number of rays, and grains met after which a ray counts as absorbed.
        Seed, ensemble and number name a ray's random stream: it is the same whoever traces it.
    scene, optics
        See `splits.kernels.grains.scene`.
    exits : float64[rays, columns]
        A row for each ray, see `splits.kernels.tallies.exits`; must come from `exit_rows`.
    height_fields, surface_buffer : HeightFields, SurfaceRealization, or None
        The rough surface on top, of which every ray has a realisation, and where that lives, see
        `waves.ensure_capacity`; None where it is smooth.

    Returns
    -------
    Told
        Its notes are of rays that reach a ground; with `Rules.analog` there are none.
    """
    legs = 0
    length = np.zeros(optics.n.size)
    state = np.zeros(1, dtype=np.uint64)
    notes = allocate_bank(optics.n.size)
    most, faces = 2 * scene.layers.boundaries.size, scene.layers.boundaries.size
    for number in range(work[2]):
        start_stream(state, seed, work[0], work[1] + number)
        set_current_ray(notes, number)
        length[:] = 0.0
        roof = sample_realization_if_rough(state, height_fields, surface_buffer)
        ray = sample_source(state, scene, optics, roof, work[3])
        while ray.status == ALIVE or ray.status == TO_GROUND:
            notes = ensure_capacity(notes, most)
            if ray.status == ALIVE:
                ray = trace_history(state, ray, scene, optics, length, notes, None, roof)
            else:
                if not scene.rules.analog:
                    append_crossing(
                        notes,
                        encode_crossing(faces - 1, False),
                        ray.payload.roulette.weight,
                        length,
                    )
                ray = reflect_from_ground(state, ray, scene, optics, length)
        legs += ray.n_segments
        if ray.status == LOST:
            return BatchResult(legs, True, get_recorded(notes))
        if ray.status != ABSORBED:
            purse = ray.payload.roulette
            record_exit(
                exits[number], ray.status == REFLECTED, ray.geometry.position, ray.payload.direction, purse.weight,
                ray.order,
            )  # fmt: skip
            copy_into_row(exits[number], EXIT_LENGTH, length)
    return BatchResult(legs, False, get_recorded(notes))
