"""Radiation under a sky, albedos, reflectance factors, and a Lambertian ground."""

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, compare_results, judge_scatter, judge_z
from scenes import make_medium_scene

import splits
from splits.illumination.bands import as_bands
from splits.kernels import vectorized
from splits.kernels.records import (
    CROSSING_LENGTH,
    CROSSING_RAY,
    CROSSING_WEIGHT,
    EXIT_LENGTH,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)
from splits.kernels.scene import Optics, make_bounding_optics
from splits.kernels.transport import history
from splits.kernels.vectorized.trace import select_features
from splits.simulation.scene import compute_optical_constants

W = np.array([400.0, 500.0, 700.0, 1000.0])
CUSTOM_SKY = {
    "wavelength_nm": [300, 600, 1200],
    "direct": [1.0, 3.0, 0.0],
    "diffuse": [1.0, 0.0, 1.0],
}


@pytest.mark.long
@NEEDS_JIT
def test_radiation_profile_conserves_energy():
    """Incoming irradiance equals reflected, absorbed and transmitted power, and the given total."""
    profile = splits.radiation_profile(
        splits.Snow(depth_m=0.03), splits.sky("midlatitude_winter"), [400.0, 700.0, 1000.0, 2000.0],
        depth_m=[0.01], max_stderr=0.05, total_w_m2=500.0,
        bands={"photosynthetic": (400, 700)},
    )  # fmt: skip
    assert profile.band.values.tolist() == ["broadband", "photosynthetic"]
    net = profile.downward_irradiance - profile.upward_irradiance
    absorbed = profile.absorbed_power.sum("interval")
    np.testing.assert_allclose(absorbed + net.isel(depth=-1), net.isel(depth=0), rtol=1e-12)
    arriving = float(profile.downward_irradiance[0, 0])
    assert arriving == pytest.approx(500.0 * float(profile.irradiance_covered[0]), rel=1e-9)
    assert (profile.absorbed_power_stderr > 0.0).all()


@NEEDS_JIT
@pytest.mark.parametrize("seeds", [24, pytest.param(50, marks=pytest.mark.long)])
def test_errors_of_radiation_profile_agree_with_scatter(seeds):
    """Stated errors agree with the scatter of seeds; quantities of a run count as one.

    Wavelengths are so close that the error between them, which all seeds share, is negligible.
    """
    snow, sky = splits.Snow(depth_m=0.02), splits.sky(CUSTOM_SKY, 50.0)
    runs = [
        splits.radiation_profile(
            snow,
            sky,
            [900.0, 920.0, 940.0],
            depth_m=[0.005],
            max_stderr=0.03,
            seed=2 * seed,
            solver="monte_carlo",
        )
        for seed in range(seeds)
    ]
    for name in ("downward_irradiance", "upward_irradiance", "absorbed_power"):
        values, stderrs = ([run[f"{name}{end}"][0] for run in runs] for end in ("", "_stderr"))
        assert judge_scatter(values, stderrs, name, bound_added=True) > 0.5


LAYERS = [(0.02, 40, 150), (0.04, 25, 250), (0.06, 15, 350)]
"""Thickness (m), specific surface area (m²/kg) and density (kg/m³) of layers of snow."""
STACK = splits.Stack(
    [
        splits.Snow.natural(depth_m=d, specific_surface_area_m2_kg=s, density_kg_m3=r)
        for d, s, r in LAYERS
    ],
    ground=0.2,
)
COARSE = np.arange(310.0, 2491.0, 90.0)


def compute_stack_profile(error, **settings):
    sky = splits.sky("midlatitude_winter")
    return splits.radiation_profile(
        STACK,
        sky,
        COARSE,
        depth_m=[0.02, 0.06],
        max_stderr=error,
        total_w_m2=1.0,
        **settings,
        solver="monte_carlo",
    )


@pytest.mark.long
@NEEDS_JIT
def test_radiation_profile_reaches_the_error_of_its_target():
    power, irradiance = (
        compute_stack_profile(0.02, target=name) for name in ("absorbed_power", "irradiance")
    )
    for profile in (power, irradiance):
        assert profile.attrs["stop_reason"] == "converged"
        assert profile.absorbed_power_stderr.max() <= 0.02
        assert profile.upward_irradiance_stderr[0, 0] <= 0.02
    assert irradiance.downward_irradiance_stderr.max() <= 0.02
    assert irradiance.upward_irradiance_stderr.max() <= 0.02
    # The same error for each single wavelength takes more than 70 000 rays.
    assert power.attrs["rays"] <= 20_000 < irradiance.attrs["rays"] <= 40_000


@pytest.mark.long
@NEEDS_JIT
def test_errors_of_radiation_profile_follow_max_stderr():
    # Rays do not reduce the error between the coarse wavelengths, which the bands have besides.
    rough, fine = (
        compute_stack_profile(error).attrs["max_stderr_reached"] for error in (0.05, 0.0006)
    )
    assert fine <= 0.0006 and rough >= 2.0 * fine


def test_skies_in_relative_units_require_a_total():
    with pytest.raises(ValueError, match="total_w_m2 = None"):
        splits.sky("midlatitude_winter").scale_to(None)
    with pytest.raises(ValueError, match="total_w_m2"):
        splits.sky(CUSTOM_SKY, 50.0).scale_to(-3.0)
    scaled = splits.sky("midlatitude_winter").scale_to(800.0)
    assert np.trapezoid(scaled.total, scaled.wavelength_nm) == pytest.approx(800.0)
    assert splits.sky(CUSTOM_SKY, 50.0).scale_to(None).total[0] == 2.0


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.002, pytest.param(0.001, marks=pytest.mark.long)])
def test_diffuse_reflectance_factor_is_the_reciprocal_albedo(error):
    """The factor of a direction under diffuse light equals the albedo of a beam from there."""
    polar = [0.0, 40.0, 70.0]
    natural = {"specific_surface_area_m2_kg": 20, "depth_m": 0.03}
    media = [
        splits.Snow.natural(**natural),
        splits.Snow.natural(**natural, liquid_water_content=0.1, ground=0.4),
        splits.ParticleLayer(optical_thickness=1.0, refractive_index=1.33),
    ]
    z = []
    for number, medium in enumerate(media):
        factors = splits.goniophotometer(
            medium, [1300.0], "diffuse", seed=number, relative_stderr=10.0 * error, polar_deg=polar,
            azimuth_deg=[0.0, 90.0], solver="monte_carlo",
        ).isel(wavelength=0)  # fmt: skip
        assert (factors.reflectance_factor[:, 0] == factors.reflectance_factor[:, 1]).all()
        for angle in polar:
            beam = splits.spectrophotometer(
                medium, [1300.0], angle, max_stderr=error, seed=9, solver="monte_carlo"
            )
            factor = factors.sel(polar_deg=angle).isel(azimuth_deg=0)
            difference = float(factor.reflectance_factor - beam.reflectance[0])
            z.append(
                difference / np.hypot(factor.reflectance_factor_stderr, beam.reflectance_stderr[0])
            )
    judge_z(np.array(z, dtype=float), independent=len(media), bound_added=True)


@NEEDS_JIT
def test_hdrf_is_the_mean_of_beam_and_diffuse():
    snow, sky = splits.Snow(depth_m=0.03), splits.sky(CUSTOM_SKY, 50.0)
    settings = {"relative_stderr": 0.05, "polar_deg": [0.0, 60.0], "azimuth_deg": [0.0, 180.0]}
    total = splits.hdrf(snow, sky, W, seed=5, **settings, solver="monte_carlo")
    direct = splits.goniophotometer(
        snow, W, 50.0, seed=5, **settings, solver="monte_carlo"
    ).reflectance_factor
    diffuse = splits.goniophotometer(
        snow, W, "diffuse", seed=6, **settings, solver="monte_carlo"
    ).reflectance_factor
    direct_fraction = xr.DataArray(
        sky.compute_direct_fraction(W), {"wavelength": W}, ("wavelength",)
    )
    np.testing.assert_allclose(
        total.reflectance_factor,
        direct_fraction * direct + (1.0 - direct_fraction) * diffuse,
        rtol=1e-12,
    )
    assert total.zenith_deg == 50.0


def test_bins_estimator_rejects_diffuse_light():
    with pytest.raises(ValueError, match="incidence_deg = 'diffuse'"):
        splits.goniophotometer(splits.Snow(), [500.0], "diffuse", estimator="bins")


def make_polluted_snow(soot):
    natural = {"specific_surface_area_m2_kg": 20, "depth_m": 0.05, "ground": 0.2}
    return splits.Snow.natural(**natural, impurities_ng_g={"black_carbon": soot})


@NEEDS_JIT
def test_error_of_albedo_change_agrees_with_scatter():
    """The error is less than that of the albedo and agrees with scatter; bands count as one."""
    media, sky = (
        {"clean": make_polluted_snow(0.0), "dirty": make_polluted_snow(200.0)},
        splits.sky(CUSTOM_SKY, 50.0),
    )
    changes, stderrs = [], []
    for seed in range(20):
        ds = splits.albedo(
            media,
            sky,
            W,
            max_stderr=0.02,
            seed=2 * seed,
            bands={"visible": (400, 700)},
            solver="monte_carlo",
        )
        change, error = ds.errors.difference("band_albedo", "dirty", "clean")
        changes.append(change.values)
        stderrs.append(error.values)
        assert (error < ds.band_albedo_stderr.min("medium")).all()
    assert np.max(changes) < 0.0
    judge_scatter(changes, stderrs, "change of albedo", bound_added=True)


@NEEDS_JIT
def test_band_albedos_agree_with_sums_over_exact_spectra():
    """Bands of a run share paths and count as one comparison."""
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.05, ground=0.2)
    sky, sensor = splits.sky("midlatitude_winter"), "viirs_suomi_npp"
    wavelengths = np.array([385.0, 500.0, 650.0, 800.0, 1000.0, 1250.0, 1400.0, 1620.0, 2300.0])
    exact = splits.albedo(snow, sky, wavelengths, solver="discrete_ordinates")
    bands = as_bands(sensor)
    weights = np.array([sky.compute_weights(wavelengths, band) for band in bands.values()])
    expected = weights @ exact.albedo.values / weights.sum(axis=1)
    uncertainty = weights @ exact.albedo_stderr.values / weights.sum(axis=1)
    z = []
    for seed in range(20):
        found = splits.albedo(
            snow,
            sky,
            wavelengths,
            max_stderr=0.02,
            seed=2 * seed,
            bands=sensor,
            solver="monte_carlo",
        )
        found = found.sel(band=list(bands))
        stderr = np.hypot(found.band_albedo_stderr.values, uncertainty)
        z.append((found.band_albedo.values - expected) / stderr)
    judge_z(z, "VIIRS", independent=len(z), bound_added=True)
    assert np.sqrt(np.mean(np.square(z))) > 0.5


@NEEDS_JIT
def test_albedos_of_several_media_agree_with_single_runs():
    sky = splits.sky(CUSTOM_SKY, 50.0)
    both = splits.albedo(
        {"a": make_polluted_snow(0.0), "b": make_polluted_snow(200.0)},
        sky,
        W,
        max_stderr=0.01,
        seed=3,
        solver="monte_carlo",
    )
    assert both.attrs["medium"] == "snow"
    assert both.snow_black_carbon_ng_g.values.tolist() == [0.0, 200.0]
    z = []
    for number, (name, soot) in enumerate((("a", 0.0), ("b", 200.0))):
        single = splits.albedo(
            make_polluted_snow(soot),
            sky,
            W,
            max_stderr=0.01,
            seed=50 + 2 * number,
            solver="monte_carlo",
        )
        z.append(compare_results(both.sel(medium=name), single, "albedo"))
    judge_z(np.array(z), independent=1, bound_added=True)
    with pytest.raises(ValueError, match=r"medium\['b'\]"):
        splits.albedo({"a": make_polluted_snow(0.0), "b": splits.Sand()}, sky, W)
    with pytest.raises(ValueError, match="one = 'c': must be one of a, b"):
        both.errors.difference("albedo", "c", "a")
    with pytest.raises(ValueError, match="quantity = 'direct_fraction'"):
        both.errors.difference("direct_fraction", "a", "b")


@pytest.mark.parametrize("step", [10.0, 20.0, 50.0])
def test_errors_of_bands_contain_the_distance_of_wavelengths(step):
    snow, sky = splits.Snow.natural(specific_surface_area_m2_kg=20.0, depth_m=0.5), "astm_g173"
    bands = {"water": (1000, 1100), "ice": (1400, 1560), "both": (950, 1400)}

    def measure(spacing):
        wavelengths = np.arange(900.0, 1700.1, spacing)
        found = splits.albedo(
            snow, splits.sky(sky), wavelengths, max_stderr=1e-3, bands=bands, threads=1
        )
        return found.sel(band=[*bands])

    z = compare_results(measure(step), measure(2.0), "band_albedo")
    assert (np.abs(z) < 3.0).all(), z


WAVELENGTHS = [500.0, 900.0, 1300.0]
ALBEDOS = (0.1, 0.5, 0.9, 1.0)
WET = splits.Snow(depth_m=0.008, saturation=0.3)
SAND = splits.Sand(depth_m=0.003, partition=(0.8, 0.1, 0.1))
FRESH = splits.Snow(grain_size_um=(50, 100), density_kg_m3=120, saturation=0.0, depth_m=0.002)
DRY = splits.Snow(depth_m=0.004, saturation=0.0)
MEDIA = {
    "wet snow": (WET, WET),
    "dry snow": (DRY, DRY),
    "sand": (SAND, SAND),
    "stack": tuple(
        splits.Stack(order, interpretation="splits_2007")
        for order in ([FRESH, WET, SAND], [SAND, WET, FRESH])
    ),
}
"""Media and the same media upside down."""


def place_over(medium, ground):
    """Return a medium over a ground."""
    if isinstance(medium, splits.Stack):
        return splits.Stack(medium.layers, ground=ground, interpretation=medium.interpretation)
    settings = {name: getattr(medium, name) for name in ("depth_m", "saturation")}
    if isinstance(medium, splits.Sand):
        settings["partition"] = medium.partition
    return type(medium)(**settings, ground=ground)


def measure(medium, incidence, seed, **settings):
    ds = splits.spectrophotometer(
        medium, WAVELENGTHS, incidence, max_stderr=0.002, seed=seed, **settings
    )
    values = ds.reflectance.values, ds.transmittance.values
    return *values, ds.reflectance_stderr.values, ds.transmittance_stderr.values


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("kernel", ["vectorized", pytest.param("scalar", marks=pytest.mark.long)])
def test_ground_reflections_follow_the_adding_series(name, kernel):
    """R(ρ) = R + T ρ T′/(1 − ρ R′), and the ground absorbs (1 − ρ) T/(1 − ρ R′)."""
    medium, reverse = MEDIA[name]
    r, t, dr, dt = measure(medium, 40.0, 1)
    r2, t2, dr2, dt2 = measure(reverse, "diffuse", 2)
    z = []
    for seed, albedo in enumerate(ALBEDOS, start=3):
        reflected, absorbed, dreflected, dabsorbed = measure(
            place_over(medium, albedo), 40.0, seed, kernel=kernel
        )
        series = 1.0 / (1.0 - albedo * r2)
        expected = r + t * albedo * t2 * series
        # Errors of R and T, and of R′ and T′, are correlated: the largest possible sum is used.
        terms = [
            dr, dt * albedo * t2 * series, dt2 * albedo * t * series,
            dr2 * t * t2 * (albedo * series) ** 2,
        ]  # fmt: skip
        error = np.hypot(dreflected, np.hypot(terms[0] + terms[1], terms[2] + terms[3]))
        z.append((reflected - expected) / error)
        if albedo < 1.0:
            expected = (1.0 - albedo) * t * series
            terms = [dt * (1.0 - albedo) * series, dr2 * expected * albedo * series]
            z.append((absorbed - expected) / np.hypot(dabsorbed, np.hypot(*terms)))
        else:
            assert not absorbed.any()
    judge_z(np.concatenate(z), name, independent=len(ALBEDOS), bound_added=True)


def test_conservative_media_over_white_ground_reflect_all():
    transparent = {"ice": 1.31, "water": 1.33}
    for medium in (
        splits.Snow(depth_m=0.005, refractive_index=transparent, ground=1.0),
        splits.Stack([splits.Snow(depth_m=0.002, refractive_index=transparent)] * 2, ground=1.0),
    ):
        for incidence in (0.0, 80.0, "diffuse"):
            for kernel in ("vectorized", "scalar"):
                ds = splits.spectrophotometer(
                    medium, 500.0, incidence, max_stderr=0.02, kernel=kernel
                )
                assert abs(float(ds.reflectance[0]) - 1.0) < 1e-12
                assert abs(float(ds.absorptance[0])) < 1e-12
                assert float(ds.transmittance[0]) == 0.0


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_reflected_and_ground_absorbed_weights_conserve_energy(kernel):
    """Weights of every ray balance in double precision, by path lengths at exit and ground."""
    snow = splits.Snow(
        depth_m=0.005, saturation=0.3, refractive_index={"ice": 1.31, "water": 1.33}, ground=0.6
    )
    scene = make_medium_scene(snow, 30.0)
    index, absorption = compute_optical_constants(snow, np.array([500.0]))
    # Without absorption for roulette, no ray is terminated, so that each one balances.
    optics = make_bounding_optics(index[0], np.zeros_like(absorption))
    exits = allocate_exits(512, index.shape[1])
    work = np.array([[7, 0, len(exits), 2**31 - 1]])
    if kernel == "vectorized":
        item_optics = Optics(*(values[np.newaxis] for values in optics))
        result = vectorized.trace_rays(
            1, work, scene, item_optics, exits, select_features(scene, optics)
        )
    else:
        result = history.trace_rays(1, work[0], scene, optics, exits, None)
    ground_absorbed = np.zeros(len(exits))
    weights = result.crossings[:, CROSSING_WEIGHT] * np.exp(
        -result.crossings[:, CROSSING_LENGTH:] @ absorption[0]
    )
    np.add.at(ground_absorbed, result.crossings[:, CROSSING_RAY].astype(int), (1.0 - 0.6) * weights)
    reflected = exits[:, EXIT_SIDE] == 0.0
    assert not (exits[:, EXIT_SIDE] == 1.0).any() and len(result.crossings) > len(exits) / 4
    reflected_weights = exits[reflected, EXIT_WEIGHT] * np.exp(
        -exits[reflected, EXIT_LENGTH:] @ absorption[0]
    )
    assert reflected.sum() > 400 and (reflected_weights < 0.5).any()
    np.testing.assert_allclose(
        ground_absorbed[reflected] + reflected_weights, 1.0, rtol=0.0, atol=1e-12
    )


@pytest.mark.long
def test_spectral_and_analog_estimators_agree_over_a_ground():
    z = []
    for number, (medium, *_) in enumerate(MEDIA.values()):
        spectral, analog = (
            splits.spectrophotometer(
                place_over(medium, 0.4), WAVELENGTHS, 20.0, max_stderr=0.003, seed=20 + number,
                estimator=estimator,
            )
            for estimator in ("spectral", "analog")
        )  # fmt: skip
        z.append(compare_results(spectral, analog, "reflectance", "transmittance", "absorptance"))
    judge_z(np.concatenate(z), independent=len(MEDIA), bound_added=True)


def test_spectral_ground_albedo_agrees_with_single_albedos():
    """One ensemble serves black, grey and white grounds."""
    albedo = {"wavelength_nm": WAVELENGTHS, "albedo": [1.0, 0.0, 0.3]}
    ds = splits.spectrophotometer(
        place_over(WET, albedo), WAVELENGTHS, 10.0, max_stderr=0.002, seed=5
    )
    z = []
    for row, (w, value) in enumerate(zip(WAVELENGTHS, albedo["albedo"], strict=True)):
        single = splits.spectrophotometer(
            place_over(WET, value), w, 10.0, max_stderr=0.002, seed=6 + row
        )
        for quantity in ("reflectance", "transmittance"):
            error = np.hypot(ds[f"{quantity}_stderr"][row], single[f"{quantity}_stderr"][0])
            if float(error) > 0.0 and value < 1.0:
                z.append(float(ds[quantity][row] - single[quantity][0]) / float(error))
    judge_z(np.array(z), independent=len(WAVELENGTHS), bound_added=True)


def test_brdf_over_a_ground_integrates_to_reflectance():
    thin = place_over(WET, 0.8)
    brdf = splits.goniophotometer(thin, [500.0, 900.0], 40.0, relative_stderr=0.05, seed=2)
    flux = splits.spectrophotometer(thin, [500.0, 900.0], 40.0, max_stderr=0.001, seed=3)
    judge_z(compare_results(brdf, flux, "reflectance"), bound_added=True)
