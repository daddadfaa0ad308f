"""Optical constants of lanes, in their layer and at their grain."""

from __future__ import annotations

from numpy import float32 as single

from splits.kernels.compiler.jit import ONE, inline_only
from splits.kernels.optics.interface import ComplexIndex
from splits.kernels.vectorized import lane_state


@inline_only
def refractive_index_of(optics, item, material):
    """Return the complex refractive index of a material for a work item."""
    return ComplexIndex(optics.n[item, material], optics.k[item, material])


@inline_only
def set_layer_optics(state, lane, scene, optics, item):
    """Set the optical constants of a lane in its layer.

    The core is that of the first grain type; in mixed scenes `set_grain_optics` replaces it.
    """
    layers, types = scene.layers, scene.types
    layer = int(state[lane_state.LAYER + lane])
    state[lane_state.LAYER_TOP + lane], state[lane_state.LAYER_BOTTOM + lane] = (
        layers.boundaries[layer],
        layers.boundaries[layer + 1],
    )
    state[lane_state.MEAN_FREE_PATH + lane] = 1.0 / layers.collision_coefficient[layer]
    state[lane_state.WET_FRACTION + lane] = layers.wet_fraction[layer]
    state[lane_state.FIRST_TYPE + lane] = layers.first_type[layer]
    grain_type, pore = layers.first_type[layer], layers.first_pore_material[layer]
    core = types.material[grain_type, types.n_shells[grain_type] - 1]
    dry, wet = refractive_index_of(optics, item, pore), refractive_index_of(optics, item, pore + 1)
    core_index = refractive_index_of(optics, item, core)
    state[lane_state.INDEX_DRY + lane] = single(dry.n)
    state[lane_state.EXTINCTION_DRY + lane] = single(dry.k)
    state[lane_state.ABSORPTION_DRY + lane] = single(optics.absorption[item, pore])
    state[lane_state.INDEX_WET + lane] = single(wet.n)
    state[lane_state.EXTINCTION_WET + lane] = single(wet.k)
    state[lane_state.ABSORPTION_WET + lane] = single(optics.absorption[item, pore + 1])
    state[lane_state.ABSORPTION_CORE + lane] = single(optics.absorption[item, core])
    m, m1, k = compute_relative_index(dry, core_index)
    (
        state[lane_state.M_IN_DRY + lane],
        state[lane_state.M1_IN_DRY + lane],
        state[lane_state.K_IN_DRY + lane],
    ) = m, m1, k
    m, m1, k = compute_relative_index(wet, core_index)
    (
        state[lane_state.M_IN_WET + lane],
        state[lane_state.M1_IN_WET + lane],
        state[lane_state.K_IN_WET + lane],
    ) = m, m1, k
    m, m1, k = compute_relative_index(core_index, dry)
    state[lane_state.M_OUT_DRY + lane], state[lane_state.M1_OUT_DRY + lane] = m, m1
    state[lane_state.K_OUT_DRY + lane] = k
    m, m1, k = compute_relative_index(core_index, wet)
    state[lane_state.M_OUT_WET + lane], state[lane_state.M1_OUT_WET + lane] = m, m1
    state[lane_state.K_OUT_WET + lane] = k


@inline_only
def compute_relative_index(near, far):
    """Return m, m − 1 and k of the relative index of two media."""
    k = 0.0 if near.n == far.n and near.k == far.k else far.k / near.n
    return single(far.n / near.n), single((far.n - near.n) / near.n), single(k)


@inline_only
def set_grain_optics(lanes, lane, job):
    """Set the optical constants of a lane to those of the grain that was hit."""
    state, item, types, optics = lanes.state, lanes.item[lane], job.scene.types, job.optics
    grain_type = int(state[lane_state.TYPE + lane])
    n_shells = types.n_shells[grain_type]
    outer, core = types.material[grain_type, 0], types.material[grain_type, n_shells - 1]
    state[lane_state.N_SHELLS + lane] = single(n_shells)
    state[lane_state.INDEX_OUTER + lane] = single(optics.n[item, outer])
    state[lane_state.EXTINCTION_OUTER + lane] = single(optics.k[item, outer])
    state[lane_state.INDEX_CORE + lane] = single(optics.n[item, core])
    state[lane_state.EXTINCTION_CORE + lane] = single(optics.k[item, core])
    state[lane_state.ABSORPTION_OUTER + lane] = single(optics.absorption[item, outer])
    state[lane_state.ABSORPTION_CORE + lane] = single(optics.absorption[item, core])
    semi_major = state[lane_state.SEMI_MINOR + lane] / (ONE - state[lane_state.FLATTENING + lane])
    state[lane_state.COATING_THICKNESS + lane] = (
        single(2.0 * types.coating_thickness[grain_type, 0]) * semi_major
    )
