"""Hemispherical values by discrete ordinates against exact values and other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.analysis.theory.discrete_ordinates import solve_discrete_ordinates

REFERENCE = Path(__file__).with_name("reference")


def make_optics(thickness, albedo, moments):
    """Return optics of one layer over "wavelengths"."""
    thickness, albedo = np.broadcast_arrays(np.atleast_1d(thickness), np.atleast_1d(albedo))
    moments = np.broadcast_to(moments, (thickness.size, np.shape(moments)[-1]))
    return xr.Dataset(
        {
            "single_scattering_albedo": ("wavelength", albedo.astype(float)),
            "optical_thickness": ("wavelength", thickness.astype(float)),
            "legendre_moment": (("wavelength", "order"), moments.astype(float)),
        },
        {"wavelength": 500.0 + np.arange(thickness.size)},
    )


def test_layers_agree_with_exact_values():
    table = pd.read_csv(REFERENCE / "plane_parallel.csv", comment="#").query("n == 1")
    assert len(table) > 50
    difference = []
    for (cosine, ground), rows in table.groupby(["mu0", "lambert_bottom"]):
        moments = rows.g.to_numpy()[:, np.newaxis] ** np.arange(66)
        optics = make_optics(rows.tau, rows.ssa, moments)
        result = solve_discrete_ordinates(optics, np.degrees(np.arccos(cosine)), 64, float(ground))
        difference.append(np.abs(result.reflectance.values - rows.R) - rows.est_err)
        arriving = result.transmittance.values / (1.0 - ground) if ground < 1.0 else rows["T"]
        difference.append(np.abs(arriving - rows["T"]) - rows.est_err)
    assert np.concatenate(difference).max() < 2e-6


def compute_h_function(albedo, cosines):
    """Return H(μ) of isotropic scattering (Chandrasekhar 1950, section 38) by quadrature."""
    x, w = np.polynomial.legendre.leggauss(400)
    # Nodes are dense at μ = 0, where H has an infinite slope.
    mu, w = (0.5 * (x + 1.0)) ** 3, 1.5 * (0.5 * (x + 1.0)) ** 2 * w
    root, h = np.sqrt(1.0 - albedo), np.ones_like(mu)

    def evaluate(points):
        kernel = w * mu * h / (points[:, np.newaxis] + mu)
        return 1.0 / (root + 0.5 * albedo * kernel.sum(axis=1))

    for _ in range(2000):
        h = 0.5 * (h + evaluate(mu))
    return evaluate(cosines)


@pytest.mark.parametrize("albedo", [0.5, 0.9, 0.99, 0.9999])
def test_half_spaces_agree_with_functions_of_chandrasekhar(albedo):
    cosines = np.array([1.0, 0.6, 0.2, 0.05])
    expected = 1.0 - compute_h_function(albedo, cosines) * np.sqrt(1.0 - albedo)
    optics = make_optics(np.inf, albedo, np.eye(1, 66)[0])
    actual = [
        float(solve_discrete_ordinates(optics, np.degrees(np.arccos(cosine)), 64).reflectance[0])
        for cosine in cosines
    ]
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-6)


def test_problems_of_disort():
    table = pd.read_csv(REFERENCE / "disort_problems.csv", comment="#")
    for problem in table.itertuples():
        thickness, albedos = (np.array(f"{v}".split(), float) for v in (problem.tau, problem.ssa))
        layers = []
        for tau, ssa, text in zip(thickness, albedos, problem.moments.split("/"), strict=True):
            moments = np.zeros(problem.streams + 1)
            moments[: len(text.split())] = np.array(text.split(), float)
            layers.append(make_optics(tau, ssa, moments))
        angle = "diffuse" if problem.mu0 == "diffuse" else np.degrees(np.arccos(float(problem.mu0)))
        result = solve_discrete_ordinates(layers, angle, problem.streams)
        actual = result.reflectance.item(), result.transmittance.item()
        # DISORT computes in single precision: without absorption, its fluxes add up to 1 only
        # within this.
        expected = np.array([problem.R, problem.T])
        is_white = (albedos == 0.999999).all()
        closure = abs(1.0 - expected.sum()) + 2e-6 * thickness.sum() if is_white else 0.0
        np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=closure + 1e-7)


@pytest.mark.parametrize("incidence", [0.0, 89.9, "diffuse"])
def test_extreme_layers_are_finite_closed_and_monotonic(incidence):
    thickness = np.geomspace(1e-8, 1e8, 33)
    for absorbed in (0.0, 1e-12, 1e-3, 0.5):
        optics = make_optics(thickness, 1.0 - absorbed, 0.85 ** np.arange(17))
        result = solve_discrete_ordinates(optics, incidence, 16)
        reflectance, transmittance = result.reflectance.values, result.transmittance.values
        total = reflectance + transmittance
        assert np.isfinite(total).all() and (reflectance > 0.0).all() and (transmittance >= 0).all()
        assert (np.diff(reflectance) >= -1e-14).all() and (np.diff(transmittance) <= 1e-14).all()
        assert total.max() <= 1.0 + 1e-14
        if absorbed == 0.0:
            np.testing.assert_allclose(total, 1.0, rtol=0.0, atol=1e-10)


def test_hundred_layers_equal_one():
    moments = 0.85 ** np.arange(17)
    whole = solve_discrete_ordinates(make_optics(5.0, 0.999, moments), 60.0, 16, 0.3)
    layers = [make_optics(0.05, 0.999, moments)] * 100
    divided = solve_discrete_ordinates(layers, 60.0, 16, 0.3)
    for name in ("reflectance", "transmittance"):
        np.testing.assert_allclose(divided[name], whole[name], rtol=1e-11)
