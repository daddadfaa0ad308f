"""Tables: interpolation, derivatives, order of axes, and solutions by discrete ordinates."""

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from formula_tables import make_snowlike_table, make_table

import splits
from splits.analysis.theory.phase_function import to_eradiate
from splits.core.validation import InvalidValue
from splits.tables.axes import ParameterGrid
from splits.tables.comparison import list_comparison_grids
from splits.tables.interpolation import (
    N_VALIDATION_NODES,
    AxisInterpolation,
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


def make_smooth_table(
    stderr=0.0, sizes=SIZES, angles=ANGLES, path_sharing_axes="optical_radius_um"
):
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
    result = make_smooth_table(0.003).interp(optical_radius_um=SIZES[3], incidence_deg=40.0)
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
        result = make_smooth_table().interp(optical_radius_um=size, sza=angle)
        estimates.append(result.reflectance_interpolation_error.values)
        errors.append(np.abs(result.reflectance.values - evaluate_truth(size, angle)))
    estimates, errors = np.ravel(estimates), np.ravel(errors)
    assert np.mean(errors <= estimates) > 0.68
    assert np.mean(errors <= 2.0 * estimates + 1e-5) > 0.95
    assert 0.5 * errors.max() < estimates.max() < 10.0 * errors.max()


def test_error_between_two_nodes_is_conservative():
    table = make_smooth_table(angles=np.array([0.0, 60.0]))
    result = table.interp(optical_radius_um=SIZES[2], incidence_deg=np.degrees(np.arccos(0.75)))
    difference = np.abs(evaluate_truth(SIZES[2], 60.0) - evaluate_truth(SIZES[2], 0.0))
    np.testing.assert_allclose(result.reflectance_interpolation_error, 0.25 * difference, rtol=1e-9)


@pytest.mark.parametrize("n_nodes", [3, 4])
def test_the_error_is_estimated_with_few_nodes(n_nodes):
    table = make_smooth_table(angles=np.linspace(0.0, 70.0, n_nodes))
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
    result = make_smooth_table(0.003).interp(**point)
    node_error = np.sqrt(result.reflectance_stderr**2 - result.reflectance_interpolation_error**2)
    assert ((node_error > 0.003 * (1.0 - 1e-9)) & (node_error < 1.3 * 0.003)).all()


def test_errors_of_nodes_do_not_cancel():
    table = make_smooth_table(0.001, sizes=np.array([100.0, 200.0, 400.0, 800.0]))
    table.dataset.reflectance_stderr[:2] = 0.0003
    table.dataset.reflectance_stderr[2:] = 0.0013
    result = table.interp(optical_radius_um=140.0, incidence_deg=0.0)
    node_error = np.sqrt(result.reflectance_stderr**2 - result.reflectance_interpolation_error**2)
    np.testing.assert_allclose(node_error, 0.00051, rtol=0.03)


def test_wavelengths_are_interpolated():
    result = make_smooth_table().interp(
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
        make_smooth_table().interp(**point)


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
    grid = ParameterGrid({"soot": (0.0, 30.0, 200.0), "depth_m": tuple(depths.tolist())})
    found = list_comparison_grids(grid, ["soot"], by_ordinates=by_ordinates)["soot"]
    np.testing.assert_array_equal(found["depth_m"], depths[compared])


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

    dataset = splits.build_table(
        make_snow, grid, [800.0, 1030.0], max_stderr=0.01, covariance=True
    ).dataset
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
        make_snow(150.0),
        [800.0, 1030.0],
        0,
        max_stderr=0.004,
        seed=7,
        jacobian=["optical_radius_um"],
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


SIZE, SOOT, ANGLE = "optical_radius_um", "impurities_ng_g.black_carbon", "incidence_deg"
FIXED = {SIZE: 300.0, SOOT: 50.0, ANGLE: 33.0}


@pytest.fixture(scope="module")
def dataset():
    return make_snowlike_table().dataset


def shuffle(ds):
    random = np.random.default_rng(1)
    return ds.isel({name: random.permutation(ds.sizes[name]) for name in ds.dims})


def convert_through_pandas(ds):
    return ds.to_dataframe().to_xarray().assign_attrs(ds.attrs)


def to_object_labels(ds):
    return ds.assign_coords({ANGLE: (ANGLE, ds[ANGLE].values.astype(object))})


CONVERSIONS = {
    "unchanged": lambda ds: ds,
    "one axis descends": lambda ds: ds.sortby(ANGLE, ascending=False),
    "all axes descend": lambda ds: ds.sortby(list(ds.dims), ascending=False),
    "shuffled": shuffle,
    "transposed": lambda ds: ds.transpose("wavelength", ...),
    "through pandas": convert_through_pandas,
    "numbers as objects": to_object_labels,
    "whole numbers": lambda ds: ds.assign_coords({ANGLE: ds[ANGLE].astype(int)}),
    "several of these": lambda ds: convert_through_pandas(shuffle(ds)).transpose("wavelength", ...),
}


@pytest.mark.parametrize("conversion", CONVERSIONS)
def test_table_results_are_independent_of_axis_order(conversion, dataset):
    original, converted = splits.Table(dataset), splits.Table(CONVERSIONS[conversion](dataset))
    for evaluate in (
        lambda table: table.interp(**FIXED),
        lambda table: table.interp(**FIXED, wavelength=[777.0]),
        lambda table: table.derivatives([SIZE, SOOT], **FIXED),
        lambda table: table.to_isofit(**{SOOT: 0.0}),
    ):
        expected, actual = evaluate(original), evaluate(converted)
        xr.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-15)
    assert converted.axes[-1] == "wavelength" and set(converted.axes) == set(original.axes)


@pytest.mark.parametrize("conversion", ["all axes descend", "shuffled", "transposed"])
def test_table_files_may_have_any_axis_order(conversion, dataset, tmp_path, monkeypatch):
    splits.save(CONVERSIONS[conversion](dataset), tmp_path / "table.nc")
    expected = splits.Table(dataset).interp(**FIXED)
    for limit in (2**28, 1):
        monkeypatch.setattr("splits.tables.table.MAX_BYTES_IN_MEMORY", limit)
        actual = splits.Table(tmp_path / "table.nc").interp(**FIXED)
        xr.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-15)


def test_subsets_of_a_table_are_interpolated(dataset):
    point = {name: value for name, value in FIXED.items() if name != ANGLE}
    subset = splits.Table(dataset.isel({ANGLE: 1, "wavelength": [4, 2]}))
    expected = splits.Table(dataset).interp(**FIXED | {ANGLE: 30.0}, wavelength=[700.0, 900.0])
    np.testing.assert_allclose(subset.interp(**point).reflectance, expected.reflectance, rtol=1e-9)


INVALID_TABLES = {
    "no dataset": (
        lambda ds: ds.reflectance,
        "table = 'DataArray': must be what splits.build_table",
    ),
    "a table": (splits.Table, "table = 'Table': must be"),
    "another dataset": (lambda ds: ds.drop_attrs(), "table = 'a dataset': must be"),
    "values alone": (lambda ds: ds[["reflectance"]], "with a quantity and its error"),
    "one wavelength": (lambda ds: ds.isel(wavelength=0), r"over wavelength \(select a list"),
    "no values of an axis": (lambda ds: ds.drop_vars(ANGLE), f"table.{ANGLE} = None: must be"),
    "gaps": (lambda ds: ds.reindex({ANGLE: [0.0, 10.0]}), "table.reflectance = nan: must be a num"),
    "a gap in an axis": (lambda ds: ds.assign_coords({ANGLE: [0.0, np.nan, 60.0]}),
                         f"table.{ANGLE} = .*: must be numbers, or texts"),
    "a node twice": (lambda ds: ds.isel({ANGLE: [0, 0, 1]}), f"table.{ANGLE} = .*different values"),
}  # fmt: skip


@pytest.mark.parametrize("name", INVALID_TABLES)
def test_incomplete_tables_are_rejected_on_construction(name, dataset):
    change, message = INVALID_TABLES[name]
    with pytest.raises(InvalidValue, match=message):
        splits.Table(change(dataset))


ORDERS = {
    "descending": lambda ds: ds.sortby("order", ascending=False),
    "transposed": lambda ds: ds.transpose(),
}


@NEEDS_JIT
@pytest.mark.parametrize("function", [splits.phase_function, splits.with_diffraction, to_eradiate])
def test_moments_may_have_any_order(function):
    optics = splits.single_scattering(splits.Snow(), [500, 900], moments=64, rays=1000)
    for change in ORDERS.values():
        xr.testing.assert_equal(function(change(optics)), function(optics))
    with pytest.raises(InvalidValue, match=r"optics.order = \[0, 2, 4, .*: must be 0, 1, 2"):
        function(optics.isel(order=slice(0, None, 2)))


@pytest.mark.parametrize("name", ["reflectance", "reflectance_stderr", "wavelength", "batch", ""])
def test_axes_have_names_of_their_own(name):
    with pytest.raises(InvalidValue, match=r"grid = .*must be names that no quantity"):
        ParameterGrid.from_mapping({name: [0.0, 1.0]})


def test_names_of_media_and_bands_are_texts_of_files():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    with pytest.raises(InvalidValue, match="must be texts that files in UTF-8 hold"):
        splits.spectrophotometer({"\ud800": snow}, [500.0])


GRID = {
    "optical_radius_um": [50.0, 200.0, 800.0],
    "incidence_deg": [0.0, 60.0, 85.0],
    "liquid_water_content": [0.0, 0.05],
    "ground": [0.2, 0.6],
}
SOLVED_NM = [500.0, 1030.0, 1500.0]


def test_table_equals_single_spectra():
    quantities = ["reflectance", "transmittance"]
    with pytest.warns(UserWarning, match=r"along depth_m between 0.02 and 0.3 has an error of 0"):
        table = splits.build_table(
            splits.Snow.natural, {**GRID, "depth_m": [0.02, 0.3]}, SOLVED_NM, max_stderr=0.001,
            solver="discrete_ordinates", quantities=quantities,
        ).dataset  # fmt: skip
    assert table.attrs["solver"] == "discrete_ordinates"
    assert not table.isnull().any().to_array().any()
    for radius, angle, water in ((50.0, 0.0, 0.0), (800.0, 85.0, 0.05)):
        snow = splits.Snow.natural(
            optical_radius_um=radius, liquid_water_content=water, ground=0.6, depth_m=0.02
        )
        single = splits.spectrophotometer(
            snow, SOLVED_NM, angle, max_stderr=0.001, solver="discrete_ordinates"
        )
        node = table.sel(
            optical_radius_um=radius, incidence_deg=angle, liquid_water_content=water, ground=0.6,
            depth_m=0.02,
        )  # fmt: skip
        for name in quantities:
            # The number of streams of the table is that of all angles of incidence.
            error = node[f"{name}_stderr"].values + single[f"{name}_stderr"].values
            assert (np.abs(node[name].values - single[name].values) <= error).all()


def test_diffuse_light_is_an_incidence():
    table = splits.build_table(
        splits.Snow.natural, {"optical_radius_um": [100.0, 200.0]}, SOLVED_NM, "diffuse",
        solver="auto",
    ).dataset  # fmt: skip
    snow = splits.Snow.natural(optical_radius_um=200.0)
    single = splits.spectrophotometer(snow, SOLVED_NM, "diffuse", max_stderr=0.003, solver="auto")
    np.testing.assert_allclose(table.reflectance[1], single.reflectance, rtol=1e-6)


@NEEDS_JIT
def test_tables_of_other_grains_equal_single_spectra():
    def make(depth_m):
        return splits.Snow(depth_m=depth_m, saturation=0.0, interpretation="radiative_transfer")

    settings = {"max_stderr": 0.02, "solver": "discrete_ordinates"}
    table = splits.build_table(
        make, {"depth_m": [0.02, 0.05]}, [1300.0], threads=2, **settings
    ).dataset
    single = splits.spectrophotometer(make(0.05), [1300.0], **settings)
    assert table.attrs["solver"] == single.attrs["solver"] == "discrete_ordinates"
    np.testing.assert_allclose(table.reflectance[1], single.reflectance, rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (
            {"make": splits.Snow, "grid": {"depth_m": [0.1, 0.2]}},
            "no equation of radiative transfer",
        ),
        ({"covariance": True}, "a covariance needs batches of rays"),
    ],
)
def test_refusals_give_the_reason(settings, reason):
    arguments = {"make": splits.Snow.natural, "grid": {"optical_radius_um": [100.0, 200.0]}}
    with pytest.raises(ValueError, match=reason):
        splits.build_table(
            **{**arguments, **settings}, wavelength_nm=SOLVED_NM, solver="discrete_ordinates"
        )
