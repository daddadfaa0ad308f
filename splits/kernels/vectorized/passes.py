"""Passes over all lanes: flight, sampling of the next grain, and interaction at its surface."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.arithmetic import (
    Angle,
    log,
    sample_circle,
    sample_half_circle,
    scale,
    select,
    sqrt,
)
from splits.kernels.compiler.jit import (
    HALF,
    ONE,
    ZERO,
    entry_point_no_refcount,
    float32_constant,
    inline_only,
    replace,
)
from splits.kernels.grains.grain_path import make_rejection_rules
from splits.kernels.grains.spheroid import (
    MAX_REJECTIONS,
    EntryVariates,
    GrainSize,
    accept_axial_position,
    compute_chord,
    russian_roulette,
    sample_collision,
)
from splits.kernels.grains.surface import (
    InteractionVariates,
    InterfaceState,
    compute_coating_path_length,
    find_next_region,
    make_smooth_facet,
    reflect_or_refract,
    relative_index,
    sample_microfacet,
)
from splits.kernels.scene import WRONG_SIDE_LOBE, Vector
from splits.kernels.vectorized import lanes
from splits.kernels.vectorized.lanes import (
    STRIDE,
    VECTOR_WIDTH,
    Lane,
    compute_random_bits,
    gather_interpolate,
    has_left_layer,
    interleave_loops,
    load_ray,
    move_to_grain,
    prefer_512_bit_vectors,
    store_grain,
    to_three_uniforms,
    to_uniform_31,
    to_uniform_46,
)

# --------------------------------------------------------------------------------------------------
# Sampling of type, size, shape and roughness of the next grain in every lane.

_SHIFT_33 = np.uint64(33)


@inline_only
def compute_quantile_position(u, last_node):
    """Return the position of the probability u in a quantile table, from 0 to `last_node`.

    See `scene.make_table_probabilities`.
    """
    below = u < HALF
    x = sqrt(HALF * (u if below else max(ONE - u, ZERO)))
    return (x if below else ONE - x) * last_node


@inline_only
def draw_variates(state, first_lane, features, last_node):
    """Draw the variates of the next grain for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    for j in range(STRIDE):
        lane = Lane(state, first_lane + j)
        bits = compute_random_bits(lane, 3)
        u_size, u_shape = to_uniform_31(bits >> _SHIFT_33), to_uniform_31(bits)
        lane.quantile_inverse_semi_major = compute_quantile_position(u_size, last_node)
        lane.quantile_flattening = compute_quantile_position(u_shape, last_node)
        bits = compute_random_bits(lane, 4)
        if features.faceted is not None:
            u_roughness = to_uniform_31(bits >> _SHIFT_33)
            lane.quantile_roughness = compute_quantile_position(u_roughness, last_node)
        if features.mixed is not None:
            lane.u_type = to_uniform_31(bits)
            lane.chosen_type = 0 if features.layered is None else lane.first_type
    interleave_loops()


@inline_only
def pick_types(state, first_lane, type_cdf, features):
    """Select the type of the next grain for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    for layer in range(type_cdf.shape[0]):
        layer_number = np.int32(layer)
        for row in range(type_cdf.shape[1] - 1):
            probability = single(type_cdf[layer, row])
            for j in range(STRIDE):
                lane = Lane(state, first_lane + j)
                later = lane.u_type >= probability
                if features.layered is not None:
                    later = later & (lane.layer == layer_number)
                lane.chosen_type += later
    for j in range(STRIDE):
        lane = Lane(state, first_lane + j)
        lane.new_type = select(lane.keep_shape, lane.new_type, lane.chosen_type)


@entry_point_no_refcount
def draw_grain_properties(state, width, features, tables, type_cdf):
    """Draw type, size, shape and roughness of the next grain in every lane.

    After a rejected axial position type and shape are kept, because its probability depends on the
    shape.

    Parameters
    ----------
    state, width, features
        See `run_flight_pass`.
    tables : tuple of 3 float32[rows, m]
        Curvature, flattening and half facetness at the probabilities of
        `scene.make_table_probabilities`.
    type_cdf : float64[layers, types]
        See `splits.kernels.scene.Layers`.
    """
    prefer_512_bit_vectors()
    curvature, flattening, roughness = tables
    last_node = single(curvature.shape[1] - 1)
    for first_lane in range(0, width, STRIDE):
        draw_variates(state, first_lane, features, last_node)
        if features.mixed is not None:
            pick_types(state, first_lane, type_cdf, features)
    for i in range(0, width, VECTOR_WIDTH):
        lane = Lane(state, i)
        gather_interpolate(
            curvature, lane, "new_type", "quantile_inverse_semi_major", "new_inverse_semi_major"
        )
        gather_interpolate(
            flattening, lane, "new_type", "quantile_flattening", "quantile_flattening"
        )
        if features.faceted is not None:
            gather_interpolate(roughness, lane, "new_type", "quantile_roughness", "new_roughness")
    for i in range(width):
        lane = Lane(state, i)
        lane.new_flattening = select(lane.keep_shape, lane.new_flattening, lane.quantile_flattening)


# --------------------------------------------------------------------------------------------------
# Flight pass: roulette and sampling of the next grain, for every lane between grains.
#
# See `splits.kernels.grains.spheroid` for the physics.

_MAX_REJECTIONS = single(MAX_REJECTIONS)
_N_VARIATES = np.uint32(5)


@inline_only
def draw_flight_variates(lane, active):
    """Draw the random numbers of a flight; only active lanes advance in their streams."""
    roulette, cos_incidence, normal_azimuth = to_three_uniforms(compute_random_bits(lane, 0))
    axis_azimuth, axial, accept = to_three_uniforms(compute_random_bits(lane, 1))
    distance = to_uniform_46(compute_random_bits(lane, 2))
    lane.n_drawn = select(active, np.uint32(lane.n_drawn + _N_VARIATES), lane.n_drawn)
    lane.n_segments += active
    azimuths = sample_circle(normal_azimuth), sample_circle(axis_azimuth)
    return roulette, distance, EntryVariates(cos_incidence, *azimuths, axial, accept)


@inline_only
def update_restart(lane, collision, rejected):
    """Set the start of the next sampling attempt; return whether it is in another layer."""
    skipped = rejected & (collision.start_distance == collision.distance)
    other_layer = lane.layer != lane.draw_layer
    repeats = rejected & (not skipped) & (not other_layer)
    start_distance = select(repeats, lane.skip_distance, lane.start_distance)
    lane.skip_distance = select(skipped, collision.distance, lane.skip_distance)
    lane.draw_layer = select(skipped, lane.layer, lane.draw_layer)
    lane.start_distance = select(skipped, collision.distance, start_distance)
    return rejected & (not skipped) & other_layer


@inline_only
def run_flight_step(lane, features, rejection_rules):
    """Sample the next grain of a lane."""
    status = lane.status
    active = status == lanes.IN_FLIGHT
    u_roulette, u_distance, variates = draw_flight_variates(lane, active)
    ray = load_ray(lane)
    result = russian_roulette(ray, u_roulette, active)
    lane.next_roulette, lane.weight = result.next_roulette, result.weight
    layer_geometry = lane.layer_geometry
    # A rejected axial position has precedence over all other results of a sample, so that it does
    # not bias distances, shapes and types.
    size = GrainSize(ONE / lane.new_inverse_semi_major, lane.new_flattening)
    collision = sample_collision(ray, size, variates, u_distance, layer_geometry, rejection_rules)
    axial_ok = accept_axial_position(variates, size.flattening)
    in_flight = active & axial_ok & (not result.terminated)
    relocates = False
    if features.layered is not None:
        relocates = active & (not result.terminated) & has_left_layer(lane, ray, layer_geometry)
        in_flight = in_flight & (not relocates)
    accepted = in_flight & collision.accepted
    next_status = lanes.AT_SURFACE if accepted else lanes.IN_FLIGHT
    next_status = lanes.AT_BOUNDARY if in_flight & collision.leaves_layer else next_status
    if features.layered is not None:
        rejected = in_flight & (not collision.accepted) & (not collision.leaves_layer)
        restarts = update_restart(lane, collision, rejected)
        next_status = lanes.RESTART if restarts else next_status
        next_status = lanes.RELOCATE if relocates else next_status
        lane.segment_attenuated = lane.segment_attenuated & (not accepted)
    else:
        lane.start_distance = select(in_flight, collision.start_distance, ray.start_distance)
    lane.keep_shape = active & (not axial_ok)
    lane.n_rejected = select(active & (not accepted), lane.n_rejected + ONE, ZERO)
    move_to_grain(lane, ray, collision, accepted, features)
    store_grain(lane, collision.entry.grain, accepted, features)
    next_status = lanes.LANE_LOST if lane.n_rejected > _MAX_REJECTIONS else next_status
    absorbed = result.terminated | (accepted & (lane.order >= lane.max_order))
    lane.order += accepted
    next_status = lanes.LANE_ABSORBED if absorbed else next_status
    lane.status = next_status if active else status


@inline_only
def run_flight_stride(state, first_lane, features, rules):
    """Run the flight pass for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    rejection_rules = make_rejection_rules(rules)
    for j in range(STRIDE):
        run_flight_step(Lane(state, first_lane + j), features, rejection_rules)
    interleave_loops()


@entry_point_no_refcount
def run_flight_pass(state, width, features, rules):
    """Sample the next grain for all lanes between grains.

    Parameters
    ----------
    state : uint32[STATE_SIZE]
        Array of `lanes.Lane`.
    width : int
        Lanes in use, from the first on: a multiple of `STRIDE`.
    features, rules : Features, SamplingRules
        See `splits.kernels.scene` and `splits.kernels.scene`.
    """
    prefer_512_bit_vectors()
    for first_lane in range(0, width, STRIDE):
        run_flight_stride(state, first_lane, features, rules)


# --------------------------------------------------------------------------------------------------
# Surface pass: one interaction at the surface of a grain in every lane at one.
#
# See `splits.kernels.grains.surface` for the physics.

_MINUS_TWO = float32_constant(-2.0)


@inline_only
def draw_interaction_variates(lane, active, faceted):
    """Draw the random numbers of an interaction; only active lanes advance in their streams."""
    u_facet, u_fresnel, u_pore = to_three_uniforms(compute_random_bits(lane, 0))
    half_normal, azimuth = u_facet, Angle(u_facet, u_facet)
    n_new = np.uint32(1)
    if faceted is not None:
        # Box & Muller (1958).
        radius, u_half_circle, u_azimuth = to_three_uniforms(compute_random_bits(lane, 1))
        half_normal = sqrt(_MINUS_TWO * log(radius)) * sample_half_circle(u_half_circle).cos
        azimuth = sample_half_circle(u_azimuth)
        n_new = np.uint32(2)
    lane.n_drawn = select(active, np.uint32(lane.n_drawn + n_new), lane.n_drawn)
    return InteractionVariates(u_facet, u_fresnel, u_pore, half_normal, azimuth)


@inline_only
def load_relative_index_mixed(lane, interface, pore_wet):
    """Return the `RelativeIndex` of the media at an interface, for grains of any type."""
    in_core, in_pore = interface.shell > ONE, interface.shell == ZERO
    pore = select(pore_wet, lane.wet, lane.dry).material.refractive_index
    outer, core = lane.outer.refractive_index, lane.core.refractive_index
    near = select(in_pore, pore, select(in_core, core, outer))
    inward, outward = select(in_pore, outer, core), select(in_core, outer, pore)
    return relative_index(near, select(interface.side < ZERO, outward, inward))


@inline_only
def load_relative_index_single_type(lane, interface, pore_wet, features):
    """Return the `RelativeIndex` at an interface, for grains of one type without coatings."""
    outward = interface.side < ZERO
    pore = lane.dry if features.wet is None else select(pore_wet, lane.wet, lane.dry)
    media = select(outward, pore.outward, pore.inward)
    if features.absorbing is None:
        media = replace(media, k=ZERO)
    return media


@inline_only
def select_pore(lane, interface, u_pore, features):
    """Return whether the pore of a ray is wet after an interaction.

    At the outermost interface a ray from the inside samples the pore outside, unless it is in a
    lobe and has done so.
    """
    if features.wet is None:
        return lane.pore_wet
    keeps = interface.in_lobe & (interface.side < ZERO)
    return select(keeps, lane.pore_wet, u_pore < lane.wet_fraction)


@inline_only
def store_pore(lane, interface, result, in_pore, new_wet, u_pore, features):
    """Store the pore of the next segment of a ray, if it is sampled.

    A ray reflected from the outside samples it, too.
    """
    outward = interface.side < ZERO
    sampled = in_pore | (result.needs_lobe & outward)
    lane.pore_wet = select(sampled, new_wet, lane.pore_wet)
    if features.layered is not None:
        drawn = sampled & (not (interface.in_lobe & outward))
        lane.pore_variate = select(drawn, u_pore, lane.pore_variate)


@inline_only
def run_surface_step(lane, features, rules):
    """Sample one interaction of a lane."""
    status, direction, grain = lane.status, lane.direction, lane.grain
    active = (status >= lanes.AT_SURFACE) & (status <= lanes.IN_TRANSMITTED_LOBE)
    interface = InterfaceState(
        lane.shell,
        lane.side,
        status > lanes.AT_SURFACE,
        status == lanes.IN_TRANSMITTED_LOBE,
    )
    variates = draw_interaction_variates(lane, active, features.faceted)
    facet = make_smooth_facet(direction, grain, interface.side)
    if features.faceted is not None:
        facet = sample_microfacet(
            direction, facet, lane.roughness, variates, interface.in_lobe, rules.facet_sampling
        )
    new_wet = select_pore(lane, interface, variates.u_pore, features)
    pore_wet = select(interface.side < ZERO, new_wet, lane.pore_wet)
    if features.mixed is not None:
        media = load_relative_index_mixed(lane, interface, pore_wet)
    else:
        media = load_relative_index_single_type(lane, interface, pore_wet, features)
    result = reflect_or_refract(
        direction, interface, facet, media, variates.u_fresnel, rules.wrong_side != WRONG_SIDE_LOBE,
        features,
    )  # fmt: skip
    result = replace(
        result, accepted=active & result.accepted, needs_lobe=active & result.needs_lobe
    )
    region = find_next_region(interface, result, lane.core_shell, features.mixed)
    if features.wet is not None:
        store_pore(lane, interface, result, region.in_pore, new_wet, variates.u_pore, features)
    advance_in_grain(lane, grain, result, region, features, rules.point_grains)
    lane.direction = select(result.accepted, result.direction, direction)
    lane.shell, lane.side = region.interface.shell, region.interface.side
    next_status = lanes.IN_FLIGHT if region.in_pore else lanes.AT_SURFACE
    lobe = lanes.IN_TRANSMITTED_LOBE if result.transmitted else lanes.IN_REFLECTED_LOBE
    next_status = lobe if result.needs_lobe else next_status
    lane.status = next_status if active else status


@inline_only
def advance_in_grain(lane, grain, result, region, features, point_grains):
    """Advance the ray of a lane through the coating or the core that it crosses."""
    chord = compute_chord(grain, result.direction)
    length = chord.length if region.in_core else ZERO
    lane.grain = select(region.in_core, chord.grain, grain)
    # A NaN direction of an inactive lane must not reach its exit offset.
    step = select(
        region.in_core & (not point_grains),
        scale(length, result.direction),
        Vector(ZERO, ZERO, ZERO),
    )
    offset = lane.exit_offset
    lane.exit_offset = Vector(offset.x + step.x, offset.y + step.y, offset.z + step.z)
    lane.core_path += length
    depth = length * lane.core.absorption
    if features.mixed is not None:
        coating_length = compute_coating_path_length(
            lane.coating_thickness, result, region.in_coating
        )
        lane.coating_path += coating_length
        depth += coating_length * lane.outer.absorption
    lane.optical_depth += depth


@inline_only
def run_surface_stride(state, first_lane, features, rules):
    """Run the surface pass for `STRIDE` lanes from `first_lane` on."""
    prefer_512_bit_vectors()
    for j in range(STRIDE):
        run_surface_step(Lane(state, first_lane + j), features, rules)
    interleave_loops()


@entry_point_no_refcount
def run_surface_pass(state, width, features, rules):
    """Sample one interaction for all lanes at the surface of a grain.

    Parameters
    ----------
    state, width, features, rules
        See `run_flight_pass`.
    """
    prefer_512_bit_vectors()
    for first_lane in range(0, width, STRIDE):
        run_surface_stride(state, first_lane, features, rules)
