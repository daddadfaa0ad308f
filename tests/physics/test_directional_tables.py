"""Tables with directions: energy, reciprocity, both solvers, errors of anisotropy factors."""

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, compare_results, compute_z_bound, judge_z

import splits

# The nodes are coarse, which does not matter at nodes.
pytestmark = pytest.mark.filterwarnings("ignore:interpolation of:UserWarning")
WAVELENGTHS = [600.0, 1030.0, 1500.0]
ZENITHS = [0.0, 20.0, 40.0, 60.0]
AZIMUTHS = [0.0, 45.0, 90.0, 135.0, 180.0]
SIZES = [60.0, 200.0]
DIRECTIONAL = ("reflectance_factor", "anisotropy_factor")
ALL = ("reflectance", *DIRECTIONAL, "diffuse_reflectance", "diffuse_reflectance_factor",
       "diffuse_anisotropy_factor")  # fmt: skip


def make_snow(optical_radius_um: float = 100.0, **more) -> splits.Snow:
    return splits.Snow.natural(optical_radius_um=optical_radius_um, **more)


def build(solver: str, max_stderr: float, seed: int = 1, **changes) -> xr.Dataset:
    """Return a table of two sizes of deep snow."""
    grid = {
        "optical_radius_um": SIZES, "incidence_deg": ZENITHS, "polar_deg": ZENITHS,
        "azimuth_deg": AZIMUTHS,
    }  # fmt: skip
    return splits.build_table(
        make_snow, grid | changes, WAVELENGTHS, max_stderr=max_stderr, seed=seed, solver=solver,
        quantities=ALL,
    ).dataset  # fmt: skip


@pytest.fixture(scope="module")
def solved() -> xr.Dataset:
    return build("discrete_ordinates", 0.005)


@pytest.fixture(scope="module")
def traced() -> xr.Dataset:
    return build("monte_carlo", 0.03)


@pytest.fixture(scope="module")
def reflectances() -> xr.Dataset:
    """Return the reflectances of paths of other seeds."""
    beams = {"optical_radius_um": SIZES, "incidence_deg": ZENITHS}
    return splits.build_table(
        make_snow, beams, WAVELENGTHS, max_stderr=0.003, seed=3, solver="monte_carlo"
    ).dataset


def integrate(factor: xr.DataArray) -> xr.DataArray:
    """Return the hemispherical integral of reflectance factors, from Gaussian polar angles."""
    nodes, weights = np.polynomial.legendre.leggauss(factor.sizes["polar_deg"])
    # Gaussian in the square of the cosine, whose differential is the projected solid angle.
    assert np.allclose(np.cos(np.radians(factor.polar_deg)) ** 2, 0.5 * (1.0 - nodes))
    mean = factor.integrate("azimuth_deg") / 180.0
    return (mean * xr.DataArray(0.5 * weights, dims="polar_deg")).sum("polar_deg")


@NEEDS_JIT
@pytest.mark.parametrize("solver", ["discrete_ordinates", "monte_carlo"])
def test_hemispherical_integral_is_the_reflectance(solver, reflectances):
    """Of the same table, and within errors of an independent table of reflectances."""
    nodes, _ = np.polynomial.legendre.leggauss(16)
    views = {
        "polar_deg": np.degrees(np.arccos(np.sqrt(0.5 * (1.0 - nodes)))),
        "azimuth_deg": np.arange(0.0, 181.0, 7.5),
    }
    table = build(solver, 0.01 if solver == "discrete_ordinates" else 0.045, **views)
    integral = integrate(table.reflectance_factor)
    np.testing.assert_allclose(integral, table.reflectance, rtol=1e-3, atol=5e-5)
    np.testing.assert_allclose(integrate(table.anisotropy_factor), 1.0, atol=4e-3)
    stderr = np.hypot(table.reflectance_stderr, reflectances.reflectance_stderr)
    z = (integral - reflectances.reflectance) / stderr
    judge_z(z.values, "integral", independent=4, bound_added=True)


@NEEDS_JIT
def test_both_solvers_agree(solved, traced):
    for name in ALL:
        # Directions of one beam and of all wavelengths share paths.
        judge_z(compare_results(solved, traced, name), name, independent=4, bound_added=True)


@NEEDS_JIT
def test_reflectance_factors_are_reciprocal(solved, traced):
    def exchange(values: xr.DataArray) -> xr.DataArray:
        swapped = {"incidence_deg": "polar_deg", "polar_deg": "incidence_deg"}
        return values.rename(swapped).transpose(*values.dims)

    factor = solved.reflectance_factor
    np.testing.assert_allclose(factor, exchange(factor), rtol=1e-6)
    factor, stderr = traced.reflectance_factor, traced.reflectance_factor_stderr
    z = (factor - exchange(factor)) / np.hypot(stderr, exchange(stderr))
    upper = z.values[:, *np.triu_indices(len(ZENITHS), 1)]
    judge_z(upper, "reciprocity", independent=4, bound_added=True)


@NEEDS_JIT
def test_isotropic_light_agrees_with_the_integral_over_beams(solved):
    """By reciprocity, the factor under isotropic light is the reflectance of a beam."""
    reflectance = solved.reflectance.rename(incidence_deg="polar_deg")
    factor = solved.diffuse_reflectance_factor
    np.testing.assert_allclose(factor, reflectance.transpose(*factor.dims), rtol=1e-4, atol=1e-6)
    anisotropy = factor / solved.diffuse_reflectance
    np.testing.assert_allclose(solved.diffuse_anisotropy_factor, anisotropy, rtol=1e-5)


@NEEDS_JIT
def test_anisotropy_factor_is_the_quotient(solved, traced):
    for table in (solved, traced):
        quotient = table.reflectance_factor / table.reflectance
        # The reflectance of the quotient may be solved with more streams.
        difference = np.abs(table.anisotropy_factor / quotient - 1.0)
        assert (difference <= 1e-4 + table.reflectance_stderr / table.reflectance).all()
        # Its error is not larger than that of independent errors of both.
        independent = quotient * np.hypot(
            table.reflectance_factor_stderr / table.reflectance_factor,
            table.reflectance_stderr / table.reflectance,
        )
        gain = (independent / table.anisotropy_factor_stderr).values
        print(f"{table.attrs['solver']}: median gain {np.median(gain):.2f}, most {gain.max():.2f}")
        assert np.median(gain) >= 1.0


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_errors_of_anisotropy_factors_agree_with_the_scatter_of_seeds():
    """About the solution of the equation, as errors include those of truncated polynomials."""
    snow = make_snow(depth_m=0.05)
    wavelengths = [600.0, 1030.0, 1300.0]
    views = {"polar_deg": ZENITHS, "azimuth_deg": AZIMUTHS}
    exact = splits.goniophotometer(
        snow, wavelengths, 40.0, solver="discrete_ordinates", relative_stderr=0.001, **views
    )
    runs = [
        splits.goniophotometer(
            snow, wavelengths, 40.0, rays=60_000, seed=seed, solver="monte_carlo", **views
        )
        for seed in range(40)
    ]
    for name in DIRECTIONAL:
        values, stated = (
            np.stack([run[key].values for run in runs]) for key in (name, f"{name}_stderr")
        )
        z = (values - exact[name].values) / np.hypot(stated, exact[f"{name}_stderr"].values)
        rms = float(np.sqrt((z**2).mean()))
        print(f"{name}: deviations of 40 seeds over stated errors, rms {rms:.2f}")
        assert 0.85 < rms < 1.15


@NEEDS_JIT
def test_errors_of_interpolation_agree_with_nodes_left_out():
    """Of every second zenith angle, 5° apart, and of every second azimuth, 15° apart."""
    zeniths, wavelengths = np.arange(0.0, 76.0, 5.0), [860.0, 1240.0, 2200.0]
    grid = {
        "optical_radius_um": SIZES[:1], "incidence_deg": zeniths, "polar_deg": zeniths,
        "azimuth_deg": np.arange(0.0, 181.0, 15.0),
    }  # fmt: skip

    def build(nodes):
        return splits.build_table(
            make_snow, nodes, wavelengths, max_stderr=0.005, solver="discrete_ordinates",
        ).dataset  # fmt: skip

    full, random = build(grid), np.random.default_rng(1)
    z: dict[str, list[np.ndarray]] = {name: [] for name in DIRECTIONAL}
    for axis in ("incidence_deg", "polar_deg", "azimuth_deg"):
        table = splits.Table(build(grid | {axis: grid[axis][::2]}))
        for _ in range(100):
            position = {name: int(random.integers(full.sizes[name])) for name in grid}
            position[axis] = 2 * int(random.integers((full.sizes[axis] - 1) // 2)) + 1
            exact = full.isel(position)
            found = table.interp(**{name: float(exact[name]) for name in grid})
            for name, rows in z.items():
                stderr = np.hypot(found[f"{name}_stderr"], exact[f"{name}_stderr"])
                # Errors of nodes are common to both tables, and cancel in their difference.
                between = found[f"{name}_interpolation_error"]
                is_largest = (between > 0.9 * stderr).values
                rows.append(((found[name] - exact[name]) / between).values[is_largest])
    for name, rows in z.items():
        values = np.concatenate(rows)
        rms = float(np.sqrt(np.mean(np.square(values))))
        print(f"{name}: {values.size} values, rms z {rms:.2f}, largest {np.abs(values).max():.1f}")
        assert 0.7 < rms < 1.2 and values.size > 100, name
        assert np.abs(values).max() < compute_z_bound(values.size)


@NEEDS_JIT
def test_thin_layers_agree_with_discrete_ordinates_of_others():
    """Radiances of PythonicDISORT for layers of Henyey-Greenstein particles."""
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    asymmetry, streams, zeniths = 0.6, 48, [10.0, 55.0]
    azimuths = np.array([0.0, 60.0, 180.0])
    nodes, _ = np.polynomial.legendre.leggauss(streams // 2)
    polar = np.sort(np.degrees(np.arccos(0.5 * (1.0 + nodes))))
    polar = polar[polar < 75.0][::4]
    grid = {
        "optical_thickness": [0.1, 0.5], "single_scattering_albedo": [0.9, 0.9999],
        "incidence_deg": zeniths, "polar_deg": polar, "azimuth_deg": azimuths,
    }  # fmt: skip

    def make_layer(**point) -> splits.ParticleLayer:
        return splits.ParticleLayer(asymmetry=asymmetry, refractive_index=1.0, ground=None, **point)

    table = splits.build_table(make_layer, grid, [550.0], max_stderr=0.004).dataset
    expected = xr.full_like(table.reflectance_factor, np.nan)
    moments = asymmetry ** np.arange(streams + 1)
    for thickness, albedo, zenith in np.ndindex(2, 2, 2):
        mu = float(np.cos(np.radians(zeniths[zenith])))
        cosines, *_, radiance = pydisort(
            grid["optical_thickness"][thickness],
            grid["single_scattering_albedo"][albedo],
            streams, moments[np.newaxis], mu, 1.0 / mu, 0.0, f_arr=moments[streams], NT_cor=True,
        )  # fmt: skip
        upward = cosines[: streams // 2]
        rows = [int(np.abs(upward - np.cos(np.radians(angle))).argmin()) for angle in polar]
        values = np.pi * radiance(0.0, np.radians(azimuths))[rows]
        expected[thickness, albedo, zenith, :, :, 0] = values
    z = (table.reflectance_factor - expected) / table.reflectance_factor_stderr
    judge_z(z.values, "PythonicDISORT", independent=4, bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("incidence", [20.0, 60.0])
def test_anisotropy_factors_of_wet_snow_integrate_to_the_scattered_share(incidence):
    """Their BRDFs assume another balance of wet and dry pores than the reflectance."""
    nodes, _ = np.polynomial.legendre.leggauss(24)
    polar = np.degrees(np.arccos(np.sqrt(0.5 * (1.0 - nodes))))
    result = splits.goniophotometer(
        make_snow(300.0, liquid_water_content=0.15), [860.0, 1240.0, 1640.0], incidence,
        solver="discrete_ordinates", relative_stderr=0.01, polar_deg=polar,
        azimuth_deg=np.arange(0.0, 181.0, 15.0),
    )  # fmt: skip
    integral, stderr = (
        integrate(result[f"anisotropy_factor{suffix}"]).values for suffix in ("", "_stderr")
    )
    specular = (result.specular_reflectance / result.reflectance).values
    relative = (result.reflectance_stderr / result.reflectance).values
    print(integral - 1.0 + specular, stderr, relative, specular)
    assert (np.abs(integral - 1.0 + specular) < 2e-3 + stderr + specular * relative).all()


@NEEDS_JIT
def test_skies_over_smooth_surfaces_give_the_quotient_of_factor_and_reflectance():
    grid = {
        "optical_thickness": [5.0], "incidence_deg": [20.0, 60.0], "polar_deg": [0.0, 30.0, 60.0],
        "azimuth_deg": [0.0, 90.0, 180.0],
    }  # fmt: skip

    def make_layer(optical_thickness: float) -> splits.ParticleLayer:
        return splits.ParticleLayer(
            optical_thickness=optical_thickness, single_scattering_albedo=0.7, asymmetry=0.5,
            refractive_index=1.5, ground=0.0,
        )  # fmt: skip

    table = splits.build_table(make_layer, grid, [550.0], max_stderr=0.02, quantities=ALL)
    view = table.at_view(30.0, 90.0, diffuse_fraction=0.3).dataset
    quotient = view.reflectance_factor / view.reflectance
    np.testing.assert_allclose(view.anisotropy_factor, quotient, rtol=1e-5)
