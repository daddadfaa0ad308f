"""Accuracy of elementary functions in single precision over their documented ranges.

References are NumPy in float64, and mpmath at the ends of the ranges.
"""

import math

import mpmath as mp
import numpy as np
import pytest
from chi2 import NEEDS_JIT
from numba import njit

from splits.kernels import arithmetic

pytestmark = NEEDS_JIT
single = np.float32


def compile_loop(function):
    """Return a compiled loop that writes the values of a function into an array."""

    @njit
    def loop(x, out):
        for i in range(x.size):
            out[i] = function(x[i])

    return loop


_logarithms = compile_loop(arithmetic.log)
_exponentials = compile_loop(arithmetic.exp_float32)
_half_circles = compile_loop(arithmetic.sample_half_circle)
_circles = compile_loop(arithmetic.sample_circle)
_reciprocal_roots = compile_loop(arithmetic.rsqrt)
_roots = compile_loop(arithmetic.sqrt)


def evaluate(loop, x, width=1):
    """Return the values in the order of x, shape (len(x), width), as float64."""
    x = np.ascontiguousarray(x, dtype=single)
    out = np.empty((x.size, width) if width > 1 else x.size, dtype=single)
    loop(x, out)
    assert np.isfinite(out).all()
    return out.astype(float)


def list_floats(low, high, step):
    """Return every `step`-th float32 from low to high, both included."""
    first, last = np.array([low, high], dtype=single).view(np.int32)
    bits = np.append(np.arange(first, last, step, dtype=np.int64), last)
    return bits.astype(np.int32).view(single)


def list_neighbours(*values, n_each=200):
    """Return the float32 numbers next to some values, on both sides."""
    bits = np.array(values, dtype=single).view(np.int32)[:, np.newaxis]
    return (bits + np.arange(-n_each, n_each + 1, dtype=np.int32)).ravel().view(single)


# --- logarithm --------------------------------------------------------------------------------

LOG_RANGE = (1e-30, 1e30)


def compute_allowed_log_error(exact):
    return 2e-7 * np.abs(exact) + 1e-7


def select_within(x, low, high):
    return x[(x >= single(low)) & (x <= single(high))]


LOG_ARGUMENTS = {
    "full range": lambda: list_floats(*LOG_RANGE, 997),
    "every number from ½ to 2": lambda: list_floats(0.5, 2.0, 1),
    "steps of the exponent": lambda: list_neighbours(*(2.0 ** np.arange(-99, 99))),
    "steps of the significand": lambda: list_neighbours(
        *(math.sqrt(2.0) * 2.0 ** np.arange(-99, 99))
    ),
    "random numbers": lambda: (np.arange(2**16) + 0.5) / 2**16,
    "small random numbers": lambda: (np.arange(2**16) + 0.5) * 2.0**-46,
}


@pytest.mark.parametrize("arguments", LOG_ARGUMENTS)
def test_logarithm_accuracy(arguments):
    x = select_within(np.asarray(LOG_ARGUMENTS[arguments](), dtype=single), *LOG_RANGE)
    exact = np.log(x.astype(float))
    error = np.abs(evaluate(_logarithms, x) - exact)
    ratio = error / compute_allowed_log_error(exact)
    print(f"{x.size} arguments, largest error ratio {ratio.max():.2f} at {x[ratio.argmax()]}")
    assert (ratio <= 1.0).all()


def test_logarithm_at_the_ends_and_at_1():
    ends = np.array([*LOG_RANGE, 1.0], dtype=single)
    for x, value in zip(ends, evaluate(_logarithms, ends), strict=True):
        exact = float(mp.log(mp.mpf(float(x))))
        assert abs(value - exact) <= compute_allowed_log_error(exact)
    assert evaluate(_logarithms, [1.0])[0] == 0.0


def test_logarithm_is_monotonic():
    values = evaluate(_logarithms, list_floats(1e-10, 1.0, 499))
    assert np.diff(values).min() >= 0.0


# --- exponential ------------------------------------------------------------------------------

SMALLEST_EXPONENT = -87.0
EXP_ARGUMENTS = {
    "full range": lambda: -list_floats(1e-38, -SMALLEST_EXPONENT, 997),
    "every number from -2 to -1": lambda: -list_floats(1.0, 2.0, 1),
    "uniform grid": lambda: np.linspace(SMALLEST_EXPONENT, 0.0, 2_000_001),
    "steps of the exponent": lambda: list_neighbours(*(-math.log(2.0) * np.arange(0.5, 125.0))),
    "between two steps": lambda: list_neighbours(*(-math.log(2.0) * np.arange(1.0, 125.0))),
    "lower limit": lambda: list_neighbours(SMALLEST_EXPONENT),
}


@pytest.mark.parametrize("arguments", EXP_ARGUMENTS)
def test_exponential_accuracy(arguments):
    x = np.asarray(EXP_ARGUMENTS[arguments](), dtype=single)
    values = evaluate(_exponentials, x)
    in_range = x > single(SMALLEST_EXPONENT)
    exact = np.exp(x[in_range].astype(float))
    error = np.abs(values[in_range] / exact - 1.0)
    print(f"{x.size} arguments, largest error {error.max():.2e} at {x[in_range][error.argmax()]}")
    assert error.max() <= 2e-7
    # The limit -87 itself, with a value of 1.6e-38, gives 0 too.
    assert (values[~in_range] == 0.0).all()


def test_exponential_at_the_ends():
    assert evaluate(_exponentials, [0.0, -0.0]).tolist() == [1.0, 1.0]
    below = [np.nextafter(single(SMALLEST_EXPONENT), single(-np.inf)), -88.0, -1e3, -1e38, -np.inf]
    assert (evaluate(_exponentials, below) == 0.0).all()
    x = np.nextafter(single(SMALLEST_EXPONENT), single(0.0))
    exact = float(mp.exp(mp.mpf(float(x))))
    assert evaluate(_exponentials, [x])[0] == pytest.approx(exact, rel=2e-7, abs=0.0)


def test_exponential_is_monotonic_and_at_most_1():
    values = evaluate(_exponentials, np.concatenate([-list_floats(1e-38, 87.0, 997)[::-1], [0.0]]))
    assert values.max() == 1.0 and np.diff(values).min() >= 0.0


# --- circles ----------------------------------------------------------------------------------

UNITS = {
    "uniform grid": lambda: np.linspace(0.0, 1.0, 2_000_001),
    "random numbers": lambda: (np.arange(2**21, dtype=single) + single(0.5)) * single(2.0**-21),
    "near 0": lambda: list_floats(1e-30, 1e-3, 4999),
    "near 1": lambda: 1.0 - list_floats(2.0**-24, 1e-3, 49),
    "quarters": lambda: list_neighbours(0.25, 0.5, 0.75),
}


@pytest.mark.parametrize("arguments", UNITS)
def test_half_circle_accuracy(arguments):
    u = np.asarray(UNITS[arguments](), dtype=single)
    angle = np.pi * (u.astype(float) - 0.5)
    error = np.abs(evaluate(_half_circles, u, 2) - np.column_stack([np.cos(angle), np.sin(angle)]))
    print(f"{u.size} arguments, largest error {error.max():.2e} at {u[error.max(axis=1).argmax()]}")
    assert error.max() <= 3e-7


def test_half_circle_at_the_ends_and_in_the_middle():
    for u in (0.0, 2.0**-22, 0.5, 1.0 - 2.0**-22, 1.0):
        cosine, sine = evaluate(_half_circles, [u], 2)[0]
        assert abs(sine - float(mp.sin(mp.pi * (mp.mpf(u) - 0.5)))) <= 3e-7
        assert abs(cosine - float(mp.cos(mp.pi * (mp.mpf(u) - 0.5)))) <= 3e-7
    assert evaluate(_half_circles, [0.5], 2).tolist() == [[1.0, 0.0]]


@pytest.mark.parametrize("arguments", UNITS)
def test_circle_accuracy(arguments):
    u = np.asarray(UNITS[arguments](), dtype=single)
    points = evaluate(_circles, u, 2)
    # The angle is twice that of `sample_half_circle`.
    angle = 2.0 * np.pi * (u.astype(float) - 0.5)
    error = np.abs(points - np.column_stack([np.cos(angle), np.sin(angle)]))
    print(f"{u.size} arguments, largest error {error.max():.2e} at {u[error.max(axis=1).argmax()]}")
    assert error.max() <= 1e-6
    assert np.abs((points**2).sum(axis=1) - 1.0).max() <= 2e-6


def test_double_precision_matches_numpy():
    u = np.concatenate([np.linspace(1e-9, 1.0 - 1e-9, 1001), np.logspace(-15, -1, 101)])
    out, points = np.empty_like(u), np.empty((u.size, 2))
    _logarithms(u, out)
    assert np.abs(out / np.log(u) - 1.0).max() < 1e-15
    angle = np.pi * (u - 0.5)
    _half_circles(u, points)
    assert np.abs(points - np.column_stack([np.cos(angle), np.sin(angle)])).max() < 1e-15
    _circles(u, points)
    expected = np.column_stack([np.cos(2.0 * angle), np.sin(2.0 * angle)])
    assert np.abs(points - expected).max() < 1e-15 * 2


def test_square_roots_are_accurate():
    x = list_floats(1e-36, 1e30, 1009)
    reference = np.sqrt(x.astype(float))
    assert np.abs(evaluate(_reciprocal_roots, x) * reference - 1.0).max() <= 2e-7
    assert np.abs(evaluate(_roots, x) / reference - 1.0).max() <= 3e-7
    assert evaluate(_roots, np.zeros(1))[0] == 0.0


def test_square_roots_in_double_precision_match_numpy():
    x = np.logspace(-300, 300, 1001)
    double = np.empty_like(x)
    _reciprocal_roots(x, double)
    assert (double == 1.0 / np.sqrt(x)).all()
    _roots(x, double)
    assert (double == np.sqrt(x)).all()
