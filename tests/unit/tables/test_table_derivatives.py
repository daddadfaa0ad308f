"""Derivatives of tables between nodes."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from formula_tables import make_table

import splits
from splits.core.validation import InvalidValue

W = np.array([500.0, 900.0])


def evaluate_reflectance(size, angle, water):
    """Return a reflectance that is nonlinear along every axis, and its derivatives."""
    scale = np.array([0.02, 0.05])
    mu = np.cos(np.radians(angle))
    value = np.exp(-scale * np.sqrt(size) * mu) - 0.1 * scale * np.sqrt(water)
    exponential = np.exp(-scale * np.sqrt(size) * mu)
    return value, {
        "optical_radius_um": -exponential * scale * mu / (2.0 * np.sqrt(size)),
        "incidence_deg": exponential
        * scale
        * np.sqrt(size)
        * np.sin(np.radians(angle))
        * np.pi
        / 180.0,
        "liquid_water_content": -0.1 * scale / (2.0 * np.sqrt(max(water, 1e-9))),
    }


@pytest.fixture(scope="module")
def table():
    axes = {
        "optical_radius_um": np.geomspace(50.0, 1000.0, 9),
        "incidence_deg": np.array([0.0, 20.0, 35.0, 50.0, 65.0]),
        "liquid_water_content": np.array([0.0, 0.01, 0.04, 0.09, 0.15]),
    }
    return make_table(lambda *point: evaluate_reflectance(*point)[0], axes, 1e-6, W)


@pytest.mark.parametrize(
    "coordinates", [(130.0, 30.0, 0.02), (700.0, 60.0, 0.1), (50.0, 10.0, 0.005)]
)
def test_derivatives_match_the_exact_reflectance(table, coordinates):
    names = ["optical_radius_um", "incidence_deg", "liquid_water_content"]
    point = dict(zip(names, coordinates, strict=True))
    result = table.derivatives(names, **point)
    exact = evaluate_reflectance(*coordinates)[1]
    for i, name in enumerate(names):
        error = np.abs(result.reflectance_jacobian.values[i] - exact[name])
        stderr = result.reflectance_jacobian_stderr.values[i]
        assert (error < 3.0 * stderr + 1e-9).all()
        assert (stderr < 0.1 * np.abs(exact[name]) + 1e-5).all()
    assert result.parameter_unit.values.tolist() == ["um-1", "degree-1", "1"]


def test_derivatives_match_finite_differences_of_interp(table):
    point = {"incidence_deg": 40.0, "liquid_water_content": 0.02}
    (derivative,) = table.derivatives(
        ["optical_radius_um"], optical_radius_um=240.0, **point
    ).reflectance_jacobian.values
    values = [table.interp(optical_radius_um=x, **point).reflectance.values for x in (239.9, 240.1)]
    np.testing.assert_allclose(derivative, (values[1] - values[0]) / 0.2, rtol=1e-4)


@NEEDS_JIT
def test_covariance_reduces_the_errors_of_derivatives():
    grid = {"radius": [100.0, 150.0, 225.0]}

    def make_snow(radius):
        return splits.Snow.natural(optical_radius_um=radius)

    dataset = splits.build_table(make_snow, grid, [800.0, 1030.0], max_stderr=0.01, covariance=True)
    with_covariance = splits.Table(dataset).derivatives(["radius"], radius=150.0)
    without_covariance = splits.Table(dataset.drop_vars("reflectance_batches")).derivatives(
        ["radius"], radius=150.0
    )
    np.testing.assert_array_equal(
        with_covariance.reflectance_jacobian, without_covariance.reflectance_jacobian
    )
    # Grain sizes of semi-infinite snow use the same paths.
    assert (
        with_covariance.reflectance_jacobian_stderr < without_covariance.reflectance_jacobian_stderr
    ).all()
    run = splits.spectrophotometer(
        make_snow(150.0), [800.0, 1030.0], 0, 0.004, 7, jacobian=["optical_radius_um"]
    )
    error = np.hypot(
        run.reflectance_jacobian_stderr[0], with_covariance.reflectance_jacobian_stderr[0]
    )
    difference = run.reflectance_jacobian.values[0] - with_covariance.reflectance_jacobian.values[0]
    assert (np.abs(difference) < 4.0 * error).all()


INVALID_CALLS = {
    "no axis": (["depth_m"], {}, "depth_m"),
    "text": ("optical_radius_um", {}, "a list of"),
    "twice": (["incidence_deg"] * 2, {}, "different names"),
    "square_root": (["liquid_water_content"], {"liquid_water_content": 0.0}, "is finite"),
    "outside": (["incidence_deg"], {"incidence_deg": 80.0}, "as far as the table goes"),
    "wavelength": (["incidence_deg"], {"wavelength": 500.0}, "wavelength"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_invalid_input_is_rejected(table, name):
    names, changes, message = INVALID_CALLS[name]
    point = {
        "optical_radius_um": 100.0,
        "incidence_deg": 30.0,
        "liquid_water_content": 0.02,
    } | changes
    with pytest.raises(InvalidValue, match=message):
        table.derivatives(names, **point)
