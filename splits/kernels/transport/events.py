"""Events in the history of a ray: roulette, interfaces, particles, grains, and the ground."""

from __future__ import annotations

import math

from splits.kernels.arithmetic import add_scaled, sample_cosine_lobe, scale
from splits.kernels.compiler.jit import inline_only, replace
from splits.kernels.grains.grain_path import (
    attenuate,
    interface_index,
    pore_material,
    trace_through_grain,
)
from splits.kernels.grains.spheroid import FIRST_ROULETTE_DEPTH, RouletteResult, russian_roulette
from splits.kernels.interface import (
    orient_horizontal_normal,
    reflect_only,
    reflect_or_refract_ray,
    sample_scattering,
)
from splits.kernels.rays import compute_position
from splits.kernels.rng import uniform
from splits.kernels.rough_surface.intersection import (
    NO_HIT,
    STEP_LIMIT_REACHED,
    compute_normal_from_slope,
    find_first_intersection,
    nudge_off_surface,
)
from splits.kernels.scattering_matrix import PhaseFunction
from splits.kernels.scene import (
    ABSORBED,
    ALIVE,
    LOST,
    NO_GROUND,
    NO_PARTICLES,
    NO_SEGMENT,
    ORIGIN,
    REFLECTED,
    TO_GROUND,
    TRANSMITTED,
    UP,
)
from splits.kernels.stokes import make_unpolarized
from splits.kernels.transport.flight import (
    NO_EVENT,
    ROUGH_TOP,
    find_adjacent_layer,
    find_next_material,
    record_crossing,
)
from splits.kernels.transport.next_event import score_ground, score_scattering

FIRST_DETECTOR_ROULETTE_DEPTH = -math.log(0.1)
DETECTOR_SURVIVAL_PROBABILITY = 0.3
"""Roulette of rays that score at detectors: optical depth of the first game, and probability of
survival.  Both weights are low: every scattering scores, and rays of low weight hardly do."""


@inline_only
def find_first_roulette(scene):
    """Return the optical depth at which a ray of the source first plays Russian roulette."""
    if scene.rules.analog:
        return math.inf
    return FIRST_ROULETTE_DEPTH if scene.detectors is None else FIRST_DETECTOR_ROULETTE_DEPTH


@inline_only
def apply_roulette(state, ray, detectors):
    """Play all due games of Russian roulette, see `splits.kernels.grains.spheroid`."""
    while ray.status == ALIVE and ray.optical_depth > ray.next_roulette:
        if detectors is None:
            result = russian_roulette(ray, uniform(state), True)
        else:
            result = RouletteResult(
                ray.weight / DETECTOR_SURVIVAL_PROBABILITY,
                ray.next_roulette - math.log(DETECTOR_SURVIVAL_PROBABILITY),
                uniform(state) > DETECTOR_SURVIVAL_PROBABILITY,
            )
        ray = replace(
            ray, weight=result.weight, next_roulette=result.next_roulette,
            status=ABSORBED if result.terminated else ALIVE,
        )  # fmt: skip
    return ray


@inline_only
def sample_pore_variate(state, scene):
    """Sample the random number that selects a pore; layers of particles have one medium."""
    if scene.types is None:
        return 0.0
    return uniform(state)


@inline_only
def has_interface(scene, layer, other):
    """Return whether light is reflected and refracted between a layer and its neighbour.

    `boundary_fresnel` concerns wet pores; the matrix of particles always has an interface.

    Parameters
    ----------
    scene : Scene
    layer, other : int
        The neighbour may be outside the sample, see `flight.find_adjacent_layer`.
    """
    rows = scene.layers.particle_row
    has_particles = rows[layer] != NO_PARTICLES
    if 0 <= other < rows.size:
        has_particles |= rows[other] != NO_PARTICLES
    return scene.rules.boundary_fresnel or has_particles


@inline_only
def enter_layer(state, ray, scene, optics):
    """Let a ray enter its layer from outside, through the interface of the sample.

    The pore is sampled first: the interface of a wet pore may reflect the ray, whose status is then
    `REFLECTED`.
    """
    layers, layer = scene.layers, ray.layer
    pore_variate = sample_pore_variate(state, scene)
    near = interface_index(scene, optics, layers.first_pore_material[layer])
    far = interface_index(scene, optics, pore_material(layers, layer, pore_variate))
    normal = orient_horizontal_normal(ray.direction)
    if not has_interface(scene, layer, find_adjacent_layer(layer, normal)):
        far = near
    if scene.opaque is not None:
        return replace(reflect_from_opaque(ray, normal, near, far), status=REFLECTED)
    sample = reflect_or_refract_ray(state, ray.direction, ray.stokes, normal, near, far)
    return replace(
        ray, direction=sample.direction, stokes=sample.stokes, pore_variate=pore_variate,
        status=ALIVE if sample.transmitted else REFLECTED,
    )  # fmt: skip


@inline_only
def reflect_from_opaque(ray, normal, near, far):
    """Return a ray after reflection at a facet of a layer that absorbs all light that enters."""
    reflected = reflect_only(ray.direction, ray.stokes, normal, near, far)
    return replace(
        ray, direction=reflected.direction, stokes=reflected.stokes,
        weight=ray.weight * reflected.reflectance,
    )  # fmt: skip


@inline_only
def cross_interface(state, ray, scene, optics, path_lengths, crossings):
    """Return a ray after refraction or reflection at the layer boundary on which it is."""
    layers = scene.layers
    next_layer = find_adjacent_layer(ray.layer, ray.direction)
    inside = 0 <= next_layer < layers.collision_coefficient.size
    # A ground that absorbs all light is an exit.
    reflects = scene.ground_column != NO_GROUND or scene.ground_albedo is not None
    exit_status = TO_GROUND if reflects else TRANSMITTED
    if scene.ground_contact is not None and next_layer == layers.collision_coefficient.size:
        return replace(ray, status=exit_status)
    near = interface_index(scene, optics, pore_material(layers, ray.layer, ray.pore_variate))
    behind = find_next_material(layers, ray.layer, next_layer, ray.pore_variate)
    far = interface_index(scene, optics, behind)
    if not has_interface(scene, ray.layer, next_layer):
        far = near
    normal = orient_horizontal_normal(ray.direction)
    sample = reflect_or_refract_ray(state, ray.direction, ray.stokes, normal, near, far)
    status, layer, pore_variate = ALIVE, ray.layer, ray.pore_variate
    if sample.transmitted and inside:
        record_crossing(ray, next_layer < layer, scene, path_lengths, crossings)
        layer = next_layer
    elif sample.transmitted:
        status = REFLECTED if next_layer < 0 else exit_status
    if layers.particle_row[layer] != NO_PARTICLES:
        # A layer of particles has one medium.  The new variate selects the pore behind it.
        pore_variate = sample_pore_variate(state, scene)
    return replace(
        ray, status=status, direction=sample.direction, stokes=sample.stokes, layer=layer,
        pore_variate=pore_variate,
    )  # fmt: skip


@inline_only
def scatter_at_particle(state, ray, scene):
    """Scatter a ray at a particle, or absorb it."""
    row = scene.layers.particle_row[ray.layer]
    albedo = scene.particles.albedo[row]
    if albedo == 0.0 or (scene.rules.analog and uniform(state) >= albedo):
        return replace(ray, status=ABSORBED)
    if not scene.rules.analog:
        # The loss is the same for all wavelengths, and counts as optical depth for the roulette.
        depth = ray.optical_depth + scene.particles.absorption_depth[row]
        ray = replace(ray, weight=ray.weight * albedo, optical_depth=depth)
    particles, size = scene.particles, scene.particles.table_size[row]
    phase = PhaseFunction(
        particles.kind[row], particles.g[row], particles.dipole_fraction[row],
        particles.circular_ratio[row], particles.cosines[row, :size],
        particles.density[row, :size], particles.cdf[row, :size], particles.elements[row, :size],
    )  # fmt: skip
    if scene.detectors is not None:
        score_scattering(state, scene.detectors, scene.layers, phase, ray)
    scattered = sample_scattering(state, phase, ray.direction, ray.stokes)
    # A new segment starts; its pore matters if the next layer has two kinds of pores.
    pore_variate = sample_pore_variate(state, scene)
    return replace(
        ray, direction=scattered.direction, stokes=scattered.stokes, pore_variate=pore_variate
    )


@inline_only
def collide(state, ray, event, scene, optics, path_lengths):
    """Return a ray after a collision with a particle or a grain."""
    if ray.order >= ray.max_order:
        return replace(ray, status=ABSORBED)
    ray = replace(ray, order=ray.order + 1)
    if scene.particles is not None and (
        scene.types is None or scene.layers.particle_row[ray.layer] != NO_PARTICLES
    ):
        return scatter_at_particle(state, ray, scene)
    ray = trace_through_grain(
        state, ray, event.grain_sample, event.entry, scene, optics, path_lengths
    )
    return replace(ray, exit_offset=ORIGIN) if scene.rules.point_grains else ray


@inline_only
def absorb_at_ground(state, ray, scene, optics, path_lengths):
    """Return a ray that hits the ground, `TRANSMITTED` if it is absorbed there.

    The column of the ground in `path_lengths` counts its hits, and its absorption coefficient is
    −ln(albedo), so that a hit is a segment of length 1.
    """
    ray = replace(ray, status=ALIVE)
    if scene.ground_albedo is not None:
        absorbed = uniform(state) >= scene.ground_albedo
        return replace(ray, status=TRANSMITTED if absorbed else ALIVE)
    ray = attenuate(state, ray, 1.0, scene.ground_column, optics, scene.rules.analog, path_lengths)
    # Light that the ground absorbs counts as transmitted.
    return replace(ray, status=ALIVE if ray.status == ALIVE else TRANSMITTED)


@inline_only
def reflect_from_ground(state, ray, scene, optics, path_lengths):
    """Return a ray after Lambertian reflection or absorption at the ground.

    If the lower boundary of the sample reflects it, the ray is directed to the ground again.  The
    ground counts as one order of scattering.
    """
    if scene.detectors is not None and ray.order < ray.max_order:
        score_ground(state, scene, ray)
    ray = absorb_at_ground(state, ray, scene, optics, path_lengths)
    if ray.status != ALIVE:
        return ray
    ray = apply_roulette(state, ray, scene.detectors)
    if ray.status != ALIVE or ray.order >= ray.max_order:
        return replace(ray, status=ABSORBED)
    direction = sample_cosine_lobe(UP, uniform(state), uniform(state))
    bottom_layer = scene.layers.collision_coefficient.size - 1
    ray = replace(
        ray, direction=direction, stokes=make_unpolarized(direction, ray.stokes),
        layer=bottom_layer, order=ray.order + 1,
    )  # fmt: skip
    if scene.ground_contact is not None:
        return ray
    ray = enter_layer(state, ray, scene, optics)
    return replace(ray, status=ALIVE if ray.status == ALIVE else TO_GROUND)


# --------------------------------------------------------------------------------------------------
# Randomly rough surface on top of layers of grains and particles (Budak & Grimailo 2020, 3.2).
#
# Every ray has its own realization of the surface.  In the sample a ray may hit facets on its way
# to the next particle; outside it is traced from facet to facet until it is in the sample again or
# leaves.  A facet is the tangent plane at the point hit.  For a smooth top, `rough_top` is None and
# all of this is compiled away.


@inline_only
def intersect_rough_top(rough_top, ray, event, layer_bottom):
    """Return the event of a ray in the sample, which is a hit of the rough top if that comes first.

    The ray is lost if the search was undecided, or if the surface extends below `layer_bottom` (m),
    see `ParticleLayer.depth_m`.
    """
    if rough_top is None:
        return event
    start, d = compute_position(ray), ray.direction
    is_below = max(start.z, start.z + event.distance * d.z) <= -rough_top.max_height
    if event.kind == NO_EVENT or is_below:
        return event
    hit = find_first_intersection(rough_top, start, d, -1.0, event.distance)
    if hit.distance == NO_HIT:
        return event
    position = add_scaled(hit.distance, d, start)
    lost = hit.distance == STEP_LIMIT_REACHED or position.z < layer_bottom
    return replace(
        event, kind=NO_EVENT if lost else ROUGH_TOP, layer=0, distance=hit.distance,
        position=position, slope=hit.slope,
    )  # fmt: skip


@inline_only
def scatter_at_facet(state, ray, slope, side, scene, optics):
    """Return a ray after reflection or refraction at a facet, and its side of the surface.

    Parameters
    ----------
    state, ray, scene, optics
        See `splits.kernels.transport.history.trace_history`.
    slope : SurfaceSlope
        Slope of the facet.
    side : float
        1 if the ray comes from outside, −1 from the sample.
    """
    # The top layer has particles, and one medium.  The new variate selects the pore behind it.
    pore_variate = sample_pore_variate(state, scene)
    inside = interface_index(scene, optics, pore_material(scene.layers, 0, pore_variate))
    outside = interface_index(scene, optics, scene.layers.first_pore_material[0])
    normal = compute_normal_from_slope(slope)
    if scene.opaque is not None:
        ray = reflect_from_opaque(ray, normal, outside, inside)
    else:
        near = outside if side > 0.0 else inside
        far = inside if side > 0.0 else outside
        sample = reflect_or_refract_ray(
            state, ray.direction, ray.stokes, scale(side, normal), near, far
        )
        ray = replace(ray, direction=sample.direction, stokes=sample.stokes)
        side = -side if sample.transmitted else side
    direction = nudge_off_surface(ray.direction, scale(side, normal))
    ray = replace(ray, direction=direction, layer=0, pore_variate=pore_variate, order=ray.order + 1)
    return ray, side


@inline_only
def trace_above_surface(state, ray, scene, optics, rough_top):
    """Trace a ray above the surface until it enters the sample or leaves.

    Returns
    -------
    Ray
        With the status `ALIVE` in the sample, `REFLECTED`, `LOST`, or `ABSORBED` at the largest
        order of scattering.
    """
    side = 1.0
    while side > 0.0:
        hit = find_first_intersection(rough_top, ray.position, ray.direction, side)
        if hit.distance < 0.0:
            leaves = hit.distance == NO_HIT and ray.direction.z > 0.0
            return replace(ray, status=REFLECTED if leaves else LOST)
        if ray.order >= ray.max_order:
            return replace(ray, status=ABSORBED)
        position = add_scaled(hit.distance, ray.direction, ray.position)
        ray = replace(
            ray, position=position, exit_offset=ORIGIN, previous_segment=NO_SEGMENT,
            start_distance=0.0,
        )  # fmt: skip
        ray, side = scatter_at_facet(state, ray, hit.slope, side, scene, optics)
    return ray


@inline_only
def interact_at_rough_top(state, ray, slope, scene, optics, rough_top):
    """Return a ray from the sample after a hit of the rough top.

    Parameters are those of `scatter_at_facet` and `trace_above_surface`.
    """
    if rough_top is None:
        # Compiles the rest away under a smooth top.
        return ray
    if ray.order >= ray.max_order:
        return replace(ray, status=ABSORBED)
    ray, side = scatter_at_facet(state, ray, slope, -1.0, scene, optics)
    return trace_above_surface(state, ray, scene, optics, rough_top) if side > 0.0 else ray
