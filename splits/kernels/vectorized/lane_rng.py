"""Random numbers of the lanes: the streams of `splits.kernels.math.rng` in single precision."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.kernels.compiler.jit import HALF, ONE, inline_only
from splits.kernels.math.rng import GOLDEN_GAMMA, mix64

_MASK_21 = np.uint64(0x1FFFFF)
_MASK_23 = np.uint64(0x7FFFFF)
_MASK_31 = np.uint64(0x7FFFFFFF)
_SCALE_21 = single(2.0**-21)
_SCALE_23 = single(2.0**-23)
_SCALE_31 = single(2.0**-31)
_SCALE_46 = single(2.0**-46)
_LARGEST_BELOW_ONE = single(1.0 - 2.0**-24)


@inline_only
def compute_random_bits(lane, offset):
    """Return 64 random bits of the stream of a lane, `offset` numbers ahead of its counter."""
    key = (np.uint64(lane.key_high) << np.uint64(32)) | np.uint64(lane.key_low)
    number = np.uint32(lane.n_drawn + np.uint32(offset))
    return mix64(key + np.uint64(number) * GOLDEN_GAMMA)


@inline_only
def draw_uniform(lane):
    """Draw the next random number of a lane in double precision."""
    u = to_uniform_52(compute_random_bits(lane, 0))
    lane.n_drawn += np.uint32(1)
    return u


@inline_only
def to_three_uniforms(bits):
    """Return three numbers uniform on (0, 1) of 21 bits each, at the centres of their intervals."""
    return (
        (single(np.int32(bits & _MASK_21)) + HALF) * _SCALE_21,
        (single(np.int32((bits >> np.uint64(21)) & _MASK_21)) + HALF) * _SCALE_21,
        (single(np.int32(bits >> np.uint64(43))) + HALF) * _SCALE_21,
    )


@inline_only
def to_uniform_46(bits):
    """Return a number uniform on (0, 1] with 46 bits near 0, for logarithms.

    It limits free paths to 32 mean free paths; 24 bits would limit them to 17.
    """
    high = single(np.int32(bits >> np.uint64(41)))
    low = single(np.int32((bits >> np.uint64(18)) & _MASK_23))
    return high * _SCALE_23 + (low + HALF) * _SCALE_46


@inline_only
def to_uniform_31(bits):
    """Return a number uniform on (0, 1) from the lowest 31 bits.

    Values that single precision would round to 1 are reduced, because cumulative distributions need
    u < 1.
    """
    u = (single(np.int32(bits & _MASK_31)) + HALF) * _SCALE_31
    return u if u < ONE else _LARGEST_BELOW_ONE


@inline_only
def to_uniform_52(bits):
    """Return a number uniform on (0, 1) of 52 bits, as `rng.uniform` does."""
    return (float(bits >> np.uint64(12)) + 0.5) * 2.0**-52
