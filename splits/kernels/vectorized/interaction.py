"""Surface pass: one interaction at the surface of a grain in every lane at one.

See `splits.kernels.grains.interaction` for the physics.
"""

from __future__ import annotations

import numpy as np

from splits.kernels.base.sampling_rules import WRONG_SIDE_LOBE
from splits.kernels.compiler.jit import (
    ONE,
    ZERO,
    entry_point_no_refcount,
    float32_constant,
    inline_only,
)
from splits.kernels.compiler.replace import replace
from splits.kernels.grains.interaction import (
    InteractionVariates,
    InterfaceState,
    compute_coating_path_length,
    find_next_region,
    reflect_or_refract,
    relative_index,
)
from splits.kernels.grains.microfacet import make_smooth_facet, sample_microfacet
from splits.kernels.grains.spheroid import compute_chord
from splits.kernels.math.arithmetic import sqrt
from splits.kernels.math.elementary import Angle, log, sample_half_circle
from splits.kernels.math.vectors import Vector, scale, select
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.intrinsics import interleave_loops, prefer_512_bit_vectors
from splits.kernels.vectorized.lane_rng import compute_random_bits, to_three_uniforms
from splits.kernels.vectorized.lane_state import STRIDE, Lane

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
    active = (status >= lane_state.AT_SURFACE) & (status <= lane_state.IN_TRANSMITTED_LOBE)
    interface = InterfaceState(
        lane.shell,
        lane.side,
        status > lane_state.AT_SURFACE,
        status == lane_state.IN_TRANSMITTED_LOBE,
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
    next_status = lane_state.IN_FLIGHT if region.in_pore else lane_state.AT_SURFACE
    lobe = lane_state.IN_TRANSMITTED_LOBE if result.transmitted else lane_state.IN_REFLECTED_LOBE
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
        See `flight.run_flight_pass`.
    """
    prefer_512_bit_vectors()
    for first_lane in range(0, width, STRIDE):
        run_surface_stride(state, first_lane, features, rules)
