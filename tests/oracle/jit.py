"""How the oracle is compiled: in double precision, by Numba alone."""

from numba import njit

kernel = njit(error_model="numpy", cache=False)
entry = njit(error_model="numpy", cache=False)

ZERO, HALF, ONE, TWO, THREE, FOUR = 0.0, 0.5, 1.0, 2.0, 3.0, 4.0
TINY = 1e-30
