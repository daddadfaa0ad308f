"""Phase functions from moments, the peak of diffraction, and files for other programs."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from constructed_results import ASYMMETRY, ORDERS, make_optics
from scipy.special import eval_legendre, j1

import splits
from splits.analysis.theory.phase_function import diffraction_moments
from splits.analysis.theory.phase_function_export import to_eradiate, write_libradtran
from splits.core.validation import InvalidValue


def evaluate_exact(angle_deg):
    mu = np.cos(np.radians(angle_deg))
    return (1.0 - ASYMMETRY**2) / (4.0 * np.pi * (1.0 + ASYMMETRY**2 - 2.0 * ASYMMETRY * mu) ** 1.5)


def test_a_smooth_phase_function_comes_back():
    angles = np.linspace(10.0, 180.0, 86)
    found = splits.phase_function(make_optics(), angles)
    # Smoothing adds 1/4 of the mean square width times the curvature: largest near 0°.
    np.testing.assert_allclose(found.phase_function[0], evaluate_exact(angles), rtol=5e-3)


@pytest.mark.parametrize("diffraction", [False, True])
def test_it_adds_up_to_one_and_is_nowhere_negative(diffraction):
    given = splits.with_diffraction(make_optics()) if diffraction else make_optics()
    node, weight = np.polynomial.legendre.leggauss(400)
    found = splits.phase_function(given, np.degrees(np.arccos(node))[::-1])
    assert (found.phase_function >= 0.0).all()
    total = 2.0 * np.pi * (found.phase_function.values * weight[::-1]).sum(axis=1)
    np.testing.assert_allclose(total, 1.0, rtol=1e-9)


def test_errors_are_those_of_parts_of_the_rays():
    quiet, loud = (splits.phase_function(make_optics(noise=n), [90.0]) for n in (0.0, 1e-4))
    assert float(quiet.phase_function_stderr.max()) < 1e-12
    assert float(loud.phase_function_stderr.min()) > 0.0


def test_a_peak_is_as_wide_as_stated():
    many = xr.Dataset(attrs=make_optics().attrs)
    order = np.arange(301)
    ones = np.ones((1, order.size))
    dims = ("wavelength", "order")
    many = many.assign_coords(wavelength=[600.0], order=order).assign(
        legendre_moment=(dims, ones), legendre_moment_interpolation_bound=(dims, 0.0 * ones),
        legendre_moment_jackknife=(("batch", *dims), np.ones((16, 1, order.size))),
    )  # fmt: skip
    angles = np.linspace(0.0, 10.0, 10_001)
    found = splits.phase_function(many, angles).phase_function.values[0]
    half = angles[np.argmax(found < 0.5 * found[0])]
    assert 2.0 * half * 300 == pytest.approx(475.0, rel=0.02)


@pytest.mark.parametrize("order", [1, 10, 100, 1000, 1500, 2000])
def test_moments_of_diffraction_are_those_of_airys_pattern(order):
    x = 2.0 * np.pi * 100e3 / 600.0
    angle = np.linspace(1e-9, 0.5 * np.pi, 400_001)
    sine = np.sin(angle)
    light = (2.0 * j1(x * sine) / (x * sine)) ** 2 * sine
    moment = np.trapezoid(light * eval_legendre(order, np.cos(angle)), angle)
    expected = moment / np.trapezoid(light, angle)
    found = diffraction_moments(100.0, np.array([600.0]), np.array([order]))
    # Of large spheres, to an order in 1/x.
    assert found[0, 0] == pytest.approx(expected, abs=1.0 / x)


def test_diffraction_doubles_extinction_and_changes_nothing_else():
    before, after = make_optics(), splits.with_diffraction(make_optics(), 160.0)
    np.testing.assert_allclose(after.extinction, 2.0 * before.extinction)
    np.testing.assert_allclose(after.optical_thickness, 40.0)
    np.testing.assert_allclose(after.single_scattering_albedo, 0.5 * (1.0 + 0.9))
    absorbed = [(1.0 - ds.single_scattering_albedo) * ds.extinction for ds in (before, after)]
    np.testing.assert_allclose(*absorbed)
    # What is turned away, ω (1 − g), but for the width of the peak.
    turned = [ds.single_scattering_albedo * ds.extinction * (1.0 - g) for ds, g in (
        (before, ASYMMETRY), (after, after.asymmetry_parameter))]  # fmt: skip
    np.testing.assert_allclose(*turned, rtol=5e-3)
    assert after.legendre_moment[0, 0] == 1.0
    again = splits.with_diffraction(make_optics())
    np.testing.assert_array_equal(again.legendre_moment, after.legendre_moment)


def test_eradiate_finds_its_variables():
    made = to_eradiate(make_optics())
    assert made.sigma_t.dims == made.albedo.dims == ("w",)
    assert made.phase.dims == ("w", "mu", "i", "j")
    units = {name: made[name].attrs["units"] for name in ("w", "sigma_t", "phase")}
    assert units == {"w": "nm", "sigma_t": "m^-1", "phase": "steradian^-1"}
    assert (np.diff(made.mu) > 0.0).all()
    assert (made.mu[0], made.mu[-1]) == (-1.0, 1.0)


@pytest.mark.parametrize("diffraction", [False, True])
def test_eradiate_turns_away_and_absorbs_as_much(diffraction):
    given = splits.with_diffraction(make_optics()) if diffraction else make_optics()
    made = to_eradiate(given)
    phase, mu = made.phase.values[:, :, 0, 0], made.mu.values
    total, forward = (2.0 * np.pi * np.trapezoid(phase * x, mu, axis=1) for x in (1.0, mu))
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    before = (1.0 - given.single_scattering_albedo) * given.extinction
    np.testing.assert_allclose((1.0 - made.albedo) * made.sigma_t, before)
    turned = made.albedo.values * made.sigma_t.values * (1.0 - forward)
    own = given.single_scattering_albedo * given.extinction * (1.0 - given.legendre_moment[:, 1])
    np.testing.assert_allclose(turned, own)
    # What is given back is little.
    np.testing.assert_allclose(made.sigma_t, given.extinction, rtol=5e-3)
    np.testing.assert_allclose(made.optical_thickness, 1e-2 * made.sigma_t)


def test_libradtran_finds_wavelength_extinction_albedo_and_moments(tmp_path):
    write_libradtran(make_optics(), tmp_path / "layer.dat")
    table = np.loadtxt(tmp_path / "layer.dat")
    assert table.shape == (2, 3 + ORDERS.size)
    np.testing.assert_allclose(table[:, :3], [[600.0, 2e6, 0.9], [1300.0, 2e6, 0.9]])
    np.testing.assert_allclose(table[0, 3:], ASYMMETRY**ORDERS, rtol=1e-6)


@NEEDS_JIT
def test_optics_can_be_exported():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1)
    found = splits.single_scattering(snow, [900.0], moments=64, rays=20_000)
    function = splits.phase_function(splits.with_diffraction(found), [0.0, 20.0, 90.0])
    value, error = function.phase_function.values[0], function.phase_function_stderr.values[0]
    assert (value > 3.0 * error).all() and (np.diff(value) < 0.0).all()


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: splits.phase_function(make_optics(), [200.0]), "angle_deg = 200.0"),
        (lambda: splits.phase_function(xr.Dataset(attrs={"title": "x"})), "optics = 'x'"),
        (lambda: to_eradiate(make_optics(), np.arange(0.0, 181.0, 30.0)), "angle_deg = '7 angles'"),
        (lambda: splits.with_diffraction(make_optics(), -1.0), "radius_um = -1.0"),
        (lambda: splits.with_diffraction(make_optics(medium="sand")), "radius_um = None"),
        (
            lambda: splits.with_diffraction(splits.with_diffraction(make_optics())),
            "optics = 'Fraun",
        ),
    ],
)
def test_invalid_arguments_are_rejected(call, line):
    with pytest.raises(InvalidValue, match=f"^{line}"):
        call()
