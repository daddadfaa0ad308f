"""Radiation profiles: energy, Beer's law, discrete ordinates, layers, semi-infinite media."""

import math
from functools import cache

import numpy as np
import pandas as pd
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_scatter, judge_z
from scipy.special import expn
from test_layer_limits import REFERENCE, make_layer

import splits
from splits.simulation.deep_medium import effective_mean_free_path

WAVELENGTHS = [500.0, 1000.0, 1300.0]
NAMES = ("downward_irradiance", "upward_irradiance", "absorptance", "actinic_flux")
WET = splits.Snow(depth_m=0.02, saturation=0.3)
STACK = splits.Stack(
    [
        splits.Snow(grain_size_um=(50, 100), density_kg_m3=120, saturation=0.0, depth_m=0.004),
        splits.Snow(depth_m=0.006, saturation=0.2),
        splits.Sand(depth_m=0.003, interpretation="splitsnow_2021"),
    ],
    ground=0.5,
)
SAND_WAVELENGTHS = [500.0, 700.0, 900.0]
"""Wavelengths within the range of the optical constants of sand."""


def net_flux(ds):
    return ds.downward_irradiance - ds.upward_irradiance


@cache
def compute_fluxes(medium, wavelengths):
    """Return the fluxes out of a medium."""
    return splits.spectrophotometer(medium, wavelengths, 40.0, max_stderr=0.003, seed=2)


@pytest.mark.parametrize("max_stderr", [0.01, pytest.param(0.005, marks=pytest.mark.long)])
@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
@pytest.mark.parametrize(
    ("medium", "wavelengths", "depths"),
    [
        (WET, WAVELENGTHS, [0.001, 0.005, 0.01]),
        (STACK, SAND_WAVELENGTHS, [0.002, 0.004, 0.0095, 0.0115]),
    ],
)
def test_profile_conserves_energy(medium, wavelengths, depths, kernel, max_stderr):
    ds = splits.irradiance_profile(
        medium,
        wavelengths,
        40.0,
        depth_m=depths,
        max_stderr=max_stderr,
        kernel=kernel,
    )
    spectrum = compute_fluxes(medium, tuple(wavelengths))
    reflected, transmitted = ds.upward_irradiance.isel(depth=0), net_flux(ds).isel(depth=-1)
    absorbed = ds.absorptance.sum("interval")
    np.testing.assert_allclose(reflected + transmitted + absorbed, 1.0, rtol=0.0, atol=1e-12)
    by_material = ds.absorptance_of_material.sum("material")
    np.testing.assert_allclose(by_material, ds.absorptance, rtol=0.0, atol=1e-9)
    z = []
    errors = [
        ds.upward_irradiance_stderr.isel(depth=0),
        np.sqrt((ds.absorptance_stderr**2).sum("interval")),
    ]
    for actual, error, name in zip(
        (reflected, absorbed), errors, ("reflectance", "absorptance"), strict=True
    ):
        z.append(((actual - spectrum[name]) / np.hypot(error, spectrum[f"{name}_stderr"])).values)
    judge_z(np.array(z), independent=1, bound_added=True)


@pytest.mark.parametrize("incidence", [0.0, 60.0, "diffuse"])
def test_absorber_without_grains_follows_beers_law(incidence):
    k = 2e-6
    water = {"water": complex(1.0, k), "ice": 1.31}
    pores = splits.Snow(density_kg_m3=1e-8, saturation=1.0, refractive_index=water, depth_m=0.1)
    depths = np.array([0.01, 0.03, 0.07])
    ds = splits.irradiance_profile(pores, 500.0, incidence, depth_m=depths, max_stderr=0.003)
    x = 4.0 * np.pi * k / 500e-9 * np.array([0.0, *depths, 0.1])
    if incidence == "diffuse":
        # Irradiance and mean path under isotropic radiance.
        irradiance, path = 2.0 * expn(3, x), -2.0 * np.diff(expn(3, x)) / np.diff(x)
    else:
        mu = np.cos(np.radians(incidence))
        irradiance = np.exp(-x / mu)
        path = -np.diff(irradiance) / np.diff(x)
    z = [
        (ds.downward_irradiance[0] - irradiance)[1:] / ds.downward_irradiance_stderr[0, 1:],
        (ds.absorptance[0] + np.diff(irradiance)) / ds.absorptance_stderr[0],
        (ds.actinic_flux[0] - path) / ds.actinic_flux_stderr[0],
    ]
    assert not ds.upward_irradiance.values.any()
    if incidence == "diffuse":
        judge_z(np.concatenate(z), independent=1, bound_added=True)
    else:
        # All rays are equal, so the only error is that of single precision.
        np.testing.assert_allclose(ds.downward_irradiance[0], irradiance, rtol=2e-6)
        np.testing.assert_allclose(ds.absorptance[0], -np.diff(irradiance), rtol=2e-5)
        np.testing.assert_allclose(ds.actinic_flux[0], path, rtol=2e-5)


SOOTY = {
    "specific_surface_area_m2_kg": 20.0, "density_kg_m3": 300.0,
    "impurities_ng_g": {"black_carbon": 2000.0},
}  # fmt: skip
ABSORBED = {
    "sooty snow": (splits.Snow.natural(**SOOTY, depth_m=0.1), [350.0, 900.0, 1500.0], [0.03]),
    "clean snow": (
        splits.Snow.natural(specific_surface_area_m2_kg=20.0, depth_m=0.05), [400.0, 700.0], [0.01]
    ),
    "deep snow": (splits.Snow.natural(**SOOTY), [350.0, 1030.0], [0.01, 0.05]),
    "layers": (
        splits.Stack(
            [splits.Snow.natural(specific_surface_area_m2_kg=40.0, depth_m=0.01),
             splits.Snow.natural(**SOOTY, depth_m=0.05)], ground=0.5
        ),
        [400.0, 1030.0], [0.005, 0.01, 0.04],
    ),
    "particles": (
        splits.ParticleLayer(optical_thickness=20.0, single_scattering_albedo=0.9, depth_m=0.4),
        [500.0], [0.1, 0.3],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ABSORBED)
def test_actinic_flux_times_absorption_coefficient_is_the_absorptance(name):
    """The coefficient is that of the layer, the same in all intervals and for both solvers."""
    medium, wavelengths, depths = ABSORBED[name]
    paths = splits.irradiance_profile(
        medium,
        wavelengths,
        30.0,
        depth_m=depths,
        max_stderr=0.03,
        solver="monte_carlo",
        kernel="scalar",
    )
    thickness = (paths.interval_bottom - paths.interval_top).values
    if name == "particles":
        coefficient = np.full((1, 1), 0.1 * 20.0 / 0.4)
    else:
        solved = splits.irradiance_profile(
            medium, wavelengths, 30.0, depth_m=depths, solver="discrete_ordinates"
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            coefficient = (solved.absorptance / (solved.actinic_flux * thickness)).values
        seen = solved.absorptance.values > 1e-12
        first = np.searchsorted(paths.interval_top, 0.01) if name == "layers" else 0
        same = coefficient[:, first:-1] / coefficient[:, first : first + 1]
        np.testing.assert_allclose(same[seen[:, first:-1]], 1.0, rtol=1e-6)
    product = paths.actinic_flux * np.where(np.isinf(thickness), 0.0, thickness) * coefficient
    finite = np.isfinite(product.values) & np.isfinite(thickness)
    difference = (product - paths.absorptance).values
    assert finite.any()
    np.testing.assert_allclose(difference[finite], 0.0, atol=2e-6)
    is_absorbed = finite & (paths.absorptance.values > 1e-3)
    relative = difference[is_absorbed] / paths.absorptance.values[is_absorbed]
    np.testing.assert_allclose(relative, 0.0, atol=1e-5)


def test_actinic_flux_in_the_dark_is_not_low():
    """Few rays survive the absorption by soot; the others have been absorbed in the interval."""
    medium, _, depths = ABSORBED["sooty snow"]
    solved = splits.irradiance_profile(medium, [350.0], depth_m=depths, solver="discrete_ordinates")
    z, flux = [], []
    for seed in range(1, 9):
        paths = splits.irradiance_profile(
            medium, [350.0], depth_m=depths, seed=seed, solver="monte_carlo", kernel="scalar"
        )
        z.append(compare_results(paths, solved, "actinic_flux"))
        flux.append(paths.actinic_flux.values[0, -1])
    judge_z(np.array(z), independent=8)
    assert np.mean(flux) == pytest.approx(solved.actinic_flux.values[0, -1], rel=0.1)


@pytest.mark.parametrize("error", [0.012, pytest.param(0.004, marks=pytest.mark.long)])
def test_kernels_agree_on_profiles(error):
    z = []
    for medium, wavelengths, seed in ((WET, WAVELENGTHS, 5), (STACK, SAND_WAVELENGTHS, 7)):
        one, other = (
            splits.irradiance_profile(
                medium, wavelengths, 20.0, depth_m=[0.001, 0.0045, 0.011], max_stderr=error,
                seed=seed + i, kernel=kernel
            )
            for i, kernel in enumerate(("vectorized", "scalar"))
        )  # fmt: skip
        for name in NAMES:
            stderr = np.hypot(one[f"{name}_stderr"], other[f"{name}_stderr"])
            difference = (one[name] - other[name]).values
            uncertain = stderr.values > 1e-9
            z.append((difference[uncertain] / stderr.values[uncertain]).ravel())
    judge_z(np.concatenate(z), independent=6, bound_added=True)


def test_sparse_layer_agrees_with_discrete_ordinates():
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    ice = {"wavelength_nm": [400.0, 2000.0], "n": [1.31, 1.31], "k": [1e-7, 1e-4]}
    common = {
        "saturation": 0.0, "density_kg_m3": 1e-3, "refractive_index": {"ice": ice},
        "interpretation": {
            "overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep",
        },
    }  # fmt: skip
    thickness, streams, mu = 6.0, 32, 0.5
    depth = thickness * splits.Snow(**common, depth_m=1e4).mean_grain_distance_m
    snow = splits.Snow(**common, depth_m=depth)
    fractions = np.linspace(0.05, 0.95, 10)
    ds = splits.irradiance_profile(
        snow, WAVELENGTHS, 60.0, depth_m=fractions * depth, max_stderr=0.0025
    )
    runs = []
    for seed in range(1, 7):
        optics = splits.single_scattering(snow, WAVELENGTHS, rays=100_000, seed=seed)
        fluxes = []
        for row in range(len(WAVELENGTHS)):
            chi = np.clip(optics.legendre_moment.values[row, : streams + 1], -1.0, 1.0 - 1e-9)
            chi[0] = 1.0
            albedo = min(float(optics.single_scattering_albedo[row]), 1.0 - 1e-9)
            _, up, down, *_ = pydisort(
                thickness, albedo, streams, chi[np.newaxis], mu, 1.0 / mu, 0.0,
                only_flux=True, f_arr=max(chi[streams], 0.0),
            )  # fmt: skip
            fluxes.append([up(fractions * thickness), np.sum(down(fractions * thickness), axis=0)])
        runs.append(fluxes)
    expected = np.mean(runs, axis=0)
    error = np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    z = []
    for column, name in enumerate(("upward_irradiance", "downward_irradiance")):
        difference = ds[name].values[:, 1:-1] - expected[:, column]
        z.append(difference / np.hypot(ds[f"{name}_stderr"].values[:, 1:-1], error[:, column]))
    judge_z(np.array(z), independent=2, bound_added=True)


def test_depths_that_no_ray_reaches_have_nonzero_errors():
    deep = splits.Snow(depth_m=0.05)
    ds = splits.irradiance_profile(deep, 1500.0, depth_m=[0.04, 0.045], max_stderr=0.05)
    assert not ds.downward_irradiance[0, 2:].values.any()
    assert (ds.downward_irradiance_stderr[0, 1:] > 1e-6).all()
    assert (ds.absorptance_stderr > 1e-6).all()


OIL = {"pores": {"oil": 0.05}, "refractive_index": {"oil": 1.33 + 1e-3j}}
ABSORBING = {
    "opaque grains": (splits.Snow(saturation=0.0, depth_m=0.02), 3000.0),
    "wet pores": (splits.Snow(saturation=0.3, depth_m=0.02), 1450.0),
    "absorbing pores": (
        splits.Snow(
            grain_size_um=(50, 100), density_kg_m3=100, saturation=0.0, depth_m=0.01, **OIL
        ),
        500.0,
    ),
}


@pytest.mark.parametrize("kernel", ["auto", "scalar"])
@pytest.mark.parametrize("name", ABSORBING)
def test_errors_cover_large_steps_of_weights(name, kernel):
    """Compare with planes so close that few grains lie between two of them."""
    medium, wavelength = ABSORBING[name]
    depth = 0.25 * medium.depth_m
    fine_depths = np.linspace(0.0, depth, 101)[1:]
    coarse, fine = (
        splits.irradiance_profile(
            medium,
            [wavelength],
            0.0,
            depth_m=depths,
            max_stderr=0.01,
            seed=seed,
            kernel=kernel,
        )
        for seed, depths in ((5, [depth]), (6, fine_depths))
    )
    upper = fine.isel(interval=slice(100))
    for quantity, sums in (
        ("actinic_flux", upper.actinic_flux.mean("interval")),
        ("absorptance_of_material", upper.absorptance_of_material.sum("interval")),
    ):
        first = coarse.isel(interval=0)
        error = first[f"{quantity}_stderr"]
        difference = np.abs(first[quantity] - sums)
        assert (difference <= 2.0 * error + 0.01).all(), (quantity, difference.values, error.values)


@pytest.mark.parametrize(
    ("depths", "message"),
    [
        ([0.02], r"depth_m = 0.02: must be in \(0, 0.02\) m"),
        ([0.01, 0.005], "strictly increasing"),
        ([], "depth_m"),
        ("deep", "text, not a number"),
        (np.linspace(1e-5, 0.019, 300), "300 depths"),
    ],
)
def test_depths_outside_the_medium_are_rejected(depths, message):
    with pytest.raises(ValueError, match=message):
        splits.irradiance_profile(WET, WAVELENGTHS, depth_m=depths)


ROUGH = {"rms_height_m": 0.01, "wave_number_per_m": 10.0, "correlation": "gaussian"}
HAZE = splits.ParticleLayer(2.0, 0.95, 0.6, 1.33, None, depth_m=0.01)
HAZY_STACK = splits.Stack([HAZE, splits.Snow(depth_m=0.01)], ground=0.4)
LAYERS = {
    "over a bottom": splits.ParticleLayer(),
    "over a black bottom": splits.ParticleLayer(ground=0.0),
    "open below": splits.ParticleLayer(4.0, 0.9, 0.5, 1.0, None),
    "black particles": splits.ParticleLayer(1.0, 0.0, 0.0, 1.2),
    "semi-infinite": splits.ParticleLayer(math.inf, 0.95),
    "rough": splits.ParticleLayer(2.0, 0.9, surface=ROUGH),
    "polarized": splits.ParticleLayer(2.0, phase_function="rayleigh", polarized=True),
}
DEEP_SNOW = {"specific_surface_area_m2_kg": 20, "density_kg_m3": 300}


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("name", LAYERS)
def test_particle_layers_conserve_energy_and_match_reflectance(name):
    layer = LAYERS[name]
    ds = splits.irradiance_profile(layer, [500.0], 30.0, depth_m=[0.1, 0.4, 0.8], max_stderr=0.01)
    spectrum = splits.spectrophotometer(layer, [500.0], 30.0, max_stderr=0.004, seed=2)
    reflected, absorbed = ds.upward_irradiance[0, 0], ds.absorptance[0].sum()
    transmitted = (
        net_flux(ds)[0, -1] if ds.sizes["interval"] == 4 and name != "semi-infinite" else 0.0
    )
    np.testing.assert_allclose(reflected + absorbed + transmitted, 1.0, atol=1e-12)
    of_matrix = ds.absorptance_of_material.sel(material="matrix")
    np.testing.assert_allclose(of_matrix, ds.absorptance, atol=1e-6)
    error = np.hypot(ds.upward_irradiance_stderr[0, 0], spectrum.reflectance_stderr[0])
    judge_z(np.array([(reflected - spectrum.reflectance[0]) / error]), bound_added=True)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("error", [0.01, pytest.param(0.003, marks=pytest.mark.long)])
def test_particle_layers_agree_with_exact_fluxes(error):
    """The references are discrete ordinates and adding-doubling: reference/plane_parallel.csv."""
    table = pd.read_csv(REFERENCE / "plane_parallel.csv", comment="#")
    table = table[np.isfinite(table.tau) & (table.tau <= 8.0)].iloc[::3]
    z = []
    for number, (_, row) in enumerate(table.iterrows()):
        incidence = float(np.degrees(np.arccos(row.mu0)))
        ds = splits.irradiance_profile(
            make_layer(row),
            [550.0],
            incidence,
            depth_m=[0.5],
            max_stderr=error,
            seed=number,
        )
        down = float(row["T"])
        for name, index, exact in (("upward", 0, row.R), ("downward", -1, down)):
            value, stderr = (
                float(ds[f"{name}_irradiance{end}"][0, index]) for end in ("", "_stderr")
            )
            z.append((value - exact) / math.hypot(stderr, row.est_err))
    judge_z(np.array(z), independent=len(table), bound_added=True)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("error", [0.01, pytest.param(0.002, marks=pytest.mark.long)])
def test_stacked_particle_layers_agree_with_discrete_ordinates(error):
    """Two layers over a ground agree at depths within both layers."""
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    streams, mu = 32, 0.5
    layers = [(1.5, 0.95, 0.6), (3.0, 0.8, 0.2)]
    ground = 0.3
    stack = splits.Stack(
        [splits.ParticleLayer(tau, ssa, g, 1.0, None, depth_m=tau) for tau, ssa, g in layers],
        ground,
    )
    depths = np.array([0.3, 1.0, 1.5, 2.0, 3.0, 4.2])
    ds = splits.irradiance_profile(stack, [500.0], 60.0, depth_m=depths, max_stderr=error)
    legendre = np.array([[g**n for n in range(streams + 1)] for *_, g in layers])
    _, up, down, *_ = pydisort(
        np.cumsum([tau for tau, *_ in layers]), np.array([ssa for _, ssa, _ in layers]), streams,
        legendre, mu, 1.0 / mu, 0.0, only_flux=True, f_arr=legendre[:, streams],
        BDRF_Fourier_modes=[ground],
    )  # fmt: skip
    boundaries = np.array([0.0, *depths, 4.5])
    exact = [up(boundaries), np.sum(down(boundaries), axis=0)]
    z = []
    for fluxes, name in zip(exact, ("upward_irradiance", "downward_irradiance"), strict=True):
        difference, stderr = ds[name][0].values - fluxes, ds[f"{name}_stderr"][0].values
        z.append(difference[stderr > 1e-9] / stderr[stderr > 1e-9])
    absorbed = -np.diff(exact[1] - exact[0])
    z.append((ds.absorptance[0].values - absorbed) / ds.absorptance_stderr[0].values)
    judge_z(np.concatenate(z), independent=3, bound_added=True)


@pytest.mark.long
@NEEDS_JIT
def test_depth_planes_do_not_change_the_spectrum():
    """Materials absorb in their own layer only, and totals agree with the spectrophotometer."""
    ds = splits.irradiance_profile(
        HAZY_STACK,
        [500.0, 900.0],
        20.0,
        depth_m=[0.004, 0.01, 0.015],
        max_stderr=0.01,
    )
    spectrum = splits.spectrophotometer(HAZY_STACK, [500.0, 900.0], 20.0, max_stderr=0.005, seed=3)
    absorbed = ds.absorptance.sum("interval")
    z = [
        (actual - spectrum[name]).values / np.hypot(error, spectrum[f"{name}_stderr"]).values
        for actual, error, name in (
            (ds.upward_irradiance[:, 0], ds.upward_irradiance_stderr[:, 0], "reflectance"),
            (net_flux(ds)[:, -1], ds.downward_irradiance_stderr[:, -1], "transmittance"),
        )
    ]
    judge_z(np.array(z), independent=1, bound_added=True)
    np.testing.assert_allclose(net_flux(ds)[:, 0] - net_flux(ds)[:, -1], absorbed, atol=1e-12)
    upper = ds.absorptance_of_material.isel(interval=slice(2))
    matrix = upper.sel(material="layers.0.matrix")
    np.testing.assert_allclose(matrix, upper.sum("material"), atol=1e-9)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("error", [0.04, pytest.param(0.01, marks=pytest.mark.long)])
def test_semi_infinite_snowpack_agrees_with_a_deep_one(error):
    wavelengths, depths = [500.0, 900.0, 1100.0], [0.005, 0.02, 0.04]
    semi_infinite, deep = (
        splits.irradiance_profile(
            splits.Snow.natural(**DEEP_SNOW, depth_m=depth), wavelengths, "diffuse",
            depth_m=depths, max_stderr=error, seed=seed, solver="monte_carlo",
        )
        for seed, depth in ((1, math.inf), (2, 0.5))
    )  # fmt: skip
    assert semi_infinite.depth.values.tolist() == [0.0, *depths]
    assert semi_infinite.interval_bottom[-1] == math.inf
    np.testing.assert_allclose(
        semi_infinite.upward_irradiance[:, 0] + semi_infinite.absorptance.sum("interval"),
        1.0,
        atol=1e-9,
    )
    by_material = semi_infinite.absorptance_of_material.sum("material")
    np.testing.assert_allclose(by_material, semi_infinite.absorptance, atol=1e-9)
    z = []
    for name in ("downward_irradiance", "upward_irradiance", "absorptance"):
        one, other = (
            semi_infinite[name].values,
            deep[name].values[:, : semi_infinite[name].shape[1]],
        )
        errors = [ds[f"{name}_stderr"].values[:, : one.shape[1]] for ds in (semi_infinite, deep)]
        error_of_difference = np.hypot(*errors)
        z.append(
            (
                (one - other)[error_of_difference > 1e-9]
                / error_of_difference[error_of_difference > 1e-9]
            ).ravel()
        )
    judge_z(np.concatenate(z), independent=3, bound_added=True)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("seeds", [24, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("medium", "depths"),
    [
        (LAYERS["over a bottom"], [0.2, 0.6]),
        (HAZY_STACK, [0.005, 0.015]),
        (splits.Snow.natural(**DEEP_SNOW, depth_m=math.inf), [0.005, 0.02]),
    ],
    ids=["layer", "stack", "semi-infinite"],
)
def test_errors_of_profiles_agree_with_scatter(medium, depths, seeds):
    runs = [
        splits.irradiance_profile(
            medium,
            [700.0],
            40.0,
            depth_m=depths,
            max_stderr=0.03,
            seed=seed,
            target="absorptance",
            threads=1,
            solver="monte_carlo",
        )
        for seed in range(seeds)
    ]
    values, stderrs = (
        [
            np.concatenate([run[f"{name}{end}"][0] for name in NAMES if name != "actinic_flux"])
            for run in runs
        ]
        for end in ("", "_stderr")
    )
    assert judge_scatter(values, stderrs, bound_added=True) > 0.6


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("albedo", [0.9, 1.0])
def test_unbounded_interval_is_saved_and_loaded(albedo, tmp_path):
    ds = splits.irradiance_profile(
        splits.ParticleLayer(math.inf, albedo, refractive_index=1.0), 500.0, depth_m=[1.0, 8.0]
    )
    splits.save(ds, tmp_path / "inside.nc")
    assert splits.load(tmp_path / "inside.nc").equals(ds)
    # Without absorption the actinic flux is constant far from the top.
    deepest, above = ds.actinic_flux[0, -1], ds.actinic_flux[0, -2]
    assert deepest == 0.0 if albedo < 1.0 else deepest == pytest.approx(float(above), rel=0.1)


@pytest.mark.long
@NEEDS_JIT
def test_deep_fluxes_decay_by_asymptotic_theory():
    """Fluxes decay as exp(-κz), and their ratio is that of diffusion theory."""
    snow = splits.Snow.natural(**DEEP_SNOW, depth_m=math.inf)
    optics = splits.single_scattering(
        splits.Snow.natural(**DEEP_SNOW, depth_m=1.0), [900.0], rays=60_000
    )
    step = effective_mean_free_path(optics)[0]
    loss = 1.0 - optics.single_scattering_albedo.values[0]
    diffusion = step / (3.0 * (1.0 - optics.asymmetry_parameter.values[0] + loss))
    rate = math.sqrt(loss / step / diffusion)
    depths = np.array([1.0, 2.0]) / rate
    ds = splits.irradiance_profile(
        snow,
        [900.0],
        "diffuse",
        depth_m=depths,
        max_stderr=0.008,
        solver="monte_carlo",
    )
    down, up = ds.downward_irradiance[0, 1:].values, ds.upward_irradiance[0, 1:].values
    relative = np.hypot(*(ds.downward_irradiance_stderr[0, 1:].values / down))
    # Diffusion theory is accurate to first order in κD, here to a few per cent.
    assert math.log(down[0] / down[1]) == pytest.approx(1.0, abs=2.6 * relative + 0.03)
    asymptotic = (1.0 - 2.0 * rate * diffusion) / (1.0 + 2.0 * rate * diffusion)
    np.testing.assert_allclose(up / down, asymptotic, atol=0.02)


@pytest.mark.long
@pytest.mark.parametrize(
    ("medium", "depths", "message"),
    [
        (splits.ParticleLayer(opaque=True), [0.5], r"opaque.*must be false \(all light is"),
        (LAYERS["rough"], [0.01], r"depth_m = 0.01: must be at least 0.08 m"),
        (splits.Snow(depth_m=math.inf, pores={"oil": 0.1}, refractive_index={"oil": 1.4}), [0.1],
         r"finite where pores hold other media"),
    ],
)  # fmt: skip
def test_unsupported_profiles_are_rejected(medium, depths, message):
    with pytest.raises(ValueError, match=message):
        splits.irradiance_profile(medium, 500.0, depth_m=depths)
