"""State of all lanes: one array whose rows lie at multiples of the number of lanes.

``state[DIR_X + lane]`` is the x component of the direction of a lane.  With compile-time offsets
the compiler can prove that rows do not overlap, which vectorization requires.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import float32_constant, inline_only
from splits.kernels.grains.free_path import LayerGeometry, RejectionRules
from splits.kernels.math.vectors import Vector

N_LANES = 64
"""Number of lanes: enough to fill vectors and to keep both passes busy, few enough for the
cache."""

VECTOR_WIDTH = 16
"""Lanes of the widest vectors of current processors."""

STRIDE = 2 * VECTOR_WIDTH
"""Lanes per inner loop of a pass."""

(
    # Rows that a launch sets to zero, up to `SEGMENT_ATTENUATED`.  Start of the segment or entry
    # point of the grain; offset from there; direction of the previous segment.
    X, Y, Z, EXIT_OFFSET_X, EXIT_OFFSET_Y, EXIT_OFFSET_Z, PREV_DIR_X, PREV_DIR_Y, PREV_DIR_Z,
    # Optical depth, successive rejections, whether the grain shape is kept, distance of the last
    # skipped grain; path lengths (m) in dry and wet pores, coating and core since the last flush.
    OPTICAL_DEPTH, N_REJECTED, KEEP_SHAPE, SKIP_DISTANCE,
    DRY_PATH, WET_PATH, COATING_PATH, CORE_PATH,
    # Layers of the ray, of the start of its flight, and of the start of sampling; start distance of
    # sampling; 1 if the ray is on a boundary; 1 if its last segment has been attenuated.
    LAYER, FLIGHT_LAYER, DRAW_LAYER, START_DISTANCE, ON_BOUNDARY, SEGMENT_ATTENUATED,
    # Direction; length of the previous segment, −1 for none.
    DIR_X, DIR_Y, DIR_Z, PREV_LENGTH,
    # Grain: point on the unit sphere, major axis, flattening, semi-minor axis, half facetness.
    UNIT_POINT_X, UNIT_POINT_Y, UNIT_POINT_Z, AXIS_X, AXIS_Y, AXIS_Z,
    FLATTENING, SEMI_MINOR, ROUGHNESS,
    # Ray at the grain: shell (0 pore, 1 outermost, 2 next), 1 inward or −1 outward.
    SHELL, SIDE,
    # Status; 1 if the pore is wet, and the random number that selected it.
    STATUS, PORE_WET, PORE_VARIATE,
    # Layer: boundaries, mean free path, saturation, first grain type.
    LAYER_TOP, LAYER_BOTTOM, MEAN_FREE_PATH, WET_FRACTION, FIRST_TYPE,
    # Optical depth of the next roulette, inverse probability of survival.
    NEXT_ROULETTE, WEIGHT,
    # Sampled grain: curvature, flattening, half facetness, type.
    NEW_INVERSE_SEMI_MAJOR, NEW_FLATTENING, NEW_ROUGHNESS, NEW_TYPE,
    # Its variates: positions in the tables (the second is replaced by the tabulated value); random
    # number of the type, and the chosen type.
    QUANTILE_INVERSE_SEMI_MAJOR, QUANTILE_FLATTENING, QUANTILE_ROUGHNESS, U_TYPE, CHOSEN_TYPE,
    # Type of the grain; complex index and absorption of its outermost shell and core; coating.
    TYPE, INDEX_OUTER, EXTINCTION_OUTER, INDEX_CORE, EXTINCTION_CORE,
    ABSORPTION_OUTER, ABSORPTION_CORE, COATING_THICKNESS, N_SHELLS,
    # Complex index and absorption of the pores.
    INDEX_DRY, EXTINCTION_DRY, ABSORPTION_DRY, INDEX_WET, EXTINCTION_WET, ABSORPTION_WET,
    # Grains of a single type, into and out of them: relative index m + i k of the far side to the
    # real index of the near side, as m, m − 1 and k.
    M_IN_DRY, M_IN_WET, M_OUT_DRY, M_OUT_WET,
    M1_IN_DRY, M1_IN_WET, M1_OUT_DRY, M1_OUT_WET,
    K_IN_DRY, K_IN_WET, K_OUT_DRY, K_OUT_WET,
) = (N_LANES * row for row in range(84))  # fmt: skip
ZEROED_SIZE = 23 * N_LANES
"""End of the rows that a launch sets to zero."""
STATE_SIZE = 84 * N_LANES

KEY_HIGH, KEY_LOW, N_DRAWN, N_SEGMENTS, ORDER, MAX_ORDER = (N_LANES * row for row in range(6))
"""Rows of integers, uint32: key of the random stream, count of random numbers drawn; number of
sampled grains; order of scattering and its maximum."""
WORDS_SIZE = 6 * N_LANES

(
    IN_FLIGHT, AT_SURFACE, IN_REFLECTED_LOBE, IN_TRANSMITTED_LOBE,
    AT_BOUNDARY, AT_GROUND, RESTART, RELOCATE, ABSORBED, LOST, IDLE,
) = (float32_constant(float(status)) for status in range(11))  # fmt: skip
"""Status of a lane.  The flight pass serves `IN_FLIGHT`; the surface pass `AT_SURFACE` and the
cosine lobes on the near and on the far side.  The loop between the passes handles the rest: a
boundary, the ground, a restart of the flight in the layer of its start, a search for the layer,
finished rays (`ABSORBED`, `LOST`), and launches."""


@inline_only
def load_vector(state, row):
    """Return the vector whose components are in three successive rows from `row` on."""
    return Vector(state[row], state[row + N_LANES], state[row + 2 * N_LANES])


@inline_only
def store_vector(state, row, v):
    """Store a vector in three successive rows from `row` on."""
    state[row], state[row + N_LANES], state[row + 2 * N_LANES] = v.x, v.y, v.z


class PassConstants(NamedTuple):
    """Constants of a scene that the passes use, float32 (m) except for the rules.

    Attributes
    ----------
    layer_geometry : LayerGeometry
    rejection_rules : RejectionRules
    wet_fraction : float32
    facet_sampling : int32
    mirror_wrong_side, point_grains : bool
    """

    layer_geometry: LayerGeometry
    rejection_rules: RejectionRules
    wet_fraction: np.float32
    facet_sampling: np.int32
    mirror_wrong_side: np.bool_
    point_grains: np.bool_
