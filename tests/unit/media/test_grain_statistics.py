"""Grain statistics: ice density, surface-to-volume ratio, attenuation K1 and K2."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate

from splits.materials import ice_density
from splits.media.grain_statistics import (
    compute_shape_attenuation,
    compute_size_attenuation,
    surface_to_volume_ratio,
    tabulate_hit_inverse_sizes,
    tabulate_hit_sphericities,
    tabulate_truncated_normal,
)

TABLE1 = (0.6, 0.95, 0.798, 0.064)


@pytest.mark.parametrize(
    ("temperature", "density"),
    [(-40, 922.8), (-30, 921.6), (-20, 920.3), (-10, 918.7), (0, 916.7), (-1, 916.9), (-5, 917.7)],
)
def test_ice_density_at_and_between_tabulated_temperatures(temperature, density):
    assert ice_density(temperature) == pytest.approx(density, rel=1e-12)


@pytest.mark.parametrize("temperature", [-40.1, 0.1, float("nan"), None])
def test_ice_density_outside_the_table_is_rejected(temperature):
    with pytest.raises(ValueError, match=r"temperature_c = .*\[-40, 0\]"):
        ice_density(temperature)


def test_surface_to_volume_of_a_sphere_is_six():
    assert surface_to_volume_ratio(1.0) == 6.0


@pytest.mark.parametrize("psi", [0.1, 0.5, 0.8, 0.99])
def test_surface_to_volume_of_a_prolate_spheroid(psi):
    # Surface of revolution of an ellipse with semi-axes 1/2 and ψ²/2, by quadrature.
    a, b = 0.5, 0.5 * psi**2
    surface = integrate.quad(
        lambda t: 2.0 * math.pi * b * math.sin(t) * math.hypot(a * math.sin(t), b * math.cos(t)),
        0.0,
        math.pi,
        epsabs=0.0,
        epsrel=1e-11,
    )[0]
    volume = 4.0 / 3.0 * math.pi * a * b * b
    assert float(surface_to_volume_ratio(psi)) == pytest.approx(surface / volume, rel=1e-9)


def test_surface_to_volume_is_smooth_near_a_sphere():
    psi = 1.0 - np.logspace(-12.0, -3.0, 2000)[::-1]
    ratio = surface_to_volume_ratio(psi)
    # A = 6 + 8 (1 − ψ) + O((1 − ψ)²), through the change from closed form to series.
    gap = 1.0 - psi
    assert np.abs(ratio - 6.0 - 8.0 * gap).max() < 15.0 * gap.max() ** 2
    assert (np.diff(ratio) <= 4e-15).all()


def test_size_attenuation_of_equal_sizes_is_the_inverse():
    assert compute_size_attenuation(2e-4, 2e-4) == 1.0 / 2e-4
    for relative_width in np.logspace(-16.0, -3.0, 50):
        k1 = compute_size_attenuation(2e-4, 2e-4 * (1.0 + relative_width))
        assert k1 == pytest.approx(
            (1.0 - 0.5 * relative_width) / 2e-4, rel=relative_width**2 + 1e-15
        )


def test_size_attenuation_matches_the_integrals():
    low, high = 3e-4, 7.5e-4
    # ∫ s⁻² ds over ∫ s⁻¹ ds.
    exact = (1.0 / low - 1.0 / high) / math.log(high / low)
    assert compute_size_attenuation(low, high) == pytest.approx(exact, rel=1e-14)


def test_shape_attenuation_matches_quadrature():
    low, high, mean, sd = TABLE1

    def evaluate_normal(psi):
        return math.exp(-0.5 * ((psi - mean) / sd) ** 2)

    weighted = integrate.quad(
        lambda p: evaluate_normal(p) * float(surface_to_volume_ratio(p)), low, high
    )[0]
    exact = weighted / integrate.quad(evaluate_normal, low, high)[0] / 4.0
    assert compute_shape_attenuation(*TABLE1) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("limits", [(0.6, 0.9, 0.8, 0.0), (0.8, 0.8, 0.8, 0.1)])
def test_degenerate_distributions_give_one_shape(limits):
    assert compute_shape_attenuation(*limits) == pytest.approx(
        float(surface_to_volume_ratio(0.8)) / 4.0
    )
    assert (tabulate_hit_sphericities(*limits) == 0.8).all()
    assert (tabulate_truncated_normal(*limits) == 0.8).all()


def test_a_narrow_distribution_tends_to_one_shape():
    exact = float(surface_to_volume_ratio(0.8)) / 4.0
    assert compute_shape_attenuation(0.1, 1.0, 0.8, 1e-6) == pytest.approx(exact, rel=1e-9)
    assert np.abs(tabulate_hit_sphericities(0.1, 1.0, 0.8, 1e-6)[1:-1] - 0.8).max() < 1e-5


@pytest.mark.parametrize("table", [tabulate_hit_sphericities, tabulate_truncated_normal])
def test_quantiles_increase_within_their_limits(table):
    psi = table(*TABLE1)
    assert (np.diff(psi) > 0.0).all()
    assert psi[0] == pytest.approx(TABLE1[0])
    assert psi[-1] == pytest.approx(TABLE1[1])


@pytest.mark.parametrize("weighting", ["cross_section", "uniform"])
def test_inverse_sizes_increase_between_the_limits(weighting):
    inverse = tabulate_hit_inverse_sizes(3e-4, 7.5e-4, weighting)
    assert (np.diff(inverse) > 0.0).all()
    assert 1.0 / inverse[[0, -1]] == pytest.approx([7.5e-4, 3e-4])


def test_hit_grains_are_more_elongated_on_average():
    assert (
        tabulate_hit_sphericities(*TABLE1)[1:-1] < tabulate_truncated_normal(*TABLE1)[1:-1]
    ).all()
