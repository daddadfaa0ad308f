"""One trial at a grain's surface in every lane: see `grains.surface` for the physics."""

from __future__ import annotations

import numpy as np

from splits.transport.compiling.jit import ONE, ZERO, borrower, exact, part
from splits.transport.grains.facets import facing, rough
from splits.transport.grains.spheroid import Spheroid, across
from splits.transport.grains.surface import (
    Contrast,
    Numbers,
    Outcome,
    Stand,
    contrast,
    film,
    goings,
    outcome,
)
from splits.transport.lanes import rows
from splits.transport.lanes.numbers import three, word
from splits.transport.lanes.rows import put, vector
from splits.transport.lanes.vectors import two_at_a_time, widest_vectors
from splits.transport.numerics.arithmetic import root
from splits.transport.numerics.elementary import Angle, half_circle, logarithm
from splits.transport.numerics.vectors import Vector, chosen, scaled
from splits.transport.optics.faces import Index

_MINUS_TWO = exact(-2.0)


@part
def numbers_at(words, i, active, faceted):
    """Draw a lane's random numbers of a trial; lanes that wait keep their place in their stream."""
    choice, fresnel, pore = three(word(words, i, 0))
    normal, azimuth = choice, Angle(choice, choice)
    drawn = np.uint32(1)
    if faceted is not None:
        # Box & Muller (1958).
        radius, turn, around = three(word(words, i, 1))
        normal = root(_MINUS_TWO * logarithm(radius)) * half_circle(turn).cos
        azimuth = half_circle(around)
        drawn = np.uint32(2)
    count = words[rows.COUNT + i]
    words[rows.COUNT + i] = np.uint32(count + drawn) if active else count
    return Numbers(choice, fresnel, pore, normal, azimuth)


@part
def mixed_media(state, i, interface, pore_wet):
    """Return the contrast of the media on both sides of a surface, for grains of any type."""
    outward = interface.side < ZERO
    n_dry, k_dry = state[rows.N_DRY + i], state[rows.K_DRY + i]
    n_wet, k_wet = state[rows.N_WET + i], state[rows.K_WET + i]
    n_pore = n_wet if pore_wet else n_dry
    k_pore = k_wet if pore_wet else k_dry
    n_outer, k_outer = state[rows.N_OUTER + i], state[rows.K_OUTER + i]
    n_core, k_core = state[rows.N_CORE + i], state[rows.K_CORE + i]
    below, in_pore = interface.shell > ONE, interface.shell == ZERO
    n_inner = n_core if below else n_outer
    k_inner = k_core if below else k_outer
    near = Index(n_pore if in_pore else n_inner, k_pore if in_pore else k_inner)
    n_next = n_outer if in_pore else n_core
    k_next = k_outer if in_pore else k_core
    n_last = n_outer if below else n_pore
    k_last = k_outer if below else k_pore
    return contrast(near, Index(n_last if outward else n_next, k_last if outward else k_next))


@part
def plain_media(state, i, interface, pore_wet, features):
    """Return what `mixed_media` does, where all grains are of one type without coatings."""
    outward = interface.side < ZERO
    m_in, c_in = state[rows.M_IN_DRY + i], state[rows.C_IN_DRY + i]
    m_out, c_out = state[rows.M_OUT_DRY + i], state[rows.C_OUT_DRY + i]
    if features.wet is not None:
        m_in_wet, c_in_wet = state[rows.M_IN_WET + i], state[rows.C_IN_WET + i]
        m_out_wet, c_out_wet = state[rows.M_OUT_WET + i], state[rows.C_OUT_WET + i]
        m_in = m_in_wet if pore_wet else m_in
        c_in = c_in_wet if pore_wet else c_in
        m_out = m_out_wet if pore_wet else m_out
        c_out = c_out_wet if pore_wet else c_out
    k = ZERO
    if features.absorbing is not None:
        k_in, k_out = state[rows.K_IN_DRY + i], state[rows.K_OUT_DRY + i]
        if features.wet is not None:
            k_in_wet, k_out_wet = state[rows.K_IN_WET + i], state[rows.K_OUT_WET + i]
            k_in = k_in_wet if pore_wet else k_in
            k_out = k_out_wet if pore_wet else k_out
        k = k_out if outward else k_in
    m, less_one = (m_out if outward else m_in), (c_out if outward else c_in)
    return Contrast(m, less_one, k, m_in if outward else m_out, False)


@part
def trial(state, words, i, features, constants):
    """Let a lane try once; return what became of it and the pore on the surface's outer side."""
    status = state[rows.STATUS + i]
    active = (status >= rows.TRIAL) & (status <= rows.LOBE_THROUGH)
    stand = Stand(
        state[rows.SHELL + i],
        state[rows.SIDE + i],
        status > rows.TRIAL,
        status == rows.LOBE_THROUGH,
    )
    numbers = numbers_at(words, i, active, features.faceted)
    d = vector(state, rows.DX + i)
    grain = Spheroid(
        vector(state, rows.QX + i),
        vector(state, rows.WX + i),
        state[rows.FLATTENING + i],
        state[rows.MINOR + i],
    )
    wet = state[rows.WET + i]
    outward = stand.side < ZERO
    facet = facing(d, grain, stand.side)
    if features.faceted is not None:
        facet = rough(d, facet, state[rows.SIGMA + i], numbers, stand.in_lobe, constants.facet_sampling)
    # A ray that reaches the outermost interface from the inside draws the pore that it may go
    # into, unless it is on its way there in a lobe.
    new_wet = wet
    if features.wet is not None:
        saturation = constants.saturation
        if features.layered is not None:
            saturation = state[rows.SATURATION + i]
        drawn_wet = ONE if numbers.u_pore < saturation else ZERO
        new_wet = wet if stand.in_lobe & outward else drawn_wet
    pore_wet = (new_wet if outward else wet) > ZERO
    if features.mixed is not None:
        media = mixed_media(state, i, stand, pore_wet)
    else:
        media = plain_media(state, i, stand, pore_wet, features)
    after = outcome(d, stand, facet, media, numbers.u_fresnel, constants.mirror_wrong_side, features)
    after = Outcome(after.direction, after.transmitted, active & after.accepted, active & after.needs_lobe, after.cos_out)
    gone = goings(stand, after, state[rows.SHELLS + i], features.mixed)
    if features.wet is not None:
        # A ray reflected from the outside draws the pore of its next leg, too.
        keep = gone.in_pore | (after.needs_lobe & outward)
        state[rows.WET + i] = new_wet if keep else wet
        if features.layered is not None:
            pore = state[rows.PORE + i]
            state[rows.PORE + i] = numbers.u_pore if keep & (not (stand.in_lobe & outward)) else pore
    move(state, i, grain, after, gone, features, constants.point_grains)
    put(state, rows.DX + i, chosen(after.accepted, after.direction, d))
    state[rows.SHELL + i] = gone.interface.shell
    state[rows.SIDE + i] = gone.interface.side
    next_status = rows.FLYING if gone.in_pore else rows.TRIAL
    next_status = (
        (rows.LOBE_THROUGH if after.transmitted else rows.LOBE_BACK) if after.needs_lobe else next_status
    )
    next_status = next_status if active else status
    state[rows.STATUS + i] = next_status
    return next_status


@part
def move(state, i, grain, result, region, features, point_grains):
    """Bring a lane's ray through the coating or the core that it now crosses."""
    chord = across(grain, result.direction)
    leg = chord.length if region.in_core else ZERO
    put(state, rows.QX + i, chosen(region.in_core, chord.grain.q, grain.q))
    way, done = vector(state, rows.GX + i), scaled(leg, result.direction)
    # A direction that is no number, in a lane that waits, must not get into its way.
    more = chosen(region.in_core & (not point_grains), done, Vector(ZERO, ZERO, ZERO))
    put(state, rows.GX + i, Vector(way.x + more.x, way.y + more.y, way.z + more.z))
    state[rows.CORE_PATH + i] += leg
    depth = leg * state[rows.A_CORE + i]
    if features.mixed is not None:
        coat = film(state[rows.THICKNESS + i], result, region.in_coating)
        state[rows.COAT_PATH + i] += coat
        depth += coat * state[rows.A_OUTER + i]
    state[rows.DEPTH + i] += depth


@part
def trials(state, words, first_lane, features, constants):
    """Do what `surface` does for `STRIDE` lanes from `first` on."""
    flying = np.int32(0)
    widest_vectors()
    # What cannot be negative needs no test for an index that counts from the end.
    first_lane &= rows.LANES - 1
    for j in range(rows.STRIDE):
        after = trial(state, words, first_lane + j, features, constants)
        flying = np.int32(flying + 1) if after == rows.FLYING else flying
    two_at_a_time()
    return flying


@borrower
def surface(state, words, width, features, constants):
    """Advance all lanes that are at a grain's surface by one trial.

    Parameters
    ----------
    state : float32[STATE]
    words : uint32[WORDS]
    width : int
        Lanes in use, from the first on: a multiple of `rows.STRIDE`.
    features, scene : Features, Scene
        See `splits.transport.compiling.features` and `splits.transport.lanes.rows`.

    Returns
    -------
    flying : int32
        Lanes that now wait for a grain.
    """
    widest_vectors()
    flying = np.int32(0)
    for first in range(0, width, rows.STRIDE):
        flying += trials(state, words, first, features, constants)
    return flying
