"""The state of all lanes: one array, whose rows lie at multiples of the number of lanes.

``state[DX + lane]`` is the x component of a lane's direction.  Offsets that the compiler knows
let it see that rows do not overlap, without which it would not vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.transport.compiling.jit import exact, part
from splits.transport.grains.flight import Fates, Space
from splits.transport.numerics.vectors import Vector

LANES = 64
"""Rays side by side: enough to fill vectors and to average over, few enough for the cache."""

VECTOR = 16
"""Lanes that fill the widest vectors of today's machines."""

STRIDE = 2 * VECTOR
"""Lanes that a pass takes at a time."""

(
    # What a launch sets to zero.  Ray: position of the origin of its leg or of its entry into a
    # grain; way from there on; direction of the leg before.
    X, Y, Z, GX, GY, GZ, LX, LY, LZ,
    # Optical depth, trials in a row without a grain, shape is kept, distance to the last grain left
    # out; lengths (m) in dry and wet pores, in coating and in core since they were last put down.
    DEPTH, TRIES, KEEP, SKIP_LEG, DRY_PATH, WET_PATH, COAT_PATH, CORE_PATH,
    # Layer of the ray, those in which its flight set out and from which distances are drawn; way
    # from which they count; 1 where it stands on a face; 1 where its last leg has been booked.
    LAYER, START, FROM, AHEAD, STANDS, LANDED,
    # Direction; length of the leg before (none: −1).
    DX, DY, DZ, LAST,
    # Grain: point on the unit sphere, major axis, flattening, semi-minor axis, half facetness.
    QX, QY, QZ, WX, WY, WZ, FLATTENING, MINOR, SIGMA,
    # Ray at the grain: shell (0 pore, 1 outermost, 2 below), 1 inward or −1 outward.
    SHELL, SIDE,
    # What it waits for; whether its pore is wet, and the number that decided it.
    STATUS, WET, PORE,
    # Its layer: faces, mean distance of grains, saturation, first type.
    HIGH, LOW, MEAN_LEG, SATURATION, FIRST_KIND,
    # Next roulette, inverse probability of survival.
    LIMIT, WEIGHT,
    # Grain drawn but not yet met: curvature, flattening, half facetness, type.
    NEW_CURVATURE, NEW_FLATTENING, NEW_SIGMA, NEW_KIND,
    # What decides these: positions in their tables, and the number read at the second; a number for
    # the type, and its choice.
    AT_CURVATURE, AT_FLATTENING, AT_SIGMA, AT_KIND, PICKED,
    # Type of the grain, and of its outermost shell and core: complex index, absorption; coating.
    KIND, N_OUTER, K_OUTER, N_CORE, K_CORE, A_OUTER, A_CORE, THICKNESS, SHELLS,
    # Complex index and absorption of the pores.
    N_DRY, K_DRY, A_DRY, N_WET, K_WET, A_WET,
    # Where all grains are alike, into grains and out of them: index beyond, in units of the real
    # index on this side, real part less 1, and imaginary part.
    M_IN_DRY, M_IN_WET, M_OUT_DRY, M_OUT_WET,
    C_IN_DRY, C_IN_WET, C_OUT_DRY, C_OUT_WET,
    K_IN_DRY, K_IN_WET, K_OUT_DRY, K_OUT_WET,
) = (LANES * row for row in range(84))  # fmt: skip
TRAVELLED = 23 * LANES
"""End of the rows that a launch sets to zero."""
STATE = 84 * LANES

KEY_HIGH, KEY_LOW, COUNT, LEGS, ORDER, MOST = (LANES * row for row in range(6))
"""Rows of whole numbers, uint32: key of the random stream, numbers drawn so far; legs so far;
grains met so far, and how many a ray may meet."""
WORDS = 6 * LANES

(
    FLYING, TRIAL, LOBE_BACK, LOBE_THROUGH,
    AT_FACE, AT_GROUND, BACK, ASTRAY, ABSORBED, LOST, IDLE,
) = (exact(float(status)) for status in range(11))  # fmt: skip
"""What a lane waits for: a grain; a facet; a cosine lobe on the near or on the far side; the rest
waits for the plain loop between the passes: to meet a face, or the ground, to begin its flight
again in the layer in which it set out, to find its layer, to be ended, and to be launched."""


@part
def vector(state, row):
    """Return the vector whose first component stands at `row`, and the others in the rows below."""
    return Vector(state[row], state[row + LANES], state[row + 2 * LANES])


@part
def put(state, row, v):
    """Store a vector where `vector` finds it."""
    state[row], state[row + LANES], state[row + 2 * LANES] = v.x, v.y, v.z


class Passing(NamedTuple):
    """What the passes need to know of a scene, float32 (m) but for the rules.

    Attributes
    ----------
    space : Space
    fates : Fates
    saturation : float32
    facets : int32
    mirrored, point_grains : bool
    """

    layer_geometry: Space
    rejection_rules: Fates
    saturation: np.float32
    facet_sampling: np.int32
    mirror_wrong_side: np.bool_
    point_grains: np.bool_
