"""One trial at a grain's surface in every lane: see `grains.run_surface_pass` for the physics."""

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
    """Draw a lane's random numbers of a trial; lanes that wait keep their place in their stream."""
    choice, fresnel, pore = to_three_uniforms(compute_random_bits(words, i, 0))
    normal, azimuth = choice, Angle(choice, choice)
    drawn = np.uint32(1)
    if faceted is not None:
        # Box & Muller (1958).
        radius, turn, around = to_three_uniforms(compute_random_bits(words, i, 1))
        normal = sqrt(_MINUS_TWO * log(radius)) * sample_half_circle(turn).cos
        azimuth = sample_half_circle(around)
        drawn = np.uint32(2)
    count = words[lane_state.N_DRAWN + i]
    words[lane_state.N_DRAWN + i] = np.uint32(count + drawn) if active else count
    return InteractionVariates(choice, fresnel, pore, normal, azimuth)


@inline_only
def load_relative_index_mixed(state, i, interface, pore_wet):
    """Return the contrast of the media on both sides of a surface, for grains of any type."""
    outward = interface.side < ZERO
    n_dry, k_dry = state[lane_state.INDEX_DRY + i], state[lane_state.EXTINCTION_DRY + i]
    n_wet, k_wet = state[lane_state.INDEX_WET + i], state[lane_state.EXTINCTION_WET + i]
    n_pore = n_wet if pore_wet else n_dry
    k_pore = k_wet if pore_wet else k_dry
    n_outer, k_outer = state[lane_state.INDEX_OUTER + i], state[lane_state.EXTINCTION_OUTER + i]
    n_core, k_core = state[lane_state.INDEX_CORE + i], state[lane_state.EXTINCTION_CORE + i]
    below, in_pore = interface.shell > ONE, interface.shell == ZERO
    n_inner = n_core if below else n_outer
    k_inner = k_core if below else k_outer
    near = ComplexIndex(n_pore if in_pore else n_inner, k_pore if in_pore else k_inner)
    n_next = n_outer if in_pore else n_core
    k_next = k_outer if in_pore else k_core
    n_last = n_outer if below else n_pore
    k_last = k_outer if below else k_pore
    return relative_index(
        near, ComplexIndex(n_last if outward else n_next, k_last if outward else k_next)
    )


@inline_only
def load_relative_index_single_type(state, i, interface, pore_wet, features):
    """Return what `load_relative_index_mixed` does, where all grains are of one type without coatings."""
    outward = interface.side < ZERO
    m_in, c_in = state[lane_state.M_IN_DRY + i], state[lane_state.M1_IN_DRY + i]
    m_out, c_out = state[lane_state.M_OUT_DRY + i], state[lane_state.M1_OUT_DRY + i]
    if features.wet is not None:
        m_in_wet, c_in_wet = state[lane_state.M_IN_WET + i], state[lane_state.M1_IN_WET + i]
        m_out_wet, c_out_wet = state[lane_state.M_OUT_WET + i], state[lane_state.M1_OUT_WET + i]
        m_in = m_in_wet if pore_wet else m_in
        c_in = c_in_wet if pore_wet else c_in
        m_out = m_out_wet if pore_wet else m_out
        c_out = c_out_wet if pore_wet else c_out
    k = ZERO
    if features.absorbing is not None:
        k_in, k_out = state[lane_state.K_IN_DRY + i], state[lane_state.K_OUT_DRY + i]
        if features.wet is not None:
            k_in_wet, k_out_wet = state[lane_state.K_IN_WET + i], state[lane_state.K_OUT_WET + i]
            k_in = k_in_wet if pore_wet else k_in
            k_out = k_out_wet if pore_wet else k_out
        k = k_out if outward else k_in
    m, less_one = (m_out if outward else m_in), (c_out if outward else c_in)
    return RelativeIndex(m, less_one, k, m_in if outward else m_out, False)


@inline_only
def run_surface_step(state, words, i, features, constants):
    """Let a lane try once; return what became of it and the pore on the surface's outer side."""
    status = state[lane_state.STATUS + i]
    active = (status >= lane_state.AT_SURFACE) & (status <= lane_state.IN_TRANSMITTED_LOBE)
    stand = InterfaceState(
        state[lane_state.SHELL + i],
        state[lane_state.SIDE + i],
        status > lane_state.AT_SURFACE,
        status == lane_state.IN_TRANSMITTED_LOBE,
    )
    numbers = draw_interaction_variates(words, i, active, features.faceted)
    d = load_vector(state, lane_state.DIR_X + i)
    grain = Spheroid(
        load_vector(state, lane_state.UNIT_POINT_X + i),
        load_vector(state, lane_state.AXIS_X + i),
        state[lane_state.FLATTENING + i],
        state[lane_state.SEMI_MINOR + i],
    )
    wet = state[lane_state.PORE_WET + i]
    outward = stand.side < ZERO
    facet = make_smooth_facet(d, grain, stand.side)
    if features.faceted is not None:
        facet = sample_microfacet(
            d,
            facet,
            state[lane_state.ROUGHNESS + i],
            numbers,
            stand.in_lobe,
            constants.facet_sampling,
        )
    # A ray that reaches the outermost interface from the inside draws the pore that it may go
    # into, unless it is on its way there in a lobe.
    new_wet = wet
    if features.wet is not None:
        saturation = constants.saturation
        if features.layered is not None:
            saturation = state[lane_state.SATURATION + i]
        drawn_wet = ONE if numbers.u_pore < saturation else ZERO
        new_wet = wet if stand.in_lobe & outward else drawn_wet
    pore_wet = (new_wet if outward else wet) > ZERO
    if features.mixed is not None:
        media = load_relative_index_mixed(state, i, stand, pore_wet)
    else:
        media = load_relative_index_single_type(state, i, stand, pore_wet, features)
    after = reflect_or_refract(
        d, stand, facet, media, numbers.u_fresnel, constants.mirror_wrong_side, features
    )
    after = InteractionResult(
        after.direction,
        after.transmitted,
        active & after.accepted,
        active & after.needs_lobe,
        after.cos_out,
    )
    gone = find_next_region(stand, after, state[lane_state.N_SHELLS + i], features.mixed)
    if features.wet is not None:
        # A ray reflected from the outside draws the pore of its next leg, too.
        keep = gone.in_pore | (after.needs_lobe & outward)
        state[lane_state.PORE_WET + i] = new_wet if keep else wet
        if features.layered is not None:
            pore = state[lane_state.PORE_VARIATE + i]
            state[lane_state.PORE_VARIATE + i] = (
                numbers.u_pore if keep & (not (stand.in_lobe & outward)) else pore
            )
    advance_in_grain(state, i, grain, after, gone, features, constants.point_grains)
    store_vector(state, lane_state.DIR_X + i, select(after.accepted, after.direction, d))
    state[lane_state.SHELL + i] = gone.interface.shell
    state[lane_state.SIDE + i] = gone.interface.side
    next_status = lane_state.IN_FLIGHT if gone.in_pore else lane_state.AT_SURFACE
    next_status = (
        (lane_state.IN_TRANSMITTED_LOBE if after.transmitted else lane_state.IN_REFLECTED_LOBE)
        if after.needs_lobe
        else next_status
    )
    next_status = next_status if active else status
    state[lane_state.STATUS + i] = next_status
    return next_status


@inline_only
def advance_in_grain(state, i, grain, result, region, features, point_grains):
    """Bring a lane's ray through the coating or the core that it now crosses."""
    chord = compute_chord(grain, result.direction)
    leg = chord.length if region.in_core else ZERO
    store_vector(state, lane_state.UNIT_POINT_X + i, select(region.in_core, chord.grain.q, grain.q))
    way, done = load_vector(state, lane_state.EXIT_OFFSET_X + i), scale(leg, result.direction)
    # A direction that is no number, in a lane that waits, must not get into its way.
    more = select(region.in_core & (not point_grains), done, Vector(ZERO, ZERO, ZERO))
    store_vector(
        state, lane_state.EXIT_OFFSET_X + i, Vector(way.x + more.x, way.y + more.y, way.z + more.z)
    )
    state[lane_state.CORE_PATH + i] += leg
    depth = leg * state[lane_state.ABSORPTION_CORE + i]
    if features.mixed is not None:
        coat = compute_coating_path_length(
            state[lane_state.COATING_THICKNESS + i], result, region.in_coating
        )
        state[lane_state.COATING_PATH + i] += coat
        depth += coat * state[lane_state.ABSORPTION_OUTER + i]
    state[lane_state.OPTICAL_DEPTH + i] += depth


@inline_only
def run_surface_stride(state, words, first_lane, features, constants):
    """Do what `run_surface_pass` does for `STRIDE` lanes from `first_lane` on."""
    flying = np.int32(0)
    prefer_512_bit_vectors()
    # What cannot be negative needs no test for an index that counts from the end.
    first_lane &= lane_state.N_LANES - 1
    for j in range(lane_state.STRIDE):
        after = run_surface_step(state, words, first_lane + j, features, constants)
        flying = np.int32(flying + 1) if after == lane_state.IN_FLIGHT else flying
    interleave_loops()
    return flying


@entry_point_no_refcount
def run_surface_pass(state, words, width, features, constants):
    """Advance all lanes that are at a grain's surface by one trial.

    Parameters
    ----------
    state : float32[STATE]
    words : uint32[WORDS]
    width : int
        Lanes in use, from the first on: a multiple of `rows.STRIDE`.
    features, constants : Features, LayerScene
        See `splits.kernels.compiler.features` and `splits.kernels.vectorized.lane_state`.

    Returns
    -------
    flying : int32
        Lanes that now wait for a grain.
    """
    prefer_512_bit_vectors()
    flying = np.int32(0)
    for first in range(0, width, lane_state.STRIDE):
        flying += run_surface_stride(state, words, first, features, constants)
    return flying
