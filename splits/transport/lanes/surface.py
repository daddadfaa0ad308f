"""One trial at a grain's surface in every lane: facet, Fresnel, direction, way through the grain.

The scalar counterpart is `splits.transport.grain`; see there for the physics.
"""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.transport import facets
from splits.transport.arithmetic import fused, reciprocal_root, root
from splits.transport.elementary import half_circle, logarithm
from splits.transport.facets import facet_normal, projected_choice
from splits.transport.frames import dot, mirrored, normalized
from splits.transport.fresnel import fraction, normal_component
from splits.transport.jit import HALF, ONE, TWO, ZERO, entry, kernel
from splits.transport.lanes.numbers import three, word
from splits.transport.lanes.rows import (
    A_CORE,
    A_OUTER,
    C_IN_DRY,
    C_IN_WET,
    C_OUT_DRY,
    C_OUT_WET,
    COAT_PATH,
    CORE_PATH,
    COUNT,
    DEPTH,
    DX,
    DY,
    DZ,
    FLATTENING,
    FLYING,
    GX,
    GY,
    GZ,
    K_CORE,
    K_IN_DRY,
    K_IN_WET,
    K_OUT_WET,
    K_OUTER,
    K_WET,
    LANES,
    LAYER,
    LAYERS,
    LOBE_BACK,
    LOBE_THROUGH,
    M_IN_DRY,
    M_IN_WET,
    M_OUT_DRY,
    M_OUT_WET,
    MINOR,
    N_CORE,
    N_DRY,
    N_OUTER,
    N_WET,
    QX,
    QY,
    QZ,
    SIDE,
    SIGMA,
    STATUS,
    STRIDE,
    THICKNESS,
    TRIAL,
    WET,
    WX,
    WY,
    WZ,
)  # fmt: skip
from splits.transport.lanes.vectors import two_at_a_time, widest_vectors
from splits.transport.spheroid import across, normal_at

_GRAZING = single(1e-6)
_NORMAL2 = single(1e-8)
"""Least sin² of incidence for which facets are turned exactly; met by 1e-8 of all trials."""
_MINUS_TWO = single(-2.0)


@kernel
def leaning(sigma, u1, u2):
    """Return |ξ| of `facets.lean`, by Box & Muller (1958); to be refused from 1 on."""
    _, cosine = half_circle(u2)
    return sigma * root(_MINUS_TWO * logarithm(u1)) * cosine


@kernel
def any_choice(c, s, cos_azimuth, cos_i, sin_i, u, rule):
    """Return what `facets.projected_choice` does, for the other two rules."""
    cos_azimuth = -cos_azimuth if u < HALF else cos_azimuth
    cos_facet = fused(c, cos_i, s * sin_i * cos_azimuth)
    return (cos_facet > ZERO) | ((rule == facets.ANY) & (cos_facet < ZERO)), cos_azimuth, cos_facet


@kernel
def trials(state, words, first, features, scene):
    """Do what `surface` does for `STRIDE` lanes from `first` on."""
    flying = np.int32(0)
    widest_vectors()
    # What cannot be negative needs no test for an index that counts from the end.
    first &= LANES - 1
    for j in range(STRIDE):
        i = first + j
        status = state[STATUS + i]
        active = (status >= TRIAL) & (status <= LOBE_THROUGH)
        lobe = status > TRIAL
        u_choice, u_fresnel, u_wet = three(word(words, i, 0))
        drawn = np.uint32(1)
        if features.faceted is not None:
            u1, u2, u_azimuth = three(word(words, i, 1))
            drawn = np.uint32(2)
        count = words[COUNT + i]
        words[COUNT + i] = np.uint32(count + drawn) if active else count

        dx, dy, dz = state[DX + i], state[DY + i], state[DZ + i]
        qx, qy, qz = state[QX + i], state[QY + i], state[QZ + i]
        wx, wy, wz = state[WX + i], state[WY + i], state[WZ + i]
        flattening = state[FLATTENING + i]
        minor = state[MINOR + i]
        side = state[SIDE + i]
        wet = state[WET + i]
        outward = side < ZERO
        nx, ny, nz = normal_at(qx, qy, qz, wx, wy, wz, flattening)
        nx *= side
        ny *= side
        nz *= side
        cos_i = max(-dot(dx, dy, dz, nx, ny, nz), _GRAZING)

        accepted = True
        cos_facet = cos_i
        if features.faceted is not None:
            tx = fused(cos_i, nx, dx)
            ty = fused(cos_i, ny, dy)
            tz = fused(cos_i, nz, dz)
            tangential2 = max(dot(tx, ty, tz, tx, ty, tz), _NORMAL2)
            per_sin = reciprocal_root(tangential2)
            sin_i = tangential2 * per_sin
            lean = leaning(state[SIGMA + i], u1, u2)
            c = ONE - lean
            # A lobe's sine takes the same root.
            s = root(max(ONE - u_fresnel if lobe else lean * (TWO - lean), ZERO))
            sin_azimuth, cos_azimuth = half_circle(u_azimuth)
            lobe_azimuth = -cos_azimuth if u_choice < HALF else cos_azimuth
            if features.variant is not None and scene.facets != facets.PROJECTED:
                accepted, cos_azimuth, cos_facet = any_choice(
                    c, s, cos_azimuth, cos_i, sin_i, u_choice, scene.facets
                )
            else:
                accepted, cos_azimuth, cos_facet = projected_choice(
                    c, s, cos_azimuth, cos_i, sin_i, u_choice
                )
            accepted = accepted & (lean < ONE)
            turned = cos_facet < ZERO
            cos_facet = max(abs(cos_facet), _GRAZING)

        # The media on both sides; a ray that reaches the outermost interface from the inside
        # draws the pore that it may go into, unless it is on its way there in a lobe.
        new_wet = wet
        if features.wet is not None:
            drawn_wet = ONE if u_wet < scene.saturation else ZERO
            new_wet = wet if lobe & outward else drawn_wet
        pore_wet = (new_wet if outward else wet) > ZERO
        sin2 = max((ONE - cos_facet) * (ONE + cos_facet), ZERO)
        layer = state[LAYER + i]
        if features.mixed is not None:
            n_dry, n_wet, k_wet = state[N_DRY + i], state[N_WET + i], state[K_WET + i]
            n_pore = n_wet if pore_wet else n_dry
            k_pore = k_wet if pore_wet else ZERO
            n_outer, k_outer = state[N_OUTER + i], state[K_OUTER + i]
            n_core, k_core = state[N_CORE + i], state[K_CORE + i]
            below = layer > ONE
            n_inner = n_core if below else n_outer
            k_inner = k_core if below else k_outer
            n_here = n_pore if layer == ZERO else n_inner
            k_here = k_pore if layer == ZERO else k_inner
            n_next = n_outer if layer == ZERO else n_core
            k_next = k_outer if layer == ZERO else k_core
            n_last = n_outer if below else n_pore
            k_last = k_outer if below else k_pore
            n_there = n_last if outward else n_next
            k_there = k_last if outward else k_next
            same = (n_here == n_there) & (k_here == k_there)
            per_here = ONE / n_here
            m = n_there * per_here
            contrast = (n_there - n_here) * per_here
            k = k_there * per_here
            a, b2 = normal_component(m, contrast, k, cos_facet, True)
            a = cos_facet if same else a
            b2 = ZERO if same else b2
            ratio = ONE if same else reciprocal_root(fused(a, a, sin2))
        else:
            m_in, contrast_in = state[M_IN_DRY + i], state[C_IN_DRY + i]
            m_out, contrast_out = state[M_OUT_DRY + i], state[C_OUT_DRY + i]
            if features.wet is not None:
                m_in_wet, contrast_in_wet = state[M_IN_WET + i], state[C_IN_WET + i]
                m_out_wet, contrast_out_wet = state[M_OUT_WET + i], state[C_OUT_WET + i]
                m_in = m_in_wet if pore_wet else m_in
                contrast_in = contrast_in_wet if pore_wet else contrast_in
                m_out = m_out_wet if pore_wet else m_out
                contrast_out = contrast_out_wet if pore_wet else contrast_out
            m = m_out if outward else m_in
            contrast = contrast_out if outward else contrast_in
            k = ZERO
            if features.absorbing is not None:
                k_in, k_out = state[K_IN_DRY + i], ZERO
                if features.wet is not None:
                    k_in_wet, k_out_wet = state[K_IN_WET + i], state[K_OUT_WET + i]
                    k_in = k_in_wet if pore_wet else k_in
                    k_out = k_out_wet if pore_wet else ZERO
                k = k_out if outward else k_in
                a, b2 = normal_component(m, contrast, k, cos_facet, True)
                ratio = reciprocal_root(fused(a, a, sin2))
            else:
                a, b2 = normal_component(m, contrast, k, cos_facet, False)
                ratio = m_in if outward else m_out
        numerator, denominator = fraction(m, contrast, k, cos_facet, sin2, a, b2)
        reflected = (u_fresnel * denominator < numerator) | (a == ZERO)
        if features.mixed is not None:
            reflected = reflected & (not same)
        passed = not reflected

        # Both outcomes are g d + h n' for a facet of normal n'; a lobe is n' alone.
        g = ONE if reflected else ratio
        h = TWO * cos_facet if reflected else ratio * (cos_facet - a)
        if features.faceted is not None:
            if features.variant is not None:
                h = -h if turned else h
            g = ZERO if lobe else g
            h = ONE if lobe else h
            passed = (status == LOBE_THROUGH) if lobe else passed
            cos_lobe = root(u_fresnel)
            c = (-cos_lobe if passed else cos_lobe) if lobe else c
            cos_azimuth = lobe_azimuth if lobe else cos_azimuth
            mx, my, mz = facet_normal(
                dx, dy, dz, nx, ny, nz, cos_i, per_sin, c, s, cos_azimuth, sin_azimuth
            )
        else:
            mx, my, mz = nx, ny, nz
        # Normals come out shorter than 1 by 1e-8 on average.  Left so, rays in smooth spheres, in
        # which all reflections are alike, would creep into total reflection and stay for ever;
        # what creep remains leads out.
        h = fused(h, ONE - dot(mx, my, mz, mx, my, mz), h)
        ex, ey, ez = normalized(fused(g, dx, h * mx), fused(g, dy, h * my), fused(g, dz, h * mz))
        out = dot(ex, ey, ez, nx, ny, nz)
        right = True
        if features.faceted is not None:
            right = (out < ZERO) if passed else (out > ZERO)
            if features.variant is not None:
                rx, ry, rz = mirrored(ex, ey, ez, nx, ny, nz)
                turn = scene.mirrored & (not right)
                ex = rx if turn else ex
                ey = ry if turn else ey
                ez = rz if turn else ez
                right = right | scene.mirrored
        done = active & (lobe | (accepted & right))
        to_lobe = active & (not lobe) & accepted & (not right)

        # Where the ray now is, and its way there.
        new_layer = layer + side if passed else layer
        new_side = side if passed else -side
        exited = new_layer == ZERO
        chord, px, py, pz = across(qx, qy, qz, ex, ey, ez, wx, wy, wz, flattening)
        leg = chord * minor
        if features.mixed is not None:
            in_core = new_layer == state[LAYERS + i]
            new_side = -ONE if in_core else new_side
            film = state[THICKNESS + i] / max(abs(out), _GRAZING)
            film = film if done & (not exited) & (not in_core) else ZERO
            state[COAT_PATH + i] += film
            through = done & in_core
            film_depth = film * state[A_OUTER + i]
        else:
            new_side = -ONE
            through = done & (not exited)
            film_depth = ZERO
        core_depth = state[A_CORE + i]
        leg = leg if through else ZERO
        wx_ = leg * ex if through else ZERO
        wy_ = leg * ey if through else ZERO
        wz_ = leg * ez if through else ZERO
        state[CORE_PATH + i] += leg
        state[DEPTH + i] += leg * core_depth + film_depth
        state[GX + i] += wx_
        state[GY + i] += wy_
        state[GZ + i] += wz_
        state[QX + i] = px if through else qx
        state[QY + i] = py if through else qy
        state[QZ + i] = pz if through else qz
        state[DX + i] = ex if done else dx
        state[DY + i] = ey if done else dy
        state[DZ + i] = ez if done else dz
        state[LAYER + i] = new_layer if done else layer
        state[SIDE + i] = new_side if done else side
        if features.wet is not None:
            # A ray reflected from the outside draws the pore of its next leg, too.
            keep = done & exited | (to_lobe & outward)
            state[WET + i] = new_wet if keep else wet
        after = FLYING if done & exited else TRIAL
        after = (LOBE_THROUGH if passed else LOBE_BACK) if to_lobe else after
        after = after if active else status
        state[STATUS + i] = after
        flying = np.int32(flying + 1) if after == FLYING else flying
    two_at_a_time()
    return flying


@entry
def surface(state, words, width, features, scene):
    """Advance all lanes that are at a grain's surface by one trial.

    Parameters
    ----------
    state : float32[STATE]
    words : uint32[WORDS]
    width : int
        Lanes in use, from the first on: a multiple of `rows.STRIDE`.
    features, scene : Features, Scene
        See `splits.transport.lanes.rows`.

    Returns
    -------
    flying : int32
        Lanes that now wait for a grain.
    """
    widest_vectors()
    flying = np.int32(0)
    for first in range(0, width, STRIDE):
        flying += trials(state, words, first, features, scene)
    return flying
