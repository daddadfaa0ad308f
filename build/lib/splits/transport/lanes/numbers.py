"""Random numbers of the lanes: the streams of `numerics.rng`, cut into single precision."""

from __future__ import annotations

import numpy as np
from numpy import float32 as single

from splits.transport.compiling.jit import HALF, ONE, part
from splits.transport.lanes.rows import COUNT, KEY_HIGH, KEY_LOW
from splits.transport.numerics.rng import GOLDEN, mix64

_LOW21 = np.uint64(0x1FFFFF)
_LOW23 = np.uint64(0x7FFFFF)
_LOW31 = np.uint64(0x7FFFFFFF)
_TO_21 = single(2.0**-21)
_TO_23 = single(2.0**-23)
_TO_31 = single(2.0**-31)
_TO_46 = single(2.0**-46)
_LARGEST = single(1.0 - 2.0**-24)


@part
def word(words, lane, offset):
    """Return 64 random bits: the number `offset` after those that the lane has drawn."""
    key = (np.uint64(words[KEY_HIGH + lane]) << np.uint64(32)) | np.uint64(words[KEY_LOW + lane])
    number = np.uint32(words[COUNT + lane] + np.uint32(offset))
    return mix64(key + np.uint64(number) * GOLDEN)


@part
def three(bits):
    """Return three numbers uniform on (0, 1), of 21 bits each, centred in their cells."""
    return (
        (single(np.int32(bits & _LOW21)) + HALF) * _TO_21,
        (single(np.int32((bits >> np.uint64(21)) & _LOW21)) + HALF) * _TO_21,
        (single(np.int32(bits >> np.uint64(43))) + HALF) * _TO_21,
    )


@part
def fine(bits):
    """Return a number uniform on (0, 1] with 46 bits near 0: for logarithms of it.

    A free flight is capped at 32 mean paths only; 24 bits would cap it at 17.
    """
    high = single(np.int32(bits >> np.uint64(41)))
    low = single(np.int32((bits >> np.uint64(18)) & _LOW23))
    return high * _TO_23 + (low + HALF) * _TO_46


@part
def below_one(bits):
    """Return a number uniform on (0, 1) from the lowest 31 bits.

    Single precision rounds the last ones to 1, which no table of cumulative shares allows for.
    """
    u = (single(np.int32(bits & _LOW31)) + HALF) * _TO_31
    return u if u < ONE else _LARGEST


@part
def double(bits):
    """Return a number uniform on (0, 1) of 52 bits, as `rng.uniform` does."""
    return (float(bits >> np.uint64(12)) + 0.5) * 2.0**-52
