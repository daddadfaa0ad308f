"""Stated errors of interpolated tables against solutions at random points between their nodes."""

import itertools
import warnings

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, compute_z_bound

import splits
from splits.illumination.bands import SpectralOperator, check_bands
from splits.tables.axes import ALONG
from splits.tables.interpolation import compute_interpolation_weights, estimate_error_weights

WAVELENGTHS = np.array([400.0, 500.0, 800.0, 1030.0, 1300.0, 1600.0])
VIEW_WAVELENGTHS = np.array([600.0, 1300.0])


def make_snow(soot=0.0, dust=0.0, **more):
    defaults = {"density_kg_m3": 300.0, "optical_radius_um": 100.0}
    impurities = {"black_carbon": soot, "dust_colorado": dust}
    return splits.Snow.natural(impurities_ng_g=impurities, **(defaults | more))


def make_thin_snow(**more):
    return make_snow(**({"depth_m": 0.02} | more))


PAGE_GRID = {
    "optical_radius_um": [50, 100, 200, 400, 800], "incidence_deg": [0, 40, 70],
    "soot": [0, 50, 500],
}  # fmt: skip
EXPLORER_GRID = {
    "optical_radius_um": np.geomspace(50, 1000, 6), "depth_m": np.geomspace(0.01, 0.3, 7),
    "ground": [0, 0.25, 0.5, 0.75, 1], "soot": [0, 30, 200, 1000],
}  # fmt: skip
GRIDS = {
    "soot, coarse": (make_snow, {"soot": [0, 50, 500]}),
    "soot, fine": (make_snow, {"soot": [0, 10, 30, 100, 300, 1000]}),
    "dust, coarse": (make_snow, {"dust": [0, 1e5, 2e6]}),
    "dust, fine": (make_snow, {"dust": [0, 3e4, 1.5e5, 5e5, 2e6]}),
    "ground, coarse": (make_thin_snow, {"ground": [0, 0.5, 1]}),
    "ground, fine": (make_thin_snow, {"ground": [0, 0.25, 0.5, 0.75, 1]}),
    "depth, coarse": (make_snow, {"depth_m": [0.01, 0.05, 0.2, 1]}),
    "depth, fine": (make_snow, {"depth_m": [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1]}),
    "size, coarse": (make_snow, {"optical_radius_um": [50, 150, 450, 1350]}),
    "size, fine": (make_snow, {"optical_radius_um": np.geomspace(30, 2000, 9)}),
    "density, coarse": (make_thin_snow, {"density_kg_m3": [100, 250, 450]}),
    "density, fine": (make_thin_snow, {"density_kg_m3": [100, 150, 200, 300, 450]}),
    "water, coarse": (make_snow, {"liquid_water_content": [0, 0.03, 0.08]}),
    "water, fine": (make_snow, {"liquid_water_content": [0, 0.01, 0.02, 0.04, 0.07, 0.1]}),
    "sun, coarse": (make_snow, {"incidence_deg": [0, 40, 70]}),
    "sun, fine": (make_snow, {"incidence_deg": [0, 30, 60, 75, 85, 89]}),
    "page": (make_snow, PAGE_GRID),
    "explorer": (make_snow, EXPLORER_GRID),
}
VIEW_GRIDS = {
    "view, coarse": {"polar_deg": [0, 20, 40, 60], "azimuth_deg": [0, 30, 60, 90, 120, 150, 180]},
    "view, fine": {"polar_deg": [0, 10, 20, 30, 40, 50, 60, 70, 75, 80, 85],
                   "azimuth_deg": [0, 30, 60, 90, 120, 150, 180]},
    "azimuth, coarse": {"polar_deg": [0, 15, 30, 45, 60], "azimuth_deg": [0, 90, 180]},
    "azimuth, fine": {"polar_deg": [0, 15, 30, 45, 60], "azimuth_deg": [0, 60, 120, 180]},
    "page": {"polar_deg": [0, 10, 20, 30, 40], "azimuth_deg": [0, 20, 40, 60, 90, 120, 150, 180]},
}  # fmt: skip


def build(make, grid, wavelengths, max_stderr, **more):
    """Return a table, whether or not its nodes suffice."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "interpolation of")
        return splits.build_table(
            make, grid, wavelengths, max_stderr=max_stderr, threads=1,
            solver="discrete_ordinates", **more,
        ).dataset  # fmt: skip


def solve(make, point, max_stderr):
    """Return the solution at a position."""
    medium = make(**{name: x for name, x in point.items() if name != "incidence_deg"})
    return splits.spectrophotometer(
        medium, WAVELENGTHS, point.get("incidence_deg", 0.0), max_stderr=max_stderr,
        solver="discrete_ordinates", threads=1,
    )  # fmt: skip


def draw_point(random, grid):
    """Return a random position: by the logarithm along axes of wide ranges, also from 0."""
    point = {}
    for name, nodes in grid.items():
        low, high = float(nodes[0]), float(nodes[-1])
        start = low or float(nodes[1]) / 50.0
        if high > 20.0 * start and "deg" not in name:
            point[name] = float(np.exp(random.uniform(np.log(start), np.log(high))))
        else:
            point[name] = float(random.uniform(low, high))
    return point


def judge(name, difference, interpolation_error, other_error):
    """Check and print the errors of all points and wavelengths.

    Errors of nodes are common to the table and to the solutions, by the same solver and mostly as
    many streams, and cancel in part.  The rms z has a lower limit where interpolation dominates, if
    there are enough points for it.
    """
    difference, error, other = (
        np.ravel(rows) for rows in (difference, interpolation_error, other_error)
    )
    z = difference / np.hypot(error, other)
    dominant = error > 2.0 * other
    rms = float(np.sqrt((z[dominant] ** 2).mean())) if dominant.any() else np.nan
    print(
        f"{name}: {z.size} values, rms z {np.sqrt((z**2).mean()):.2f}, largest "
        f"{np.abs(z).max():.1f}; {dominant.mean():.0%} dominated by interpolation: rms z {rms:.2f};"
        f" median stated {np.median(np.hypot(error, other)):.1e}, median difference "
        f"{np.median(np.abs(difference)):.1e}"
    )
    assert np.abs(z).max() < compute_z_bound(z.size)
    assert np.sqrt((z**2).mean()) < 1.2
    if dominant.sum() > 100:
        assert 0.7 < rms < 1.2


def compare_spectra(name, n_points):
    make, grid = GRIDS[name]
    table = splits.Table(build(make, grid, WAVELENGTHS, 3e-4))
    random = np.random.default_rng(1)
    rows = []
    for _ in range(n_points):
        point = draw_point(random, grid)
        exact, found = solve(make, point, 3e-4), table.interp(**point)
        error = found.reflectance_interpolation_error.values
        stderr = found.reflectance_stderr.values
        other = np.hypot(np.sqrt(stderr**2 - error**2), exact.reflectance_stderr.values)
        rows.append(((found.reflectance - exact.reflectance).values, error, other))
    judge(name, *np.swapaxes(rows, 0, 1))


def compare_views(name, n_points):
    """Every solution has four of the points: two polar angles and two azimuths."""
    grid = {"optical_radius_um": [50, 100, 200], "incidence_deg": [40, 50, 60], **VIEW_GRIDS[name]}
    table = splits.Table(
        build(splits.Snow.natural, grid, VIEW_WAVELENGTHS, 0.005, quantities=["reflectance_factor"])
    )
    random = np.random.default_rng(2)
    rows = []
    for _ in range(n_points // 4):
        first, second = draw_point(random, grid), draw_point(random, grid)
        at = {name: first[name] for name in ("optical_radius_um", "incidence_deg")}
        angles = {
            name: sorted([first[name], second[name]]) for name in ("polar_deg", "azimuth_deg")
        }
        exact = splits.goniophotometer(
            splits.Snow.natural(optical_radius_um=at["optical_radius_um"]), VIEW_WAVELENGTHS,
            at["incidence_deg"], **angles, relative_stderr=0.002,
            solver="discrete_ordinates", threads=1,
        )  # fmt: skip
        for polar, azimuth in itertools.product(*angles.values()):
            found = table.interp(**at, polar_deg=polar, azimuth_deg=azimuth)
            solved = exact.sel(polar_deg=polar, azimuth_deg=azimuth)
            error = found.reflectance_factor_interpolation_error.values
            stderr = found.reflectance_factor_stderr.values
            other = np.hypot(np.sqrt(stderr**2 - error**2), np.pi * solved.brdf_stderr.values)
            difference = found.reflectance_factor.values - np.pi * solved.brdf.values
            rows.append((difference, error, other))
    judge(name, *np.swapaxes(rows, 0, 1))


@pytest.mark.parametrize("name", [name for name in GRIDS if "coarse" in name])
def test_errors_between_nodes_cover_the_differences(name):
    compare_spectra(name, 8)


def test_errors_of_interpolation_alone_are_not_too_large():
    """With as many streams, the table and the solutions differ by interpolation alone."""
    z = []
    for name in (name for name in GRIDS if "fine" in name):
        make, grid = GRIDS[name]
        table = splits.Table(build(make, grid, WAVELENGTHS, 3e-5))
        random = np.random.default_rng(4)
        for _ in range(12):
            point = draw_point(random, grid)
            exact, found = solve(make, point, 3e-5), table.interp(**point)
            error = found.reflectance_interpolation_error.values
            # Truncation and single precision have errors of 1e-6.
            is_larger = error > 5e-6
            difference = (found.reflectance - exact.reflectance).values
            z.extend(difference[is_larger] / error[is_larger])
    rms = float(np.sqrt(np.mean(np.square(z))))
    print(f"{len(z)} values, rms z {rms:.2f}, largest {np.abs(z).max():.1f}")
    assert np.abs(z).max() < compute_z_bound(len(z))
    assert 0.7 < rms < 1.2 and len(z) > 100


@pytest.mark.parametrize("name", ["view, coarse", "azimuth, coarse"])
def test_errors_between_directions_cover_the_differences(name):
    compare_views(name, 8)


@pytest.mark.long
@pytest.mark.parametrize("name", GRIDS)
def test_errors_of_2000_points_cover_the_differences(name):
    compare_spectra(name, 2000)


@pytest.mark.long
@pytest.mark.parametrize("name", VIEW_GRIDS)
def test_errors_of_2000_directions_cover_the_differences(name):
    compare_views(name, 2000)


def test_the_square_root_is_not_the_coordinate_of_soot_near_zero():
    """Ice absorbs more than little soot; the coordinate is chosen for every wavelength."""
    table = splits.Table(build(make_snow, {"soot": [0, 50, 500]}, WAVELENGTHS, 0.002))
    axis = table.prepare("reflectance")["soot"]
    chosen = [axis.coordinates[i] for i in axis.choice]
    # Where ice is dark, soot matters little, and linearly.
    assert chosen[0].power < 1.0 and chosen[0].origin < 0.0
    assert len(set(chosen)) > 1
    exact = splits.spectrophotometer(
        make_snow(soot=4.0), WAVELENGTHS, 0.0, max_stderr=1e-4, solver="discrete_ordinates"
    )
    found = table.interp(soot=4.0).reflectance
    np.testing.assert_allclose(found, exact.reflectance, atol=0.001)


def test_tables_without_comparisons_state_larger_errors():
    """Selections of nodes and tables from files of earlier versions have no comparisons."""
    made = build(make_snow, {"soot": [0, 10, 50, 500]}, WAVELENGTHS, 0.002)
    without = made.drop_vars([name for name in made.variables if ALONG in str(name)])
    exact = splits.spectrophotometer(
        make_snow(soot=3.0), WAVELENGTHS, 0.0, max_stderr=1e-4, solver="discrete_ordinates"
    )
    errors = []
    for dataset in (made, without, made.isel(soot=[0, 2, 3])):
        found = splits.Table(dataset).interp(soot=3.0)
        difference = np.abs(found.reflectance - exact.reflectance)
        assert (difference < 3.0 * np.hypot(found.reflectance_stderr, 1e-4)).all()
        errors.append(found.reflectance_interpolation_error.values[0])
    assert errors[0] < errors[1] < errors[2]


def test_a_warning_names_the_axis_and_the_interval_that_needs_nodes():
    message = (
        r"^interpolation of reflectance along ground between 0.5 and 1 has an error of 0.00\d+ at "
        r"\d+ nm, above max_stderr = 0.0001: add nodes there"
    )
    with pytest.warns(UserWarning, match=message) as caught:
        splits.build_table(make_thin_snow, {"ground": [0, 0.5, 1]}, [500, 800], max_stderr=1e-4)
    assert len(caught) == 1 and caught[0].filename == __file__


@NEEDS_JIT
@pytest.mark.parametrize("soot", [1.0, 4.0])
def test_little_soot_is_retrieved_without_bias(soot):
    wavelengths, noise = np.array([400.0, 450, 500, 600, 700, 900, 1030, 1200]), 5e-4
    grid = {"optical_radius_um": [50, 100, 200, 400], "soot": [0, 50, 500]}
    table = splits.Table(build(make_snow, grid, wavelengths, 5e-4))
    exact = splits.spectrophotometer(
        make_snow(soot=soot, optical_radius_um=140.0), wavelengths, 0.0, max_stderr=1e-4,
        solver="discrete_ordinates",
    ).reflectance.values  # fmt: skip
    z = []
    for seed in range(6):
        random = np.random.default_rng(seed)
        measured = exact + noise * random.normal(size=wavelengths.size)
        found = splits.retrieve((wavelengths, measured), table, [*grid], noise).dataset
        found = found.sel(parameter="soot")
        z.append(float((found.value - soot) / found.value_stderr))
    assert abs(np.mean(z)) < 3.0 / np.sqrt(len(z))
    assert np.sqrt(np.mean(np.square(z))) < 2.0


@NEEDS_JIT
def test_errors_of_four_axes_do_not_vanish_in_the_middle_of_one():
    """Over a ground as bright as the snow, the depth has no effect and no error."""

    def make(ssa, depth, soot, ground):
        return splits.Snow.natural(
            specific_surface_area_m2_kg=ssa, depth_m=depth, ground=ground,
            impurities_ng_g={"black_carbon": soot},
        )  # fmt: skip

    grid = {"ssa": [5, 20, 80], "depth": [0.01, 0.03, 0.1, 0.3], "soot": [0, 100, 1000],
            "ground": [0, 0.45, 0.9]}  # fmt: skip
    wavelengths = [500.0, 800.0, 1030.0]
    table = splits.Table(build(make, grid, wavelengths, 0.002))
    random, z = np.random.default_rng(3), []
    for _ in range(20):
        point = {"ssa": random.uniform(5, 80), "depth": np.exp(random.uniform(-4.6, -1.21)),
                 "soot": random.uniform(0, 1000), "ground": random.uniform(0, 0.9)}  # fmt: skip
        found = table.interp(**point)
        expected = splits.spectrophotometer(
            make(**point), wavelengths, max_stderr=2e-4, solver="discrete_ordinates", threads=1
        )
        z.append(compare_results(found, expected, "reflectance"))
    assert np.sqrt(np.mean(np.square(z))) < 1.2
    assert np.abs(z).max() < compute_z_bound(np.size(z))


def test_a_node_that_was_not_compared_has_an_estimated_error():
    grid = {"soot": [0, 50, 500], "ground": [0.0, 0.9]}
    made = build(make_thin_snow, grid, [800.0], 0.002)
    one = splits.Table(made.sel(ground=[0.9]))
    renamed = made.sel(ground=[0.9]).assign_coords(ground_along_soot=[0.0, 0.5])
    assert splits.Table(renamed).interp(soot=20.0).reflectance_interpolation_error >= (
        0.5 * one.interp(soot=20.0).reflectance_interpolation_error
    )


def test_views_under_a_sky_have_measured_errors_along_the_incidence():
    grid = {"optical_radius_um": [50, 200], "incidence_deg": [0, 40, 70],
            "polar_deg": [0, 30, 60], "azimuth_deg": [0, 90, 180]}  # fmt: skip
    quantities = ["reflectance", "reflectance_factor"]
    quantities += [f"diffuse_{name}" for name in quantities]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "interpolation of")
        made = splits.build_table(
            make_snow, grid, [600.0, 1300.0], max_stderr=0.01, threads=1, quantities=quantities
        ).dataset
    table = splits.Table(made).at_view(25, 140, diffuse_fraction=[0.2, 0.1])
    assert f"reflectance_factor{ALONG}incidence_deg" in table.dataset
    at = {"optical_radius_um": 200.0, "incidence_deg": 55.0}
    beam = splits.Table(made).at_view(25, 140).interp(**at)
    found = table.interp(**at)
    ratio = (
        found.reflectance_factor_interpolation_error / beam.reflectance_factor_interpolation_error
    )
    assert ((ratio > 0.3) & (ratio < 3.0)).all()


STEPS_NM = (10, 20, 30, 50, 100, 200)


def test_errors_between_coarse_wavelengths_hold():
    """Wavelengths far apart do not resolve the absorption bands of ice."""
    fine = np.arange(350.0, 2401.0, 5.0)
    spectra = [
        splits.spectrophotometer(
            splits.Snow.natural(specific_surface_area_m2_kg=area), fine, 50.0, max_stderr=0.001
        ).reflectance.values
        for area in (5.0, 20.0, 60.0)
    ]
    values = np.transpose(spectra)
    random = np.random.default_rng(1)
    for step in STEPS_NM:
        nodes = fine[:: int(step / 5)]
        at_nodes = values[:: int(step / 5)]
        places = np.setdiff1d(fine[fine < nodes[-1]], nodes)
        errors = []
        for place in places:
            stencil = compute_interpolation_weights("wavelength", nodes, place)
            deviation = stencil.weights @ at_nodes[stencil.nodes] - values[fine == place][0]
            stated = np.abs(estimate_error_weights("wavelength", nodes, place) @ at_nodes).max(
                axis=0
            )
            errors.append(deviation / np.hypot(stated, 1e-4))
        between = np.sqrt(np.mean(np.square(errors)))
        errors = []
        for width in (60.0, 200.0):
            for low in random.uniform(nodes[0], nodes[-1] - width, 20):
                band = check_bands({"one": (low, low + width)})
                operator = SpectralOperator.from_bands(band, nodes)
                exact = SpectralOperator.from_bands(band, fine).weights @ values
                stated = np.sqrt(((operator.error_weights @ at_nodes) ** 2).sum(axis=0))
                errors.append((operator.weights @ at_nodes - exact) / np.hypot(stated, 1e-4))
        bands = np.sqrt(np.mean(np.square(errors)))
        print(f"every {step} nm: rms z {between:.2f} at wavelengths, {bands:.2f} in bands")
        assert between < 1.6 and bands < 1.6
