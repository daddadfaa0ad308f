"""Group index of materials."""

import numpy as np
import pytest

from splits.materials.group_index import compute_group_index
from splits.materials.refractive_index import ConstantIndex, SellmeierIndex, TabulatedIndex

QUARTZ = SellmeierIndex("test", "test", (250.0, 3500.0), 0.0, ((0.6961663, 0.0684043**2),
                        (0.4079426, 0.1162414**2), (0.8974794, 9.896161**2)))  # fmt: skip


def as_column(index):
    return lambda wavelength_nm: index(wavelength_nm)[:, np.newaxis]


def test_sellmeier_formulas_have_their_derivative():
    """Of fused silica, from n dn/dλ = −λ ∑ B C/(λ² − C)²."""
    w = np.array([532.0, 1064.0, 1550.0])
    n, square = QUARTZ(w).real, (w * 1e-3) ** 2
    slope = sum(-(w * 1e-3) * b * c / (square - c) ** 2 for b, c in QUARTZ.terms) / n
    exact = n - w * 1e-3 * slope
    group = compute_group_index(as_column(QUARTZ), w)
    np.testing.assert_allclose(group.value[:, 0], exact, atol=3e-4)
    assert (np.abs(group.value[:, 0] - exact) <= 1.1 * group.stderr[:, 0]).all()


def test_constants_have_no_dispersion():
    group = compute_group_index(as_column(ConstantIndex(1.31 + 0.1j)), np.array([500.0]))
    np.testing.assert_allclose(group.value, 1.31, rtol=1e-12)
    np.testing.assert_allclose(group.stderr, 0.0, atol=1e-12)


def test_wavelengths_at_the_end_of_a_table_are_rejected():
    with pytest.raises(ValueError, match=r"wavelength_nm = 260\.0: must be 8 % inside"):
        compute_group_index(as_column(QUARTZ), np.array([260.0]))


def test_kinks_of_tables_have_a_large_error():
    """Where the slope of n over ln λ changes from −0.07 to 0."""
    nodes = np.array([300.0, 532.0, 2000.0])
    kinked = TabulatedIndex("t", "t", nodes, np.array([1.35, 1.31, 1.31]), np.zeros(3))
    group = compute_group_index(as_column(kinked), np.array([532.0]))
    slope = 0.04 / np.log(532.0 / 300.0)
    np.testing.assert_allclose(group.value, 1.31 + 0.5 * slope, rtol=1e-6)
    np.testing.assert_allclose(group.stderr, 0.5 * slope, rtol=1e-6)
