"""Group index of materials."""

import numpy as np
import pytest

import splits
from splits.instruments.delay_record import SPEED_OF_LIGHT, compute_slowness
from splits.materials.refractive_index import (
    WATER_RANGE_NM,
    ConstantIndex,
    SellmeierIndex,
    TabulatedIndex,
    compute_group_index,
    compute_water_group_index,
)

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


WATER = [
    [400.0, 1.3827], [532.0, 1.3581], [589.0, 1.3528],
]  # fmt: skip
"""Group index of water at 0 °C, from differences of the tables of IAPWS R9-97."""


def test_water_at_the_melting_point_has_the_group_index_of_iapws():
    w, expected = np.array(WATER).T
    np.testing.assert_allclose(compute_water_group_index(w, True).value, expected, atol=5e-5)


def test_group_index_of_water_is_that_of_a_measured_dispersion():
    """Daimon & Masumura 2007, Applied Optics 46, 3811: four terms of Sellmeier at 19 °C."""
    terms = ((0.5672526103, 5.085550461e-3), (0.1736581125, 1.814938654e-2),
             (2.121531502e-2, 2.617260739e-2), (0.1138493213, 10.73888649))  # fmt: skip
    measured = SellmeierIndex("test", "test", (182.0, 1129.0), 0.0, terms)
    w = np.linspace(*WATER_RANGE_NM, 91)
    step = 0.01
    slope = (measured(w + step).real - measured(w - step).real) / (2.0 * step)
    cold, other = (compute_water_group_index(w, cold) for cold in (True, False))
    # Between the values at 0 and 20 °C, of which the mean is known.
    warm = 2.0 * other.value - cold.value
    assert (np.abs(warm - (measured(w).real - w * slope)) <= 1.1 * cold.stderr + 1e-4).all()
    assert (other.stderr >= np.abs(other.value - cold.value)).all()


@pytest.mark.parametrize(
    ("medium", "column"),
    [
        (splits.Snow(saturation=0.3, depth_m=0.1), 1),
        (splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1, saturation=0.1), 1),
        (splits.Stack([splits.Snow(depth_m=0.1, saturation=0.0),
                       splits.Snow(depth_m=0.1, saturation=0.2)]), 4),
        (splits.Sand(depth_m=0.01, saturation=0.5), 1),
    ],
)  # fmt: skip
def test_wet_media_use_the_formulation(medium, column):
    w = np.array([400.0, 532.0, 1064.0])
    slowness = compute_slowness(medium, w)
    group, stderr = (
        values[:, column] * SPEED_OF_LIGHT / slowness.path_fractions[column]
        for values in slowness[:2]
    )
    expected = compute_water_group_index(w, not isinstance(medium, splits.Sand))
    np.testing.assert_allclose(group, expected.value, rtol=1e-12)
    np.testing.assert_allclose(stderr, expected.stderr, rtol=1e-12)


def test_an_index_of_the_user_keeps_its_own_dispersion():
    index = {"water": 1.33 + 1e-9j, "ice": 1.31 + 1e-9j}
    snow = splits.Snow(saturation=0.3, depth_m=0.1, refractive_index=index)
    slowness = compute_slowness(snow, np.array([532.0]))
    group = slowness.value[0, 1] * SPEED_OF_LIGHT / slowness.path_fractions[1]
    assert group == pytest.approx(1.33, rel=1e-12)
