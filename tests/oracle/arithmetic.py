"""Sums of products and roots in double precision."""

import math

from oracle.jit import kernel


@kernel
def fused(a, b, c):
    """Return a b + c."""
    return a * b + c


@kernel
def reciprocal_root(x):
    """Return 1/√x."""
    return 1.0 / math.sqrt(x)


@kernel
def root(x):
    """Return √x."""
    return math.sqrt(x)
