"""Interpolation of tables: values, error estimates and input validation."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from splits.core.validation import InvalidValue
from splits.tables.axes import ParameterGrid
from splits.tables.axis_interpolation import AxisInterpolation
from splits.tables.comparison import list_comparison_grids
from splits.tables.interpolation import (
    N_VALIDATION_NODES,
    apply_axis_transform,
    compute_interpolation_weights,
    estimate_error_weights,
    transform_axis,
)
from splits.tables.table import Table

WAVELENGTHS = np.array([500.0, 900.0, 1300.0])
SIZES = np.geomspace(30.0, 2000.0, 12)
ANGLES = np.array([0.0, 20.0, 40.0, 55.0, 65.0, 75.0])


def evaluate_truth(size, angle, wavelengths=WAVELENGTHS):
    """Return a spectrum similar to the reflectance of snow: smooth, and steep at low values."""
    depth = np.sqrt(size / 1e4) * (wavelengths / 700.0) ** 2.5
    return np.exp(-depth * (1.0 + 2.0 * np.cos(np.radians(angle))))


def make_table(stderr=0.0, sizes=SIZES, angles=ANGLES, path_sharing_axes="optical_radius_um"):
    values = np.array([[evaluate_truth(size, angle) for angle in angles] for size in sizes])
    dims = ("optical_radius_um", "incidence_deg", "wavelength")
    attributes = {"long_name": "hemispherical reflectance"}
    variables = {
        "reflectance": (dims, values, attributes),
        "reflectance_stderr": (dims, np.full_like(values, stderr), attributes),
    }
    axes = dict(zip(dims, (sizes, angles, WAVELENGTHS), strict=True))
    return Table(xr.Dataset(variables, axes, {"path_sharing_axes": path_sharing_axes}))


def test_values_at_nodes_are_exact():
    result = make_table(0.003).interp(optical_radius_um=SIZES[3], incidence_deg=40.0)
    np.testing.assert_allclose(result.reflectance, evaluate_truth(SIZES[3], 40.0), rtol=1e-12)
    np.testing.assert_allclose(result.reflectance_stderr, 0.003, rtol=1e-12)
    assert (result.reflectance_interpolation_error == 0.0).all()


def test_cubic_polynomials_are_interpolated_exactly():
    nodes = np.array([1.0, 1.2, 1.5, 2.0, 2.2, 2.9])
    kind, t = transform_axis("depth_m", nodes)
    assert kind == "identity"
    for x in (1.05, 1.3, 2.1, 2.6):
        w = compute_interpolation_weights("depth_m", nodes, x)
        cubic = 1.0 - 2.0 * t + 0.5 * t**2 + 0.3 * t**3
        assert w.weights @ cubic[w.nodes] == pytest.approx(1 - 2 * x + 0.5 * x**2 + 0.3 * x**3)
        estimates = estimate_error_weights("depth_m", nodes, x)[:N_VALIDATION_NODES]
        np.testing.assert_allclose(estimates @ cubic, 0.0, atol=1e-12)
        # The error estimate of a quartic is exact.
        fourth = t**4
        error = x**4 - w.weights @ fourth[w.nodes]
        np.testing.assert_allclose(np.abs(estimates @ fourth), abs(error), rtol=1e-9)


def test_the_interpolation_error_is_estimated():
    """The largest estimate is 0.5 to 10 times the largest error."""
    random = np.random.default_rng(1)
    estimates, errors = [], []
    for _ in range(200):
        size = float(np.exp(random.uniform(np.log(SIZES[0]), np.log(SIZES[-1]))))
        angle = float(random.uniform(ANGLES[0], ANGLES[-1]))
        result = make_table().interp(optical_radius_um=size, sza=angle)
        estimates.append(result.reflectance_interpolation_error.values)
        errors.append(np.abs(result.reflectance.values - evaluate_truth(size, angle)))
    estimates, errors = np.ravel(estimates), np.ravel(errors)
    assert np.mean(errors <= estimates) > 0.68
    assert np.mean(errors <= 2.0 * estimates + 1e-5) > 0.95
    assert 0.5 * errors.max() < estimates.max() < 10.0 * errors.max()


def test_error_between_two_nodes_is_conservative():
    table = make_table(angles=np.array([0.0, 60.0]))
    result = table.interp(optical_radius_um=SIZES[2], incidence_deg=np.degrees(np.arccos(0.75)))
    difference = np.abs(evaluate_truth(SIZES[2], 60.0) - evaluate_truth(SIZES[2], 0.0))
    np.testing.assert_allclose(result.reflectance_interpolation_error, 0.25 * difference, rtol=1e-9)


@pytest.mark.parametrize("n_nodes", [3, 4])
def test_the_error_is_estimated_with_few_nodes(n_nodes):
    table = make_table(angles=np.linspace(0.0, 70.0, n_nodes))
    random = np.random.default_rng(2)
    estimates, errors = [], []
    for angle in random.uniform(0.0, 70.0, 50):
        result = table.interp(optical_radius_um=SIZES[4], incidence_deg=float(angle))
        estimates.append(result.reflectance_interpolation_error.values)
        errors.append(np.abs(result.reflectance.values - evaluate_truth(SIZES[4], angle)))
    estimates, errors = np.ravel(estimates), np.ravel(errors)
    assert np.mean(errors <= estimates) > 0.95
    assert estimates.max() < 20.0 * errors.max()


def test_errors_of_nodes_are_treated_as_correlated():
    """Nodes use the same paths or random numbers, so errors do not decrease between nodes."""
    point = {"optical_radius_um": float(np.sqrt(SIZES[4] * SIZES[5])), "incidence_deg": 30.0}
    result = make_table(0.003).interp(**point)
    node_error = np.sqrt(result.reflectance_stderr**2 - result.reflectance_interpolation_error**2)
    assert ((node_error > 0.003 * (1.0 - 1e-9)) & (node_error < 1.3 * 0.003)).all()


def test_errors_of_nodes_do_not_cancel():
    table = make_table(0.001, sizes=np.array([100.0, 200.0, 400.0, 800.0]))
    table.dataset.reflectance_stderr[:2] = 0.0003
    table.dataset.reflectance_stderr[2:] = 0.0013
    result = table.interp(optical_radius_um=140.0, incidence_deg=0.0)
    node_error = np.sqrt(result.reflectance_stderr**2 - result.reflectance_interpolation_error**2)
    np.testing.assert_allclose(node_error, 0.00051, rtol=0.03)


def test_wavelengths_are_interpolated():
    result = make_table().interp(
        optical_radius_um=100.0, incidence_deg=0.0, wavelength=[500.0, 700.0]
    )
    assert result.wavelength.values.tolist() == [500.0, 700.0]
    assert result.reflectance_interpolation_error[0] < result.reflectance_interpolation_error[1]


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ({"optical_radius_um": 20.0, "incidence_deg": 0.0}, "optical_radius_um = 20.0: must be fr"),
        ({"optical_radius_um": 100.0, "incidence_deg": 80.0}, "incidence_deg = 80.0: must be from"),
        ({"optical_radius_um": 100.0}, "incidence_deg = None: must be given"),
        ({"radius": 100.0}, "radius: unknown key"),
        ({"optical_radius_um": "fine", "incidence_deg": 0.0}, "optical_radius_um = 'fine'"),
        (
            {"optical_radius_um": 100.0, "incidence_deg": [0.0, 9.0]},
            "incidence_deg = .*must be",
        ),
        (
            {"optical_radius_um": 100.0, "incidence_deg": xr.DataArray([9.0], dims="pixel")},
            "incidence_deg = .*must be one number from .*repeat the call",
        ),
        (
            {"optical_radius_um": 100.0, "incidence_deg": 0.0, "wavelength": 400.0},
            "wavelength = 40",
        ),
    ],
)
def test_points_outside_the_table_are_rejected(point, message):
    with pytest.raises(InvalidValue, match=rf"^{message}"):
        make_table().interp(**point)


def test_a_dataset_other_than_a_table_is_rejected():
    with pytest.raises(
        InvalidValue, match=r"^table = 'a dataset': must be what splits.build_table"
    ):
        Table(xr.Dataset())


@pytest.mark.parametrize(
    ("name", "nodes", "kind"),
    [
        ("incidence_deg", [0.0, 60.0], "cosine"),
        ("optical_radius_um", [30.0, 2000.0], "logarithm"),
        ("impurities_ng_g", [0.0, 10.0, 100.0], "square_root"),
        ("density_kg_m3", [200.0, 300.0], "identity"),
        ("wavelength", [400.0, 2500.0], "identity"),
    ],
)
def test_transforms_of_axes(name, nodes, kind):
    actual, transformed = transform_axis(name, np.array(nodes))
    assert actual == kind
    assert (np.diff(transformed) > 0.0).all()
    np.testing.assert_array_equal(transformed, apply_axis_transform(kind, np.array(nodes)))


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({}, r"grid = \{\}: must be a mapping"),
        ({"depth_m": []}, r"grid.depth_m = \[\]: must be a list"),
        ({"depth_m": [1.0, 1.0]}, r"grid.depth_m = .*different"),
        ({"depth_m": [2.0, 1.0]}, r"grid.depth_m = .*increasing"),
        ({"depth_m": [1.0, "a"]}, r"grid.depth_m = .*numbers or text"),
        ({"depth_m": [1.0, np.inf]}, r"grid.depth_m = .*increasing numbers"),
        ({"depth_m": "deep"}, r"grid.depth_m = 'deep'"),
    ],
)
def test_invalid_axes_are_rejected(grid, message):
    with pytest.raises(InvalidValue, match=f"^{message}"):
        ParameterGrid.from_mapping(grid)


def test_the_error_in_a_direction_includes_that_at_the_angles_beside_it():
    """It vanishes at one polar angle, where it changes its sign, and is local."""
    angles = np.array([0.0, 30.0, 60.0])
    positions = np.sort([*angles, 7.5, 22.5, 37.5, 52.5])
    polar = np.arange(0.0, 81.0, 10.0)
    values = np.zeros((positions.size, polar.size, 1))
    between = ~np.isin(positions, angles)
    values[between, 3], values[between, 5] = 0.01, -0.01
    comparison = xr.DataArray(
        values, {"incidence_deg": positions, "polar_deg": polar},
        ("incidence_deg", "polar_deg", "wavelength"),
    )  # fmt: skip
    axis = AxisInterpolation("incidence_deg", angles, 1, has_direction=True, comparison=comparison)
    weights = axis.compute_weights(7.5)
    errors = {x: axis.measure_error(7.5, weights, {"polar_deg": x}) for x in (30.0, 40.0, 80.0)}
    assert errors[30.0].magnitude >= abs(errors[30.0].signed) >= 0.0099
    assert errors[40.0].signed == 0.0 and errors[40.0].magnitude > 0.003
    assert errors[80.0].magnitude < 0.0012


@pytest.mark.parametrize(
    ("n_nodes", "by_ordinates", "compared"),
    [(2, True, [0, 1]), (3, True, [0, 1, 2]), (7, True, [0, 2, 4, 6]), (7, False, [0, 3, 6]),
     (21, True, [0, 5, 10, 15, 20])],
)  # fmt: skip
def test_every_second_node_of_the_other_axes_is_compared(n_nodes, by_ordinates, compared):
    """The error along soot may change its sign more than once with the depth."""
    depths = np.arange(1.0, n_nodes + 1.0)
    grid = ParameterGrid(("soot", "depth_m"), ((0.0, 30.0, 200.0), tuple(depths.tolist())))
    found = list_comparison_grids(grid, ["soot"], by_ordinates=by_ordinates)["soot"]
    np.testing.assert_array_equal(found.get_values("depth_m", None), depths[compared])
