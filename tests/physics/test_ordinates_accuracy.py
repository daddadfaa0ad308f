"""Relative errors of the transmission of slabs."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import solve_spectrum
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab


@pytest.mark.parametrize("mode", [0, 3])
@pytest.mark.parametrize("albedo", [0.5, 0.999, 1.0 - 1e-9, 1.0])
@pytest.mark.parametrize("thickness", [1e-8, 0.5, 5.0, 80.0, 1e4])
def test_transmission_has_a_small_relative_error(thickness, albedo, mode):
    """Transmission of a slab, down to the smallest numbers, is that of two halves."""
    n, beams = 16, np.cos(np.radians([20.0, 60.0, 89.9]))
    moments = 0.8 ** np.arange(n + 1)
    streams = Streams.from_number(n)
    optics = LayerOptics.from_albedo(thickness * np.array([1.0, 0.5]), np.full(2, albedo), moments)
    both = solve_slab(optics.truncate(n), streams, beams[np.newaxis], mode)
    whole, half = both.select(0), both.select(1)
    passed = np.linalg.inv(np.eye(n // 2) - half.reflection @ half.reflection) @ half.transmission
    direct = half.direct[:, np.newaxis]
    rows = half.beam_transmission + direct * half.beam_reflection @ half.reflection
    for one, two in (
        (whole.transmission, half.transmission @ passed),
        (whole.beam_transmission, direct * half.beam_transmission + rows @ passed),
    ):
        np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-11 * two.max() + 1e-300)


def test_transmission_without_absorption_decreases_as_inverse_thickness():
    """1/T is linear in τ, also where k² is smaller than rounding errors of the matrices."""
    n = 16
    thickness = np.array([1e4, 1e6, 1e8, 1e10])
    moments = np.broadcast_to(0.8 ** np.arange(n + 1), (4, n + 1))
    streams = Streams.from_number(n)
    optics = LayerOptics.from_albedo(thickness, np.ones(4), moments).truncate(n)
    slab = solve_slab(optics, streams, np.empty((1, 0)))
    lambertian = streams.flux_vector
    resistance = 1.0 / (2.0 * slab.transmission @ lambertian @ lambertian)
    slope = np.diff(resistance) / np.diff(thickness)
    np.testing.assert_allclose(slope, 0.75 * (1.0 - 0.8), rtol=1e-9)


def test_truncation_keeps_weak_absorption_exactly():
    rng = np.random.default_rng(1)
    absorbed = 10.0 ** rng.uniform(-15.0, 0.0, 1000)
    moments = rng.uniform(0.0, 0.999, (1000, 1)) ** np.arange(9)
    optics = LayerOptics.from_albedo(np.ones(1000), 1.0 - absorbed, moments)
    before, after = (
        layers.extinction[:, 0] - layers.scattering[:, 0, 0, 0]
        for layers in (optics, optics.truncate(8))
    )
    np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize(("angle", "max_error"), [(89.9, 0.002), (89.5, 0.004), (80.0, 0.002)])
def test_truncation_error_covers_grazing_beams(angle, max_error):
    wavelengths = np.linspace(400.0, 1800.0, 113)
    stack = make_granular_stack(splits.Snow.natural(optical_radius_um=160.0), wavelengths)
    cosine = np.cos(np.radians([angle]))
    solution = solve_spectrum(stack, cosine, max_error)
    fine = stack.solve(cosine, 128).reflectance
    difference = np.abs(solution.budget.reflectance - fine)[:, 0]
    assert (difference <= 2.0 * solution.truncation + 1e-5).all()
    assert difference.max() <= max_error
