"""Sobol indices against those of a function that has them in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from formula_tables import W, make_table

import splits
from splits.core.validation import InvalidValue

A, B = np.linspace(0.1, 0.8, W.size), np.linspace(0.6, 0.2, W.size)


@pytest.fixture(scope="module")
def product():
    """Return a table of a product, whose parts of the variance are known."""
    nodes = np.linspace(-0.5, 0.5, 6)
    return make_table(lambda a, b: 0.4 * (1.0 + A * a) * (1.0 + B * b), {"a": nodes, "b": nodes})


@NEEDS_JIT
def test_indices_are_the_exact_ones(product):
    found = splits.sobol_indices(product, ["a", "b"], points=256)
    parts = np.stack([A**2 / 12.0, B**2 / 12.0, A**2 * B**2 / 144.0])
    whole = parts.sum(axis=0)
    exact = {"first_order": parts[:2] / whole, "total": (parts[:2] + parts[2]) / whole}
    for name, values in exact.items():
        error = found[f"{name}_stderr"].values
        z = (found[name].values - values)[error > 0.0] / error[error > 0.0]
        # Wavelengths share their points, so that they count as few.
        assert np.abs(z).max() < 5.0
        assert np.abs(found[name].values - values).max() < 0.02
    sums = found.first_order_sum.values
    np.testing.assert_allclose(sums, found.first_order.sum("parameter"), atol=1e-12)
    assert (sums <= 1.0 + 5.0 * found.first_order_sum_stderr.values).all()
    deviation = 0.4 * np.sqrt(whole)
    np.testing.assert_allclose(found.standard_deviation, deviation, rtol=0.05)


def test_the_same_seed_gives_the_same(product):
    one, other = (splits.sobol_indices(product, ["a", "b"], points=64, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.first_order, other.first_order)


@NEEDS_JIT
def test_other_seeds_scatter_as_errors_say(product):
    """Of ten seeds: the middle wavelength counts, as all share their points."""
    runs = [splits.sobol_indices(product, ["a", "b"], points=64, seed=s) for s in range(10)]
    z = []
    for name in ("first_order", "total"):
        value, error = (np.stack([one[f"{name}{end}"].values[:, W.size // 2] for one in runs])
                        for end in ("", "_stderr"))  # fmt: skip
        z.append((value - value.mean(axis=0)) / (error * np.sqrt(0.9)))
        # Totals hold what first-order indices do, and more.
        assert (runs[0].total - runs[0].first_order > -3.0 * runs[0].total_stderr).all()
    judge_z(np.concatenate(z).ravel())


def test_constant_reflectance_has_no_indices(product):
    still = make_table(lambda a, b: np.where(W < 800.0, 0.5, 0.5 + 0.1 * a),
                     {"a": [0.0, 1.0, 2.0], "b": [0.0, 1.0]})  # fmt: skip
    found = splits.sobol_indices(still, ["a", "b"], points=64)
    assert (found.first_order.sel(wavelength=slice(None, 750.0)) == 0.0).all()
    np.testing.assert_allclose(
        found.first_order.sel(parameter="a", wavelength=1000.0), 1.0, atol=0.1
    )


INVALID_CALLS = {
    "one": ({"free": ["a"], "fixed": {"b": 0.0}}, "two axes"),
    "scale": ({"free": ["a", "scale"], "fixed": {"b": 0.0}}, "two axes"),
    "odd": ({"points": 100}, "a power of 2"),
    "few": ({"points": 8}, "64 to 65536"),
    "no table": ({"table": None}, "a Table"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_bad_input_is_rejected(product, name):
    other, message = INVALID_CALLS[name]
    with pytest.raises(InvalidValue, match=message):
        splits.sobol_indices(**({"table": product, "free": ["a", "b"]} | other))
