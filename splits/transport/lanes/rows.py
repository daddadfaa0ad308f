"""The state of all lanes: one array, whose rows lie at multiples of the number of lanes.

``state[DX + lane]`` is the x component of a lane's direction.  Offsets that the compiler knows
let it see that rows do not overlap, without which it would not vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splits.transport.jit import exact

LANES = 64
"""Rays side by side: enough to fill vectors and to average over, few enough for the cache."""

VECTOR = 16
"""Lanes that fill the widest vectors of today's machines."""

STRIDE = 2 * VECTOR
"""Lanes that a pass takes at a time."""

(
    # Ray: position of the origin of its leg or of its entry into a grain; direction.
    X, Y, Z, DX, DY, DZ,
    # Way from the grain's entry point on; direction and length of the leg before (none: −1).
    GX, GY, GZ, LX, LY, LZ, LAST,
    # Grain: point on the unit sphere, major axis, flattening, semi-minor axis, half facetness.
    QX, QY, QZ, WX, WY, WZ, FLATTENING, MINOR, SIGMA,
    # Ray at the grain: layer (0 pore, 1 outermost, 2 below), 1 inward or −1 outward.
    LAYER, SIDE,
    STATUS, WET, TRIES,
    # Optical depth, next roulette, inverse probability of survival.
    DEPTH, LIMIT, WEIGHT,
    # Lengths (m) in wet pores, in coating and in core since they were last put down.
    PORE_PATH, COAT_PATH, CORE_PATH,
    # Grain drawn but not yet met: curvature, flattening, half facetness, type; shape is kept;
    # distance to the last grain left out.
    NEW_CURVATURE, NEW_FLATTENING, NEW_SIGMA, NEW_KIND, KEEP, SKIP_LEG,
    # What decides these: positions in their tables, and the number read at the second; a number for
    # the type, and its choice.
    AT_CURVATURE, AT_FLATTENING, AT_SIGMA, AT_KIND, PICKED,
    # Type of the grain, and of its outermost layer and core: complex index, absorption; coating.
    KIND, N_OUTER, K_OUTER, N_CORE, K_CORE, A_OUTER, A_CORE, THICKNESS, LAYERS,
    # Indices of the pores, absorption in wet ones.
    N_DRY, N_WET, K_WET, A_WET,
    # Where all grains are alike, into grains and out of them: index beyond, in units of the real
    # index on this side, real part less 1, and imaginary part.
    M_IN_DRY, M_IN_WET, M_OUT_DRY, M_OUT_WET,
    C_IN_DRY, C_IN_WET, C_OUT_DRY, C_OUT_WET,
    K_IN_DRY, K_IN_WET, K_OUT_WET,
) = (LANES * row for row in range(68))  # fmt: skip
STATE = 68 * LANES

KEY_HIGH, KEY_LOW, COUNT, LEGS, ORDER, MOST = (LANES * row for row in range(6))
"""Rows of whole numbers, uint32: key of the random stream, numbers drawn so far; legs so far;
grains met so far, and how many a ray may meet."""
WORDS = 6 * LANES

FLYING, TRIAL, LOBE_BACK, LOBE_THROUGH, AT_BOUNDARY, ABSORBED, LOST, IDLE = (
    exact(float(status)) for status in range(8)
)
"""What a lane waits for: a grain; a facet; a cosine lobe on the near or on the far side; the rest
waits for the plain loop that ends and launches rays."""


class Features(NamedTuple):
    """What a scene has.  A feature is True or None: being types, they decide at compile time.

    Attributes
    ----------
    wet : True or None
        Some legs run through wet pores.
    faceted : True or None
        Grains are not all smooth.
    absorbing : True or None
        Extinction coefficients show in reflection.
    mixed : True or None
        Several types, or coatings; includes `absorbing`.
    variant : True or None
        Readings of the papers other than the default in entry point, facets or wrong side, or
        grains that are skipped.
    positions : True or None
        Horizontal positions are tracked.
    orders : True or None
        Grains met are counted, and limited.
    """

    wet: bool | None
    faceted: bool | None
    absorbing: bool | None
    mixed: bool | None
    variant: bool | None
    positions: bool | None
    orders: bool | None


class Scene(NamedTuple):
    """Scalars that the passes need, float32 (m) but for the rules.

    Attributes
    ----------
    mean_leg, depth : float32
    saturation : float32
    """

    mean_leg: np.float32
    depth: np.float32
    saturation: np.float32
    entry: np.int32
    facets: np.int32
    mirrored: np.bool_
    refuse_on_last_leg: np.bool_
    refuse_across_boundary: np.bool_
    skip_on_last_leg: np.bool_
    skip_across_boundary: np.bool_
