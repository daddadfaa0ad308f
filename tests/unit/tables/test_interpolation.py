"""Interpolation of tables: values, error estimates and errors of input."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from splits.core.validation import InvalidValue
from splits.tables.axes import ParameterGrid
from splits.tables.interpolation import (
    apply_axis_transform,
    compute_interpolation_weights,
    transform_axis,
)
from splits.tables.table import Table

WAVELENGTHS = np.array([500.0, 900.0, 1300.0])
SIZES = np.geomspace(30.0, 2000.0, 12)
ANGLES = np.array([0.0, 20.0, 40.0, 55.0, 65.0, 75.0])


def evaluate_truth(size, angle, wavelengths=WAVELENGTHS):
    """Return a function like the reflectance of snow: smooth, and steep at low values."""
    depth = np.sqrt(size / 1e4) * (wavelengths / 700.0) ** 2.5
    return np.exp(-depth * (1.0 + 2.0 * np.cos(np.radians(angle))))


def make_table(stderr=0.0, sizes=SIZES, angles=ANGLES, shared="optical_radius_um"):
    values = np.array([[evaluate_truth(size, angle) for angle in angles] for size in sizes])
    dims = ("optical_radius_um", "incidence_deg", "wavelength")
    about = {"long_name": "hemispherical reflectance"}
    found = {
        "reflectance": (dims, values, about),
        "reflectance_stderr": (dims, np.full_like(values, stderr), about),
    }
    axes = dict(zip(dims, (sizes, angles, WAVELENGTHS), strict=True))
    return Table(xr.Dataset(found, axes, {"path_sharing_axes": shared}))


def test_nodes_are_the_tables_own():
    found = make_table(0.003).interp(optical_radius_um=SIZES[3], incidence_deg=40.0)
    np.testing.assert_allclose(found.reflectance, evaluate_truth(SIZES[3], 40.0), rtol=1e-12)
    np.testing.assert_allclose(found.reflectance_stderr, 0.003, rtol=1e-12)
    assert (found.reflectance_interpolation_error == 0.0).all()


def test_cubics_are_read_exactly():
    nodes = np.array([1.0, 1.2, 1.5, 2.0, 2.2, 2.9])
    kind, at = transform_axis("depth_m", nodes)
    assert kind == "itself"
    for x in (1.05, 1.3, 2.1, 2.6):
        w = compute_interpolation_weights("depth_m", nodes, x)
        cubic = 1.0 - 2.0 * at + 0.5 * at**2 + 0.3 * at**3
        assert w.weights @ cubic[w.nodes] == pytest.approx(1 - 2 * x + 0.5 * x**2 + 0.3 * x**3)
        np.testing.assert_allclose(w.error_weights @ cubic, 0.0, atol=1e-12)
        # What a quartic adds is told to the last digit.
        fourth = at**4
        missed = x**4 - w.weights @ fourth[w.nodes]
        np.testing.assert_allclose(np.abs(w.error_weights @ fourth), abs(missed), rtol=1e-9)


def test_the_interpolation_error_is_estimated():
    """The estimate is between 0.5 and 10 times the largest error."""
    random = np.random.default_rng(1)
    told, missed = [], []
    for _ in range(200):
        size = float(np.exp(random.uniform(np.log(SIZES[0]), np.log(SIZES[-1]))))
        angle = float(random.uniform(ANGLES[0], ANGLES[-1]))
        found = make_table().interp(optical_radius_um=size, sza=angle)
        told.append(found.reflectance_interpolation_error.values)
        missed.append(np.abs(found.reflectance.values - evaluate_truth(size, angle)))
    told, missed = np.ravel(told), np.ravel(missed)
    assert np.mean(missed <= told) > 0.68
    assert np.mean(missed <= 2.0 * told + 1e-5) > 0.95
    assert 0.5 * missed.max() < told.max() < 10.0 * missed.max()


def test_of_two_nodes_a_quarter_of_their_difference_is_doubtful():
    two = make_table(angles=np.array([0.0, 60.0]))
    found = two.interp(optical_radius_um=SIZES[2], incidence_deg=np.degrees(np.arccos(0.75)))
    ends = np.abs(evaluate_truth(SIZES[2], 60.0) - evaluate_truth(SIZES[2], 0.0))
    np.testing.assert_allclose(found.reflectance_interpolation_error, 0.25 * ends, rtol=1e-9)


@pytest.mark.parametrize("count", [3, 4])
def test_the_error_is_estimated_with_few_nodes(count):
    few = make_table(angles=np.linspace(0.0, 70.0, count))
    random = np.random.default_rng(2)
    told, missed = [], []
    for angle in random.uniform(0.0, 70.0, 50):
        found = few.interp(optical_radius_um=SIZES[4], incidence_deg=float(angle))
        told.append(found.reflectance_interpolation_error.values)
        missed.append(np.abs(found.reflectance.values - evaluate_truth(SIZES[4], angle)))
    told, missed = np.ravel(told), np.ravel(missed)
    assert np.mean(missed <= told) > 0.95
    assert told.max() < 20.0 * missed.max()


def test_errors_of_nodes_are_taken_as_correlated():
    """Nodes share paths or random numbers, so errors are not smaller between nodes."""
    between = {"optical_radius_um": float(np.sqrt(SIZES[4] * SIZES[5])), "incidence_deg": 30.0}
    found = make_table(0.003).interp(**between)
    cells = np.sqrt(found.reflectance_stderr**2 - found.reflectance_interpolation_error**2)
    assert ((cells > 0.003 * (1.0 - 1e-9)) & (cells < 1.3 * 0.003)).all()


def test_errors_of_nodes_do_not_cancel():
    uneven = make_table(0.001, sizes=np.array([100.0, 200.0, 400.0, 800.0]))
    uneven.dataset.reflectance_stderr[:2] = 0.0003
    uneven.dataset.reflectance_stderr[2:] = 0.0013
    found = uneven.interp(optical_radius_um=140.0, incidence_deg=0.0)
    cells = np.sqrt(found.reflectance_stderr**2 - found.reflectance_interpolation_error**2)
    np.testing.assert_allclose(cells, 0.00051, rtol=0.03)


def test_wavelengths_between_those_of_the_table():
    found = make_table().interp(
        optical_radius_um=100.0, incidence_deg=0.0, wavelength=[500.0, 700.0]
    )
    assert found.wavelength.values.tolist() == [500.0, 700.0]
    assert found.reflectance_interpolation_error[0] < found.reflectance_interpolation_error[1]


@pytest.mark.parametrize(
    ("at", "line"),
    [
        ({"optical_radius_um": 20.0, "incidence_deg": 0.0}, "optical_radius_um = 20.0: must be fr"),
        ({"optical_radius_um": 100.0, "incidence_deg": 80.0}, "incidence_deg = 80.0: must be from"),
        ({"optical_radius_um": 100.0}, "incidence_deg = None: must be given"),
        ({"radius": 100.0}, "radius: unknown key"),
        ({"optical_radius_um": "fine", "incidence_deg": 0.0}, "optical_radius_um = 'fine'"),
        (
            {"optical_radius_um": 100.0, "incidence_deg": 0.0, "wavelength": 400.0},
            "wavelength = 40",
        ),
    ],
)
def test_points_outside_the_table_are_rejected(at, line):
    with pytest.raises(InvalidValue, match=rf"^{line}"):
        make_table().interp(**at)


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
        ("impurities_ng_g", [0.0, 10.0, 100.0], "root"),
        ("density_kg_m3", [200.0, 300.0], "itself"),
        ("wavelength", [400.0, 2500.0], "itself"),
    ],
)
def test_transforms_of_axes(name, nodes, kind):
    found, at = transform_axis(name, np.array(nodes))
    assert found == kind
    assert (np.diff(at) > 0.0).all()
    np.testing.assert_array_equal(at, apply_axis_transform(kind, np.array(nodes)))


@pytest.mark.parametrize(
    ("grid", "line"),
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
def test_invalid_axes_are_rejected(grid, line):
    with pytest.raises(InvalidValue, match=f"^{line}"):
        ParameterGrid.from_mapping(grid)
