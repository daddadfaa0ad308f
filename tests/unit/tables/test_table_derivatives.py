"""Derivatives of tables between nodes."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from formula_tables import make_table

import splits
from splits.core.validation import InvalidValue

W = np.array([500.0, 900.0])


def evaluate_light(size, angle, water):
    """Return a reflectance that is nonlinear along every axis, and its derivatives."""
    scale = np.array([0.02, 0.05])
    mu = np.cos(np.radians(angle))
    value = np.exp(-scale * np.sqrt(size) * mu) - 0.1 * scale * np.sqrt(water)
    whole = np.exp(-scale * np.sqrt(size) * mu)
    return value, {
        "optical_radius_um": -whole * scale * mu / (2.0 * np.sqrt(size)),
        "incidence_deg": whole * scale * np.sqrt(size) * np.sin(np.radians(angle)) * np.pi / 180.0,
        "liquid_water_content": -0.1 * scale / (2.0 * np.sqrt(max(water, 1e-9))),
    }


@pytest.fixture(scope="module")
def table():
    axes = {
        "optical_radius_um": np.geomspace(50.0, 1000.0, 9),
        "incidence_deg": np.array([0.0, 20.0, 35.0, 50.0, 65.0]),
        "liquid_water_content": np.array([0.0, 0.01, 0.04, 0.09, 0.15]),
    }
    return make_table(lambda *point: evaluate_light(*point)[0], axes, 1e-6, W)


@pytest.mark.parametrize("place", [(130.0, 30.0, 0.02), (700.0, 60.0, 0.1), (50.0, 10.0, 0.005)])
def test_derivatives_are_those_of_the_reflectance(table, place):
    names = ["optical_radius_um", "incidence_deg", "liquid_water_content"]
    at = dict(zip(names, place, strict=True))
    found = table.derivatives(names, **at)
    exact = evaluate_light(*place)[1]
    for i, name in enumerate(names):
        off = np.abs(found.reflectance_jacobian.values[i] - exact[name])
        error = found.reflectance_jacobian_stderr.values[i]
        assert (off < 3.0 * error + 1e-9).all()
        assert (error < 0.1 * np.abs(exact[name]) + 1e-5).all()
    assert found.parameter_unit.values.tolist() == ["um-1", "degree-1", "1"]


def test_they_are_the_slopes_of_interp(table):
    at = {"incidence_deg": 40.0, "liquid_water_content": 0.02}
    (found,) = table.derivatives(
        ["optical_radius_um"], optical_radius_um=240.0, **at
    ).reflectance_jacobian.values
    two = [table.interp(optical_radius_um=x, **at).reflectance.values for x in (239.9, 240.1)]
    np.testing.assert_allclose(found, (two[1] - two[0]) / 0.2, rtol=1e-4)


@NEEDS_JIT
def test_a_table_with_covariance_knows_them_better():
    grid = {"radius": [100.0, 150.0, 225.0]}

    def snow(radius):
        return splits.Snow.natural(optical_radius_um=radius)

    made = splits.build_table(snow, grid, [800.0, 1030.0], max_stderr=0.01, covariance=True)
    with_it = splits.Table(made).derivatives(["radius"], radius=150.0)
    without = splits.Table(made.drop_vars("reflectance_batches")).derivatives(
        ["radius"], radius=150.0
    )
    np.testing.assert_array_equal(with_it.reflectance_jacobian, without.reflectance_jacobian)
    # Sizes of deep snow share their paths.
    assert (with_it.reflectance_jacobian_stderr < without.reflectance_jacobian_stderr).all()
    run = splits.spectrophotometer(
        snow(150.0), [800.0, 1030.0], 0, 0.004, 7, jacobian=["optical_radius_um"]
    )
    error = np.hypot(run.reflectance_jacobian_stderr[0], with_it.reflectance_jacobian_stderr[0])
    off = run.reflectance_jacobian.values[0] - with_it.reflectance_jacobian.values[0]
    assert (np.abs(off) < 4.0 * error).all()


INVALID_CALLS = {
    "no axis": (["depth_m"], {}, "depth_m"),
    "text": ("optical_radius_um", {}, "a list of"),
    "twice": (["incidence_deg"] * 2, {}, "different names"),
    "root": (["liquid_water_content"], {"liquid_water_content": 0.0}, "is finite"),
    "outside": (["incidence_deg"], {"incidence_deg": 80.0}, "as far as the table goes"),
    "wavelength": (["incidence_deg"], {"wavelength": 500.0}, "wavelength"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_bad_input_is_rejected(table, name):
    names, other, message = INVALID_CALLS[name]
    at = {"optical_radius_um": 100.0, "incidence_deg": 30.0, "liquid_water_content": 0.02} | other
    with pytest.raises(InvalidValue, match=message):
        table.derivatives(names, **at)
