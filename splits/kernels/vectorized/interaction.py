"""Surface pass: one interaction at the surface of a grain in every lane at one.

See `splits.kernels.grains.interaction` for the physics.
"""

from __future__ import annotations

import numpy as np

from splits.kernels.compiler.jit import (
    ONE,
    ZERO,
    entry_point_no_refcount,
    float32_constant,
    inline_only,
)
from splits.kernels.grains.interaction import (
    InteractionResult,
    InteractionVariates,
    InterfaceState,
    RelativeIndex,
    compute_coating_path_length,
    find_next_region,
    reflect_or_refract,
    relative_index,
)
from splits.kernels.grains.microfacet import make_smooth_facet, sample_microfacet
from splits.kernels.grains.spheroid import Spheroid, compute_chord
from splits.kernels.math.arithmetic import sqrt
from splits.kernels.math.elementary import Angle, log, sample_half_circle
from splits.kernels.math.vectors import Vector, scale, select
from splits.kernels.optics.interface import ComplexIndex
from splits.kernels.vectorized import lane_state
from splits.kernels.vectorized.intrinsics import interleave_loops, prefer_512_bit_vectors
from splits.kernels.vectorized.lane_rng import compute_random_bits, to_three_uniforms
from splits.kernels.vectorized.lane_state import load_vector, store_vector

_MINUS_TWO = float32_constant(-2.0)


@inline_only
def draw_interaction_variates(words, i, active, faceted):
    """Draw the random numbers of an interaction; only active lanes advance in their streams."""
    u_facet, u_fresnel, u_pore = to_three_uniforms(compute_random_bits(words, i, 0))
    half_normal, azimuth = u_facet, Angle(u_facet, u_facet)
    n_new = np.uint32(1)
    if faceted is not None:
        # Box & Muller (1958).
        radius, u_half_circle, u_azimuth = to_three_uniforms(compute_random_bits(words, i, 1))
        half_normal = sqrt(_MINUS_TWO * log(radius)) * sample_half_circle(u_half_circle).cos
        azimuth = sample_half_circle(u_azimuth)
        n_new = np.uint32(2)
    n_drawn = words[lane_state.N_DRAWN + i]
    words[lane_state.N_DRAWN + i] = np.uint32(n_drawn + n_new) if active else n_drawn
    return InteractionVariates(u_facet, u_fresnel, u_pore, half_normal, azimuth)


@inline_only
def load_relative_index_mixed(state, i, interface, pore_wet):
    """Return the `RelativeIndex` of the media at an interface, for grains of any type."""
    outward = interface.side < ZERO
    n_dry, k_dry = state[lane_state.INDEX_DRY + i], state[lane_state.EXTINCTION_DRY + i]
    n_wet, k_wet = state[lane_state.INDEX_WET + i], state[lane_state.EXTINCTION_WET + i]
    n_pore = n_wet if pore_wet else n_dry
    k_pore = k_wet if pore_wet else k_dry
    n_outer, k_outer = state[lane_state.INDEX_OUTER + i], state[lane_state.EXTINCTION_OUTER + i]
    n_core, k_core = state[lane_state.INDEX_CORE + i], state[lane_state.EXTINCTION_CORE + i]
    in_core, in_pore = interface.shell > ONE, interface.shell == ZERO
    n_inner = n_core if in_core else n_outer
    k_inner = k_core if in_core else k_outer
    near = ComplexIndex(n_pore if in_pore else n_inner, k_pore if in_pore else k_inner)
    n_inward = n_outer if in_pore else n_core
    k_inward = k_outer if in_pore else k_core
    n_outward = n_outer if in_core else n_pore
    k_outward = k_outer if in_core else k_pore
    return relative_index(
        near, ComplexIndex(n_outward if outward else n_inward, k_outward if outward else k_inward)
    )


@inline_only
def load_relative_index_single_type(state, i, interface, pore_wet, features):
    """Return the `RelativeIndex` at an interface, for grains of one type without coatings."""
    outward = interface.side < ZERO
    m_in, m1_in = state[lane_state.M_IN_DRY + i], state[lane_state.M1_IN_DRY + i]
    m_out, m1_out = state[lane_state.M_OUT_DRY + i], state[lane_state.M1_OUT_DRY + i]
    if features.wet is not None:
        m_in_wet, m1_in_wet = state[lane_state.M_IN_WET + i], state[lane_state.M1_IN_WET + i]
        m_out_wet, m1_out_wet = state[lane_state.M_OUT_WET + i], state[lane_state.M1_OUT_WET + i]
        m_in = m_in_wet if pore_wet else m_in
        m1_in = m1_in_wet if pore_wet else m1_in
        m_out = m_out_wet if pore_wet else m_out
        m1_out = m1_out_wet if pore_wet else m1_out
    k = ZERO
    if features.absorbing is not None:
        k_in, k_out = state[lane_state.K_IN_DRY + i], state[lane_state.K_OUT_DRY + i]
        if features.wet is not None:
            k_in_wet, k_out_wet = state[lane_state.K_IN_WET + i], state[lane_state.K_OUT_WET + i]
            k_in = k_in_wet if pore_wet else k_in
            k_out = k_out_wet if pore_wet else k_out
        k = k_out if outward else k_in
    m, m_minus_1 = (m_out if outward else m_in), (m1_out if outward else m1_in)
    return RelativeIndex(m, m_minus_1, k, m_in if outward else m_out, False)


@inline_only
def run_surface_step(state, words, i, features, constants):
    """Sample one interaction of a lane, and return its new status."""
    status = state[lane_state.STATUS + i]
    active = (status >= lane_state.AT_SURFACE) & (status <= lane_state.IN_TRANSMITTED_LOBE)
    interface = InterfaceState(
        state[lane_state.SHELL + i],
        state[lane_state.SIDE + i],
        status > lane_state.AT_SURFACE,
        status == lane_state.IN_TRANSMITTED_LOBE,
    )
    variates = draw_interaction_variates(words, i, active, features.faceted)
    direction = load_vector(state, lane_state.DIR_X + i)
    grain = Spheroid(
        load_vector(state, lane_state.UNIT_POINT_X + i),
        load_vector(state, lane_state.AXIS_X + i),
        state[lane_state.FLATTENING + i],
        state[lane_state.SEMI_MINOR + i],
    )
    wet = state[lane_state.PORE_WET + i]
    outward = interface.side < ZERO
    facet = make_smooth_facet(direction, grain, interface.side)
    if features.faceted is not None:
        facet = sample_microfacet(
            direction,
            facet,
            state[lane_state.ROUGHNESS + i],
            variates,
            interface.in_lobe,
            constants.facet_sampling,
        )
    # At the outermost interface a ray from the inside samples the pore outside, unless it is in a
    # lobe and has done so.
    new_wet = wet
    if features.wet is not None:
        wet_fraction = constants.wet_fraction
        if features.layered is not None:
            wet_fraction = state[lane_state.WET_FRACTION + i]
        drawn_wet = ONE if variates.u_pore < wet_fraction else ZERO
        new_wet = wet if interface.in_lobe & outward else drawn_wet
    pore_wet = (new_wet if outward else wet) > ZERO
    if features.mixed is not None:
        media = load_relative_index_mixed(state, i, interface, pore_wet)
    else:
        media = load_relative_index_single_type(state, i, interface, pore_wet, features)
    result = reflect_or_refract(
        direction,
        interface,
        facet,
        media,
        variates.u_fresnel,
        constants.mirror_wrong_side,
        features,
    )
    result = InteractionResult(
        result.direction,
        result.transmitted,
        active & result.accepted,
        active & result.needs_lobe,
        result.cos_out,
    )
    region = find_next_region(interface, result, state[lane_state.N_SHELLS + i], features.mixed)
    if features.wet is not None:
        # A ray reflected from the outside samples the pore of its next segment, too.
        keep = region.in_pore | (result.needs_lobe & outward)
        state[lane_state.PORE_WET + i] = new_wet if keep else wet
        if features.layered is not None:
            pore = state[lane_state.PORE_VARIATE + i]
            state[lane_state.PORE_VARIATE + i] = (
                variates.u_pore if keep & (not (interface.in_lobe & outward)) else pore
            )
    advance_in_grain(state, i, grain, result, region, features, constants.point_grains)
    store_vector(state, lane_state.DIR_X + i, select(result.accepted, result.direction, direction))
    state[lane_state.SHELL + i] = region.interface.shell
    state[lane_state.SIDE + i] = region.interface.side
    next_status = lane_state.IN_FLIGHT if region.in_pore else lane_state.AT_SURFACE
    next_status = (
        (lane_state.IN_TRANSMITTED_LOBE if result.transmitted else lane_state.IN_REFLECTED_LOBE)
        if result.needs_lobe
        else next_status
    )
    next_status = next_status if active else status
    state[lane_state.STATUS + i] = next_status
    return next_status


@inline_only
def advance_in_grain(state, i, grain, result, region, features, point_grains):
    """Advance the ray of a lane through the coating or the core that it crosses."""
    chord = compute_chord(grain, result.direction)
    length = chord.length if region.in_core else ZERO
    store_vector(state, lane_state.UNIT_POINT_X + i, select(region.in_core, chord.grain.q, grain.q))
    exit_offset, displacement = (
        load_vector(state, lane_state.EXIT_OFFSET_X + i),
        scale(length, result.direction),
    )
    # A NaN direction of an inactive lane must not reach its exit offset.
    step = select(region.in_core & (not point_grains), displacement, Vector(ZERO, ZERO, ZERO))
    store_vector(
        state,
        lane_state.EXIT_OFFSET_X + i,
        Vector(exit_offset.x + step.x, exit_offset.y + step.y, exit_offset.z + step.z),
    )
    state[lane_state.CORE_PATH + i] += length
    depth = length * state[lane_state.ABSORPTION_CORE + i]
    if features.mixed is not None:
        coating_length = compute_coating_path_length(
            state[lane_state.COATING_THICKNESS + i], result, region.in_coating
        )
        state[lane_state.COATING_PATH + i] += coating_length
        depth += coating_length * state[lane_state.ABSORPTION_OUTER + i]
    state[lane_state.OPTICAL_DEPTH + i] += depth


@inline_only
def run_surface_stride(state, words, first_lane, features, constants):
    """Run the surface pass for `STRIDE` lanes from `first_lane` on."""
    n_in_flight = np.int32(0)
    prefer_512_bit_vectors()
    # The mask shows that the index is not negative and needs no wraparound test.
    first_lane &= lane_state.N_LANES - 1
    for j in range(lane_state.STRIDE):
        status = run_surface_step(state, words, first_lane + j, features, constants)
        n_in_flight = np.int32(n_in_flight + 1) if status == lane_state.IN_FLIGHT else n_in_flight
    interleave_loops()
    return n_in_flight


@entry_point_no_refcount
def run_surface_pass(state, words, width, features, constants):
    """Sample one interaction for all lanes at the surface of a grain.

    Parameters
    ----------
    state : float32[STATE_SIZE]
    words : uint32[WORDS_SIZE]
    width : int
        Lanes in use, from the first on: a multiple of `lane_state.STRIDE`.
    features, constants : Features, PassConstants
        See `splits.kernels.compiler.features` and `splits.kernels.vectorized.lane_state`.

    Returns
    -------
    int32
        Number of lanes in flight after the pass.
    """
    prefer_512_bit_vectors()
    n_in_flight = np.int32(0)
    for first_lane in range(0, width, lane_state.STRIDE):
        n_in_flight += run_surface_stride(state, words, first_lane, features, constants)
    return n_in_flight
