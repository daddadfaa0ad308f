"""Propagation of errors of single-scattering properties: validity of the bounds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr

from splits.analysis.theory.error_propagation import compute_interpolation_bound, propagate_errors

MOMENTS = np.array([[1.0, 0.5, 0.3, 0.2, 0.1]] * 2)


def make_optics(albedo=0.01, moment=0.02):
    """Return optics at two wavelengths, the second of which has interpolation errors."""
    uncertain = np.array([0.0, 1.0])
    return xr.Dataset(
        {
            "single_scattering_albedo": ("wavelength", [0.9, 0.9]),
            "single_scattering_albedo_interpolation_bound": ("wavelength", albedo * uncertain),
            "legendre_moment": (("wavelength", "order"), MOMENTS),
            "legendre_moment_interpolation_bound": (
                ("wavelength", "order"), np.outer(moment * uncertain, [0.0, 1.0, 1.0, 1.0, 1.0]),
            ),
        },
        {"wavelength": [500.0, 600.0]},
    )  # fmt: skip


def evaluate_backscatter(optics):
    """Return the phase function at backscattering, whose orders alternate in sign."""
    return (optics.legendre_moment * (-1.0) ** np.arange(5)).sum("order").values


def evaluate_product(optics):
    """Return a nonlinear function of two variables and one order."""
    return (optics.single_scattering_albedo * (1.0 + optics.legendre_moment.isel(order=1))).values


@pytest.mark.parametrize("theory", [evaluate_backscatter, evaluate_product])
def test_no_combination_of_errors_exceeds_the_bound(theory):
    exact = make_optics()
    largest = 0.0
    for signs in itertools.product((-1.0, 1.0), repeat=5):
        moments = exact.legendre_moment_interpolation_bound * xr.DataArray(
            [0.0, *signs[1:]], dims="order"
        )
        perturbed = exact.assign(
            single_scattering_albedo=exact.single_scattering_albedo
            + signs[0] * exact.single_scattering_albedo_interpolation_bound,
            legendre_moment=exact.legendre_moment + moments,
        )
        largest = np.maximum(largest, np.abs(theory(perturbed) - theory(exact)))
    bound = compute_interpolation_bound(theory, exact)
    assert bound[0] == largest[0] == 0.0
    # The product of the deviations, 0.01 · 0.02, adds to about 0.04.
    assert bound[1] == pytest.approx(largest[1], rel=0.02)


def test_without_jackknife_the_error_is_the_bound():
    np.testing.assert_array_equal(
        propagate_errors(evaluate_product, make_optics()),
        compute_interpolation_bound(evaluate_product, make_optics()),
    )
    assert (propagate_errors(evaluate_product, make_optics(0.0, 0.0)) == 0.0).all()
