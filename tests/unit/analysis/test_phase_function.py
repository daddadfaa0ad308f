"""Phase functions from moments, the peak of diffraction, and files for other programs."""

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from constructed_results import ASYMMETRY, make_optics
from scipy.special import eval_legendre, j1

import splits
from splits.analysis.theory.phase_function import compute_diffraction_moments, to_eradiate
from splits.core.validation import InvalidValue


def evaluate_exact(angle_deg):
    mu = np.cos(np.radians(angle_deg))
    return (1.0 - ASYMMETRY**2) / (4.0 * np.pi * (1.0 + ASYMMETRY**2 - 2.0 * ASYMMETRY * mu) ** 1.5)


def test_a_smooth_phase_function_is_reconstructed():
    angles = np.linspace(10.0, 180.0, 86)
    result = splits.phase_function(make_optics(), angles)
    # Smoothing adds 1/4 of the mean square width times the curvature: largest near 0°.
    np.testing.assert_allclose(result.phase_function[0], evaluate_exact(angles), rtol=5e-3)


@pytest.mark.parametrize("diffraction", [False, True])
def test_phase_function_is_normalized_and_not_negative(diffraction):
    optics = splits.with_diffraction(make_optics()) if diffraction else make_optics()
    node, weight = np.polynomial.legendre.leggauss(400)
    result = splits.phase_function(optics, np.degrees(np.arccos(node))[::-1])
    assert (result.phase_function >= 0.0).all()
    total = 2.0 * np.pi * (result.phase_function.values * weight[::-1]).sum(axis=1)
    np.testing.assert_allclose(total, 1.0, rtol=1e-9)


def test_errors_are_estimated_from_batches_of_rays():
    exact, noisy = (splits.phase_function(make_optics(noise=n), [90.0]) for n in (0.0, 1e-4))
    assert float(exact.phase_function_stderr.max()) < 1e-12
    assert float(noisy.phase_function_stderr.min()) > 0.0


def test_angular_resolution_is_as_stated():
    peak = xr.Dataset(attrs=make_optics().attrs)
    order = np.arange(301)
    ones = np.ones((1, order.size))
    dims = ("wavelength", "order")
    peak = peak.assign_coords(wavelength=[600.0], order=order).assign(
        legendre_moment=(dims, ones), legendre_moment_interpolation_bound=(dims, 0.0 * ones),
        legendre_moment_jackknife=(("batch", *dims), np.ones((16, 1, order.size))),
    )  # fmt: skip
    angles = np.linspace(0.0, 10.0, 10_001)
    result = splits.phase_function(peak, angles).phase_function.values[0]
    half_width = angles[np.argmax(result < 0.5 * result[0])]
    assert 2.0 * half_width * 300 == pytest.approx(475.0, rel=0.02)


@pytest.mark.parametrize("order", [1, 10, 100, 1000, 1500, 2000])
def test_diffraction_moments_match_the_airy_pattern(order):
    x = 2.0 * np.pi * 100e3 / 600.0
    angle = np.linspace(1e-9, 0.5 * np.pi, 400_001)
    sine = np.sin(angle)
    intensity = (2.0 * j1(x * sine) / (x * sine)) ** 2 * sine
    moment = np.trapezoid(intensity * eval_legendre(order, np.cos(angle)), angle)
    expected = moment / np.trapezoid(intensity, angle)
    result = compute_diffraction_moments(100.0, np.array([600.0]), np.array([order]))
    # The formula applies to large spheres, with errors of order 1/x.
    assert result[0, 0] == pytest.approx(expected, abs=1.0 / x)


def test_diffraction_doubles_extinction_only():
    before, after = make_optics(), splits.with_diffraction(make_optics(), 160.0)
    np.testing.assert_allclose(after.extinction, 2.0 * before.extinction)
    np.testing.assert_allclose(after.optical_thickness, 40.0)
    np.testing.assert_allclose(after.single_scattering_albedo, 0.5 * (1.0 + 0.9))
    absorbed = [(1.0 - ds.single_scattering_albedo) * ds.extinction for ds in (before, after)]
    np.testing.assert_allclose(*absorbed)
    # The transport coefficient ω (1 − g) is kept up to the width of the peak.
    transport = [ds.single_scattering_albedo * ds.extinction * (1.0 - g) for ds, g in (
        (before, ASYMMETRY), (after, after.asymmetry_parameter))]  # fmt: skip
    np.testing.assert_allclose(*transport, rtol=5e-3)
    assert after.legendre_moment[0, 0] == 1.0
    default_radius = splits.with_diffraction(make_optics())
    np.testing.assert_array_equal(default_radius.legendre_moment, after.legendre_moment)


def test_eradiate_export_has_the_required_variables():
    exported = to_eradiate(make_optics())
    assert exported.sigma_t.dims == exported.albedo.dims == ("w",)
    assert exported.phase.dims == ("w", "mu", "i", "j")
    units = {name: exported[name].attrs["units"] for name in ("w", "sigma_t", "phase")}
    assert units == {"w": "nm", "sigma_t": "m^-1", "phase": "steradian^-1"}
    assert (np.diff(exported.mu) > 0.0).all()
    assert (exported.mu[0], exported.mu[-1]) == (-1.0, 1.0)


@pytest.mark.parametrize("diffraction", [False, True])
def test_eradiate_export_keeps_absorption_and_transport_scattering(diffraction):
    optics = splits.with_diffraction(make_optics()) if diffraction else make_optics()
    exported = to_eradiate(optics)
    phase, mu = exported.phase.values[:, :, 0, 0], exported.mu.values
    total, forward = (2.0 * np.pi * np.trapezoid(phase * x, mu, axis=1) for x in (1.0, mu))
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    absorption = (1.0 - optics.single_scattering_albedo) * optics.extinction
    np.testing.assert_allclose((1.0 - exported.albedo) * exported.sigma_t, absorption)
    transport = exported.albedo.values * exported.sigma_t.values * (1.0 - forward)
    expected = (
        optics.single_scattering_albedo * optics.extinction * (1.0 - optics.legendre_moment[:, 1])
    )
    np.testing.assert_allclose(transport, expected)
    # The correction of the extinction is small.
    np.testing.assert_allclose(exported.sigma_t, optics.extinction, rtol=5e-3)
    np.testing.assert_allclose(exported.optical_thickness, 1e-2 * exported.sigma_t)


@NEEDS_JIT
def test_simulated_optics_give_a_phase_function():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1)
    result = splits.single_scattering(snow, [900.0], moments=64, rays=20_000)
    function = splits.phase_function(splits.with_diffraction(result), [0.0, 20.0, 90.0])
    value, error = function.phase_function.values[0], function.phase_function_stderr.values[0]
    assert (value > 3.0 * error).all() and (np.diff(value) < 0.0).all()


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: splits.phase_function(make_optics(), [200.0]), "angle_deg = 200.0"),
        (lambda: splits.phase_function(xr.Dataset(attrs={"title": "x"})), "optics = 'x'"),
        (
            lambda: to_eradiate(make_optics(), np.arange(0.0, 181.0, 30.0)),
            "angle_deg = '7 angles'",
        ),
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
