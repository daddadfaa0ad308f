"""The state of all lanes: one array, whose rows lie at multiples of the number of lanes.

``state[DX + lane]`` is the x component of a lane's direction.  Offsets that the compiler knows
let it see that rows do not overlap, without which it would not vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.kernels.compiler.jit import float32_constant, inline_only
from splits.kernels.grains.free_path import LayerGeometry, RejectionRules
from splits.kernels.math.vectors import Vector

N_LANES = 64
"""Rays side by side: enough to fill vectors and to average over, few enough for the cache."""

VECTOR_WIDTH = 16
"""Lanes that fill the widest vectors of today's machines."""

STRIDE = 2 * VECTOR_WIDTH
"""Lanes that a pass takes at a time."""

(
    # What a launch sets to zero.  Ray: position of the origin of its leg or of its entry into a
    # grain; way from there on; direction of the leg before.
    X, Y, Z, EXIT_OFFSET_X, EXIT_OFFSET_Y, EXIT_OFFSET_Z, PREV_DIR_X, PREV_DIR_Y, PREV_DIR_Z,
    # Optical depth, trials in a row without a grain, shape is kept, distance to the last grain left
    # out; lengths (m) in dry and wet pores, in coating and in core since they were last put down.
    OPTICAL_DEPTH, N_REJECTED, KEEP_SHAPE, SKIP_DISTANCE, DRY_PATH, WET_PATH, COATING_PATH, CORE_PATH,
    # Layer of the ray, those in which its flight set out and from which distances are drawn; way
    # from which they count; 1 where it stands on a face; 1 where its last leg has been booked.
    LAYER, FLIGHT_LAYER, DRAW_LAYER, START_DISTANCE, ON_BOUNDARY, SEGMENT_ATTENUATED,
    # Direction; length of the leg before (none: −1).
    DIR_X, DIR_Y, DIR_Z, PREV_LENGTH,
    # Grain: point on the unit sphere, major axis, flattening, semi-minor axis, half facetness.
    UNIT_POINT_X, UNIT_POINT_Y, UNIT_POINT_Z, AXIS_X, AXIS_Y, AXIS_Z, FLATTENING, SEMI_MINOR, ROUGHNESS,
    # Ray at the grain: shell (0 pore, 1 outermost, 2 below), 1 inward or −1 outward.
    SHELL, SIDE,
    # What it waits for; whether its pore is wet, and the number that decided it.
    STATUS, PORE_WET, PORE_VARIATE,
    # Its layer: faces, mean distance of grains, saturation, first type.
    LAYER_TOP, LAYER_BOTTOM, MEAN_FREE_PATH, SATURATION, FIRST_TYPE,
    # Next roulette, inverse probability of survival.
    NEXT_ROULETTE, WEIGHT,
    # Grain drawn but not yet met: curvature, flattening, half facetness, type.
    NEW_CURVATURE, NEW_FLATTENING, NEW_ROUGHNESS, NEW_TYPE,
    # What decides these: positions in their tables, and the number read at the second; a number for
    # the type, and its choice.
    QUANTILE_CURVATURE, QUANTILE_FLATTENING, QUANTILE_ROUGHNESS, U_TYPE, CHOSEN_TYPE,
    # Type of the grain, and of its outermost shell and core: complex index, absorption; coating.
    TYPE, INDEX_OUTER, EXTINCTION_OUTER, INDEX_CORE, EXTINCTION_CORE, ABSORPTION_OUTER, ABSORPTION_CORE, COATING_THICKNESS, N_SHELLS,
    # Complex index and absorption of the pores.
    INDEX_DRY, EXTINCTION_DRY, ABSORPTION_DRY, INDEX_WET, EXTINCTION_WET, ABSORPTION_WET,
    # Where all grains are alike, into grains and out of them: index beyond, in units of the real
    # index on this side, real part less 1, and imaginary part.
    M_IN_DRY, M_IN_WET, M_OUT_DRY, M_OUT_WET,
    M1_IN_DRY, M1_IN_WET, M1_OUT_DRY, M1_OUT_WET,
    K_IN_DRY, K_IN_WET, K_OUT_DRY, K_OUT_WET,
) = (N_LANES * row for row in range(84))  # fmt: skip
ZEROED_SIZE = 23 * N_LANES
"""End of the rows that a launch sets to zero."""
STATE_SIZE = 84 * N_LANES

KEY_HIGH, KEY_LOW, N_DRAWN, N_SEGMENTS, ORDER, MAX_ORDER = (N_LANES * row for row in range(6))
"""Rows of whole numbers, uint32: key of the random stream, numbers drawn so far; legs so far;
grains met so far, and how many a ray may meet."""
WORDS_SIZE = 6 * N_LANES

(
    IN_FLIGHT, AT_SURFACE, IN_REFLECTED_LOBE, IN_TRANSMITTED_LOBE,
    AT_BOUNDARY, AT_GROUND, RESTART, RELOCATE, ABSORBED, LOST, IDLE,
) = (float32_constant(float(status)) for status in range(11))  # fmt: skip
"""What a lane waits for: a grain; a facet; a cosine lobe on the near or on the far side; the rest
waits for the plain loop between the passes: to meet a face, or the ground, to begin its flight
again in the layer in which it set out, to find its layer, to be ended, and to be launched."""


@inline_only
def load_vector(state, row):
    """Return the vector whose first component stands at `row`, and the others in the rows below."""
    return Vector(state[row], state[row + N_LANES], state[row + 2 * N_LANES])


@inline_only
def store_vector(state, row, v):
    """Store a vector where `load_vector` finds it."""
    state[row], state[row + N_LANES], state[row + 2 * N_LANES] = v.x, v.y, v.z


class PassConstants(NamedTuple):
    """What the passes need to know of a scene, float32 (m) but for the rules.

    Attributes
    ----------
    layer_geometry : LayerGeometry
    rejection_rules : RejectionRules
    saturation : float32
    facet_sampling : int32
    mirror_wrong_side, point_grains : bool
    """

    layer_geometry: LayerGeometry
    rejection_rules: RejectionRules
    saturation: np.float32
    facet_sampling: np.int32
    mirror_wrong_side: np.bool_
    point_grains: np.bool_
