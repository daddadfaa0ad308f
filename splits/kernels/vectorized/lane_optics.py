"""Optical constants of lanes, in their layer and at their grain."""

from __future__ import annotations

from numpy import float32 as single

from splits.kernels.base.scene import WET_PORE
from splits.kernels.compiler.jit import ONE, inline_only
from splits.kernels.grains.interaction import RelativeIndex
from splits.kernels.grains.state import get_layer_geometry, refractive_index_of
from splits.kernels.math.vectors import to_single
from splits.kernels.vectorized.lane_state import Material, Pore


@inline_only
def get_material(optics, item, material):
    """Return the optical constants of a material for a work item in single precision."""
    index = to_single(refractive_index_of(optics, (item, material)))
    return Material(index, single(optics.absorption[item, material]))


@inline_only
def make_pore(optics, item, pore, core):
    """Return the optical constants of a pore material, and of its interfaces with grains."""
    inward = compute_relative_index(optics, item, pore, core)
    outward = compute_relative_index(optics, item, core, pore)
    return Pore(get_material(optics, item, pore), inward, outward)


@inline_only
def set_layer_optics(lane, job):
    """Set the optical constants of a lane in its layer.

    The core is that of the first grain type; in mixed scenes `set_grain_optics` replaces it.
    """
    layers, types, optics, item = job.scene.layers, job.scene.types, job.optics, lane.item
    layer = lane.layer
    grain_type, dry = layers.first_type[layer], layers.first_pore_material[layer]
    core = types.material[grain_type, types.n_shells[grain_type] - 1]
    lane.layer_geometry = to_single(get_layer_geometry(layers, layer))
    lane.wet_fraction, lane.first_type = layers.wet_fraction[layer], grain_type
    lane.dry = make_pore(optics, item, dry, core)
    lane.wet = make_pore(optics, item, dry + WET_PORE, core)
    lane.core = get_material(optics, item, core)


@inline_only
def compute_relative_index(optics, item, near_material, far_material):
    """Return the `RelativeIndex` of two materials, computed in double precision."""
    near = refractive_index_of(optics, (item, near_material))
    far = refractive_index_of(optics, (item, far_material))
    same = near.n == far.n and near.k == far.k
    k = 0.0 if same else far.k / near.n
    m, m_minus_1 = single(far.n / near.n), single((far.n - near.n) / near.n)
    return RelativeIndex(m, m_minus_1, single(k), single(near.n / far.n), same)


@inline_only
def set_grain_optics(lane, job):
    """Set the optical constants of a lane to those of the grain that was hit."""
    types, grain_type = job.scene.types, lane.grain_type
    n_shells = types.n_shells[grain_type]
    lane.core_shell = n_shells
    lane.outer = get_material(job.optics, lane.item, types.material[grain_type, 0])
    lane.core = get_material(job.optics, lane.item, types.material[grain_type, n_shells - 1])
    semi_major = lane.grain.semi_minor / (ONE - lane.grain.flattening)
    lane.coating_thickness = single(2.0 * types.coating_thickness[grain_type, 0]) * semi_major
