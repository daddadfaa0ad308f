"""Delays and spread of light: path lengths, tallies, symmetry, scaling, diffusion, errors."""

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_scatter, judge_z

import splits
from splits.core.uncertainty import compute_batch_stderr
from splits.instruments.beam_spread import N_MAP_PIXELS
from splits.instruments.delay_record import compute_slowness
from splits.kernels.records import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)
from splits.kernels.tallies.distributions import tally_radial

SPEED_OF_LIGHT = 299_792_458.0
CLEAR = {"ice": 1.31, "water": 1.33}
SPHERES = {"facetness": (0.0, 0.0, 0.0, 0.1), "sphericity": (1.0, 1.0, 1.0, 0.1)}
UNLIMITED = {"delay_s": [0.0, 1e-10], "end_s": math.inf}


def make_snow(**keywords):
    return splits.Snow.natural(**{"specific_surface_area_m2_kg": 20.0, **keywords})


def sum_sides(dataset, name):
    """Return the mean over all incident light of a quantity of a clear slab, and its error."""
    value = (dataset.fraction * dataset[name]).sum("side")
    # Of each side; errors of fractions, which add up to 1, are included.
    difference = dataset[name].isel(side=0) - dataset[name].isel(side=1)
    variance = ((dataset.fraction * dataset[f"{name}_stderr"]) ** 2).sum("side")
    variance += (difference * dataset.fraction_stderr.isel(side=0)) ** 2
    return value.squeeze().values, np.sqrt(variance).squeeze().values


def compute_sphere_enhancement(n):
    """Return the mean path of diffuse light in a clear sphere over its mean chord."""
    return (n**3 - (n**2 - 1.0) ** 1.5) / n


def test_clear_slabs_have_the_mean_path_lengths_of_thermodynamics():
    """Diffuse light stays in a clear slab for 2 H times the part of each material (times B in ice).

    B is n² for light that reaches all modes of the grains (Blanco and Fournier 2003); light in a
    sphere does not reach those of total reflection.
    """
    z = []
    for density in (100.0, 350.0, 600.0):
        snow = make_snow(density_kg_m3=density, depth_m=0.01, refractive_index=CLEAR, **SPHERES)
        result = splits.time_of_flight(
            snow, 532.0, "diffuse", rays=100_000, **UNLIMITED, seed=int(density)
        )
        length, stderr = sum_sides(result, "path_length")
        ice = 1.0 - snow.porosity
        exact = 0.02 * np.array([snow.porosity, ice * compute_sphere_enhancement(1.31)])
        z.append((length[[0, 2]] - exact) / stderr[[0, 2]])
        assert (stderr[[0, 2]] < 0.005 * exact).all()
        np.testing.assert_allclose(result.fraction.sum("side"), 1.0, atol=1e-12)
    judge_z(z, independent=3)


def make_wet_slab(density, saturation):
    """Return a clear wet slab of spheres, and the mean path lengths (m) of equilibrium."""
    keywords = {"density_kg_m3": density, "depth_m": 0.01, "refractive_index": CLEAR, **SPHERES}
    porosity = make_snow(**keywords).porosity
    snow = make_snow(liquid_water_content=saturation * porosity * (1.0 - 1e-12), **keywords)
    air, water = (1.0 - saturation) * porosity, saturation * porosity
    return snow, 0.02 * np.array([air, 1.33**2 * water, 1.31**2 * (1.0 - porosity)])


def test_saturated_slabs_have_the_mean_path_lengths_of_thermodynamics():
    """2 H n² times the part of each material, as water does not reflect all light at any angle.

    Light reaches directions of total reflection at the boundaries by scattering.
    """
    z = []
    for density in (100.0, 350.0, 600.0):
        snow, exact = make_wet_slab(density, saturation=1.0)
        result = splits.time_of_flight(
            snow, 532.0, "diffuse", rays=100_000, **UNLIMITED, seed=int(density)
        )
        length, stderr = sum_sides(result, "path_length")
        z.append((length[1:] - exact[1:]) / stderr[1:])
        assert length[0] == 0.0
        assert (stderr[1:] < 0.015 * exact[1:]).all()
    judge_z(z, independent=3)


@pytest.mark.long
@pytest.mark.parametrize("saturation", [0.05, 0.3, 0.7])
def test_partly_wet_slabs_have_nearly_the_mean_path_lengths_of_equilibrium(saturation):
    """A new pore after each reflection at a grain does not keep equilibrium exactly.

    The rate of reflection from equilibrium, n² R in each kind of pore with the reflectance R of
    grains, is nearly the same in water and in air.
    """
    z = []
    for density in (100.0, 350.0, 600.0):
        snow, exact = make_wet_slab(density, saturation)
        result = splits.time_of_flight(
            snow, 532.0, "diffuse", rays=200_000, **UNLIMITED, seed=int(density)
        )
        length, stderr = sum_sides(result, "path_length")
        assert (stderr < 0.006 * exact).all()
        z.append((length - exact) / np.hypot(stderr, 0.003 * exact))
    judge_z(z, independent=3, bound_added=True)


@pytest.mark.long
@pytest.mark.parametrize("density", [100.0, 350.0, 600.0])
def test_natural_snow_has_the_mean_path_of_its_grains(density):
    snow = make_snow(density_kg_m3=density, depth_m=0.01, refractive_index=CLEAR)
    result = splits.time_of_flight(snow, 532.0, "diffuse", rays=100_000, **UNLIMITED)
    length, stderr = sum_sides(result, "path_length")
    weak = make_snow(density_kg_m3=density, refractive_index={"ice": "1.31+1e-9j"})
    grains = splits.single_scattering(weak, 532.0, rays=2_000_000)
    per_chord = 4.0 * math.pi * 1e-9 / 532e-9 / weak.attenuation_per_m
    enhancement = (1.0 - grains.single_scattering_albedo.item()) / per_chord
    relative = grains.single_scattering_albedo_stderr.item() / per_chord / enhancement
    exact = 0.02 * np.array([snow.porosity, (1.0 - snow.porosity) * enhancement])
    stderr = np.hypot(stderr[[0, 2]], exact * [0.0, relative])
    judge_z((length[[0, 2]] - exact) / stderr)


def test_delays_are_path_lengths_over_group_velocities():
    snow = make_snow(depth_m=0.05, liquid_water_content=0.03)
    result = splits.time_of_flight(snow, [532.0, 1064.0], 40.0, rays=20_000)
    slowness = compute_slowness(snow, np.array([532.0, 1064.0]))
    per_path = slowness.value / slowness.path_fractions
    delay = (result.path_length * per_path[np.newaxis]).sum("material")
    np.testing.assert_allclose(result.mean_delay, delay, rtol=1e-9)


def test_derivatives_of_reflectance_are_path_lengths():
    """−d ln R/dα is the mean length of the path in ice, for absorption by soot in the ice."""
    wavelengths = np.array([532.0, 900.0, 1064.0])
    snow = make_snow(depth_m=0.05, impurities_ng_g={"black_carbon": 100.0})
    spectrum = splits.spectrophotometer(
        snow, wavelengths, 30.0, jacobian=["impurities_ng_g.black_carbon"],
        solver="discrete_ordinates",
    )  # fmt: skip
    result = splits.time_of_flight(snow, wavelengths, 30.0, rays=200_000, **UNLIMITED)
    per_mass = snow.compute_added_absorption(wavelengths)[:, 2] / 100.0
    slope = spectrum.reflectance_jacobian.squeeze()
    expected = -slope / spectrum.reflectance / per_mass
    relative = np.hypot(
        spectrum.reflectance_jacobian_stderr.squeeze() / slope,
        spectrum.reflectance_stderr / spectrum.reflectance,
    )
    length = result.path_length.sel(side="reflected", material="ice")
    stderr = result.path_length_stderr.sel(side="reflected", material="ice")
    judge_z((length - expected) / np.hypot(stderr, relative * expected), 1, bound_added=True)


def fit_rate(result, power):
    """Return the decay rate (1/s) of light over an integer or half-integer power, and its error.

    Light per time from both sides is divided by t^(−power), averaged over bins.
    """
    rate = result.return_rate.sum("side").squeeze().values
    error = np.sqrt((result.return_rate_stderr**2).sum("side")).squeeze().values
    begin, end = result.delay_bounds.values.T
    law = (end ** (1.0 - power) - begin ** (1.0 - power)) / (1.0 - power) / (end - begin)
    slope, covariance = np.polyfit(
        0.5 * (begin + end), np.log(rate / law), 1, w=rate / error, cov="unscaled"
    )
    return -slope[0], math.sqrt(covariance[0, 0])


def compute_diffusion(snow):
    """Return the diffusion coefficient (m²/s) and the extrapolation length (m) of clear snow."""
    grains = splits.single_scattering(snow, 532.0, rays=200_000)
    transport = 1.0 / (snow.extinction_per_m * (1.0 - grains.asymmetry_parameter.item()))
    clear = make_snow(density_kg_m3=snow.density_kg_m3, depth_m=0.01, refractive_index=CLEAR)
    path = splits.time_of_flight(clear, 532.0, "diffuse", rays=100_000, **UNLIMITED)
    delay, _ = sum_sides(path, "mean_delay")
    return 0.02 / delay * transport / 3.0, 0.7104 * transport


@pytest.mark.long
def test_late_light_of_a_slab_decays_as_diffusion_theory_predicts():
    """By e^(−t/τ) with 1/τ = π² D/(H + 2 z)²; the sum of both sides has no antisymmetric modes."""
    snow = make_snow(density_kg_m3=300.0, depth_m=0.03, refractive_index=CLEAR)
    diffusion, extrapolation = compute_diffusion(snow)
    rate = diffusion * (math.pi / (0.03 + 2.0 * extrapolation)) ** 2
    edges = np.linspace(1.5, 4.5, 16) / rate
    result = splits.time_of_flight(snow, 532.0, rays=400_000, delay_s=edges, seed=3)
    measured, stderr = fit_rate(result, power=0.0)
    # Of the diffusion coefficient, from the asymmetry and the mean delay.
    tolerance = np.hypot(stderr, 0.01 * rate)
    assert stderr < 0.02 * rate
    assert abs(measured - rate) < 2.6 * tolerance, (measured / rate, stderr / rate)


@pytest.mark.long
def test_light_of_a_half_space_follows_the_law_of_diffusion():
    """As t^(−3/2) e^(−t/τ), where τ is the time until the grains absorb."""
    index = {"ice": "1.31+3e-8j"}
    snow = make_snow(density_kg_m3=300.0, depth_m=math.inf, refractive_index=index)
    clear = make_snow(density_kg_m3=300.0, depth_m=0.03, refractive_index=CLEAR)
    path = splits.time_of_flight(clear, 532.0, "diffuse", rays=100_000, **UNLIMITED)
    length, delay = (sum_sides(path, name)[0] for name in ("path_length", "mean_delay"))
    absorption = 4.0 * math.pi * 3e-8 / 532e-9
    rate = absorption * length[2] / delay
    edges = np.geomspace(1e-9, 2.0 / rate, 31)
    result = splits.time_of_flight(snow, 532.0, rays=200_000, delay_s=edges, seed=2)
    measured, stderr = fit_rate(result, power=1.5)
    assert stderr < 0.2 * rate
    assert abs(measured - rate) < 2.6 * stderr, (measured / rate, stderr / rate)


@pytest.mark.long
def test_errors_equal_the_scatter_of_seeds():
    snow = make_snow(depth_m=0.02)
    names = ["fraction", "mean_delay", "delay_spread", "path_length", "return_rate"]
    runs = [
        splits.time_of_flight(
            snow, [532.0, 1064.0], 30.0, rays=8192, seed=seed, delay_s=[0, 1e-11, 1e-10, 1e-9]
        )
        for seed in range(1, 41)
    ]
    ratios = []
    for name in names:
        values = np.stack([run[name].values for run in runs])
        stated = np.sqrt(np.mean([run[f"{name}_stderr"].values ** 2 for run in runs], axis=0))
        scatter = compute_batch_stderr(values) * math.sqrt(len(runs))
        seen = values.mean(axis=0) > 0.0
        ratios += (scatter[seen] / stated[seen]).tolist()
    rms = float(np.sqrt(np.mean(np.square(ratios))))
    print(f"{len(ratios)} quantities: scatter over stated error rms {rms:.3f}")
    assert 0.85 < rms < 1.15


def test_pulses_are_convolved():
    """A pulse delays light by its centroid, 0, and adds its variance."""
    snow, fwhm = make_snow(depth_m=0.01), 0.8e-9
    edges = np.linspace(-1.33e-9, 8e-9, 467)
    pulse = {"delay_s": [0.0, 1e-9, 3e-9], "power": [0.0, 2.0, 0.0]}
    start = {"rays": 8192, "delay_s": [0.0, 1e-12, 8e-9]}
    instant = splits.time_of_flight(snow, 1064.0, **start).squeeze().sel(side="reflected")
    variances = [(fwhm / math.sqrt(8.0 * math.log(2.0))) ** 2, (1.0 + 9.0 - 3.0) / 18.0 * 1e-18]
    for one, variance in zip([fwhm, pulse], variances, strict=True):
        result = splits.time_of_flight(snow, 1064.0, rays=8192, delay_s=edges, pulse=one)
        result = result.squeeze().sel(side="reflected")
        light = result.return_rate * np.diff(edges)
        total = light.sum()
        mean = (light * result.delay_s).sum() / total
        spread = np.sqrt((light * (result.delay_s - mean) ** 2).sum() / total)
        np.testing.assert_allclose(total, instant.fraction, rtol=1e-3)
        np.testing.assert_allclose(mean, instant.mean_delay, atol=3e-12)
        np.testing.assert_allclose(spread**2, instant.delay_spread**2 + variance, rtol=3e-3)


def test_intervals_of_depth_add_up():
    snow = make_snow(depth_m=0.05)
    result = splits.time_of_flight(snow, 532.0, rays=20_000, depth_m=[0.005, 0.02]).squeeze()
    reflected = result.sel(side="reflected")
    np.testing.assert_allclose(result.fraction_by_depth.sum(), reflected.fraction)
    delay = (result.fraction_by_depth * result.mean_delay_by_depth).sum() / reflected.fraction
    np.testing.assert_allclose(delay, reflected.mean_delay)
    least = 2.0 * result.depth_interval / SPEED_OF_LIGHT
    assert (result.mean_delay_by_depth > least).all()


def test_receivers_near_the_source_count_from_its_plane():
    """Light that is scattered back by the first grain travels along the beam both ways."""
    snow = make_snow(density_kg_m3=100.0, depth_m=0.5)
    record = {"rays": 100_000, "delay_s": [0.0, 1e-12, 1e-8]}
    whole = splits.time_of_flight(snow, 1300.0, 70.0, **record).sel(side="reflected")
    near = splits.time_of_flight(snow, 1300.0, 70.0, **record, acceptance_deg=10.0)
    near = near.sel(side="reflected")
    assert 0.0 < near.fraction < 0.2 * whole.fraction
    # Towards the horizon, light leaves at a larger distance than it is scattered back.
    assert near.mean_delay < whole.mean_delay
    narrow = splits.time_of_flight(snow, 1300.0, 70.0, **record, footprint_radius_m=0.005)
    narrow = narrow.sel(side="reflected")
    assert narrow.fraction < whole.fraction and narrow.mean_delay < whole.mean_delay


def test_records_of_any_length_agree():
    """The order of scattering after which paths end does not change what is recorded."""
    snow = make_snow(depth_m=0.02, ground=0.5)
    edges = [0.0, 1e-11, 1e-10, 5e-10]
    short, long = (
        splits.time_of_flight(snow, 532.0, rays=20_000, delay_s=edges, end_s=end)
        for end in (None, math.inf)
    )
    np.testing.assert_array_equal(short.return_rate, long.return_rate)
    assert short.fraction.sel(side="reflected") < long.fraction.sel(side="reflected")


def test_later_light_is_what_the_record_lacks():
    snow = make_snow(depth_m=0.05)
    early, whole = (
        splits.time_of_flight(
            snow, [532.0, 1064.0], 30.0, rays=50_000, seed=seed, delay_s=[0.0, 2e-10], end_s=end
        )
        for seed, end in ((1, None), (2, math.inf))
    )
    assert "late_fraction" not in whole
    later = whole.fraction - early.fraction
    z = (early.late_fraction - later) / np.hypot(early.late_fraction_stderr, whole.fraction_stderr)
    judge_z(z.sel(side="reflected"), independent=1, bound_added=True)


@pytest.mark.parametrize(
    ("make_medium", "end_s"),
    [(make_snow, 3e-12), (make_snow, 1e-11), (splits.Snow, 1e-11), (splits.Sand, 1e-12)],
)
def test_infinite_media_equal_thick_ones(make_medium, end_s):
    infinite, thick = (
        splits.time_of_flight(make_medium(depth_m=depth), 800.0, rays=8192, delay_s=[0.0, end_s])
        for depth in (math.inf, 0.05)
    )
    np.testing.assert_array_equal(infinite.return_rate, thick.return_rate)


def test_infinite_media_may_have_depths():
    snow = make_snow(depth_m=math.inf)
    result = splits.time_of_flight(snow, 532.0, rays=10, delay_s=[0, 1e-10], depth_m=[0.01, 0.3])
    np.testing.assert_allclose(
        result.fraction_by_depth.sum(), result.fraction.sel(side="reflected")
    )
    assert result.fraction_by_depth.values[-1] == 0.0


def test_moments_of_little_light_are_unknown():
    result = splits.time_of_flight(
        make_snow(depth_m=0.02), 1300.0, rays=8192, acceptance_deg=0.5, seed=5
    ).sel(side="reflected")
    assert result.fraction > 0.0 and result.fraction_stderr > 0.0
    for name in ("mean_delay", "delay_spread", "delay_skewness", "path_length"):
        assert np.isnan(result[name]).all() and np.isnan(result[f"{name}_stderr"]).all()


def test_all_light_towards_a_receiver_is_in_a_bin():
    sand = splits.Sand(interpretation="radiative_transfer", depth_m=0.05)
    result = splits.time_of_flight(
        sand, 800.0, 60.0, rays=8192, acceptance_deg=90.0, delay_s=[0.0, 1e-12, 1e-8]
    ).sel(side="reflected")
    width = np.diff(result.delay_bounds).ravel()
    np.testing.assert_allclose((result.return_rate * width).sum(), result.fraction)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"delay_s": [-1e-9, 1e-9]}, "delay_s = -1e-09: must be at least"),
        ({"delay_s": [1e-9]}, "at least two"),
        ({"delay_s": [2e-9, 1e-9]}, "strictly increasing"),
        ({"pulse": 1e-9, "delay_s": [0.0, 1e-9]}, "pulse = '3.397e-09 s long'"),
        ({"pulse": -1e-9}, "pulse = -1e-09: must be"),
        ({"pulse": {"delay_s": [0, 1]}}, "the columns delay_s and power"),
        ({"pulse": {"delay_s": [0, 1e-9], "power": [-1, 1]}}, "numbers from 0"),
        ({"acceptance_deg": 100.0}, "acceptance_deg = 100"),
        ({"acceptance_deg": 5, "incidence_deg": "diffuse"}, "acceptance_deg = 5.0: must be left"),
        ({"footprint_radius_m": 0.0}, "footprint_radius_m = 0"),
        ({"depth_m": [0.3]}, "depth_m = 0.3"),
        ({"medium": splits.ParticleLayer(optical_thickness=2.0)}, "a layer of grains"),
        ({"medium": splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=math.inf),
          "end_s": math.inf}, "end_s = inf: must be below .* s for an infinite depth"),
        ({"end_s": 1e-9}, "end_s = 1e-09: must be at least 1e-07 s"),
        ({"wavelength_nm": 215.0}, "wavelength_nm = 215.0: must be 8 % inside the range of all"),
        ({"pulse": {"delay_s": [0, 1e-13, 2e-13, 1e-9], "power": [0, 1, 0, 0]}},
         "pulse.delay_s = '1e-09 s long': must be at most 128 times as long"),
        ({"wavelength_nm": range(500, 1500), "delay_s": np.linspace(0.0, 1e-7, 10_000)},
         "wavelengths': must be at most .* with 9999 bins"),
    ],
)  # fmt: skip
def test_mistakes_have_one_message(keywords, message):
    arguments = {"medium": make_snow(depth_m=0.1), "wavelength_nm": 532.0, "rays": 10}
    with pytest.raises(ValueError, match=message) as caught:
        splits.time_of_flight(**{**arguments, **keywords})
    assert "\n" not in str(caught.value)


SNOW = splits.Snow(depth_m=0.02)


@pytest.mark.long
def test_exits_are_tallied_by_radius_and_pixel():
    rows = allocate_exits(4, 1)
    rows[:, EXIT_SIDE] = [0, 1, 0, 0]
    rows[:, EXIT_ORDER] = [1, 2, 0, 7]
    rows[:, EXIT_WEIGHT] = 1.0
    rows[:, EXIT_DIRECTION : EXIT_DIRECTION + 3] = [0.0, 0.0, 1.0]
    rows[:, EXIT_POSITION : EXIT_POSITION + 2] = [[0.0, 0.5], [3.0, 4.0], [0.0, 0.0], [200.0, 0.0]]
    rows[:, EXIT_LENGTH] = 0.5
    absorption = np.array([[0.0], [2.0]])
    radial, moment, pixel_map = tally_radial(rows, absorption, 1.0, 2, 6, 10.0, 5)
    attenuated = np.array([1.0, np.exp(-1.0)])
    # Bins end at 1, 10^½, 10, 10^3/2, 100: rays lie within 1, between 10^½ and 10, above 100.
    assert radial[0] == pytest.approx(np.outer(attenuated, [1, 0, 0, 0, 0, 1]))
    assert radial[1] == pytest.approx(np.outer(attenuated, [0, 0, 1, 0, 0, 0]))
    assert moment == pytest.approx(np.array([200.5 * attenuated, 5.0 * attenuated]))
    # A ray that exits beside the plane of incidence is divided between two mirrored pixels.
    assert pixel_map[0, 0, :, 2, 2] == pytest.approx(attenuated)
    assert pixel_map[0, 1, :, 3, 3] == pytest.approx(0.5 * attenuated)
    assert pixel_map[0, 1, :, 3, 1] == pytest.approx(0.5 * attenuated)
    assert pixel_map[0].sum() == pytest.approx(2.0 * attenuated.sum())
    assert pixel_map[1, 0, :, 2, 2] == pytest.approx(attenuated**2)
    assert pixel_map[1, 1, :, 3, 1] == pytest.approx(0.25 * attenuated**2)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_profile_and_map_integrate_to_the_reflectance(incidence):
    # Instruments number their random streams alike, so their seeds differ.
    ds = splits.beam_spread(
        SNOW, [600.0, 1300.0], incidence, rays=150_000, half_width_m=0.05, seed=1
    )
    total = splits.spectrophotometer(SNOW, [600.0, 1300.0], incidence, max_stderr=0.0015, seed=2)
    unscattered = splits.goniophotometer(SNOW, [600.0, 1300.0], incidence, rays=50_000, seed=3)
    edges = 10.0 ** (np.log10(ds.radius.values[0]) + (np.arange(73) - 0.5) / 8.0)
    inside = (ds.profile * np.pi * np.diff(edges**2)).sum("radius")
    assert inside.values == pytest.approx(ds.fraction.values, rel=1e-3)
    z = []
    # Only visible light is transmitted by 2 cm.
    for side, name, other, n_wavelengths in (
        ("reflected", "reflectance", "specular_reflectance", 2),
        ("transmitted", "transmittance", "direct_transmittance", 1),
    ):
        fraction = ds.fraction.sel(side=side).values + unscattered[other]
        error = np.hypot(ds.fraction_stderr.sel(side=side), total[f"{name}_stderr"])
        error = np.hypot(error, unscattered[f"{other}_stderr"])
        z.extend(((fraction - total[name]) / error).values[:n_wavelengths])
    judge_z(z, "beam spread against reflectance and transmittance", independent=1)
    pixel_area = (0.1 / N_MAP_PIXELS) ** 2
    map_fraction = ds.profile_map.sum(("x", "y")) * pixel_area
    assert (map_fraction <= ds.fraction + 1e-9).all()
    assert (map_fraction.sel(side="reflected") > 0.95 * ds.fraction.sel(side="reflected")).all()


@pytest.mark.long
@NEEDS_JIT
def test_oblique_beam_spreads_forward():
    normal = splits.beam_spread(SNOW, [600.0], 0.0, rays=100_000, half_width_m=0.01)
    oblique = splits.beam_spread(SNOW, [600.0], 70.0, rays=100_000, half_width_m=0.01)

    def compute_asymmetry(ds):
        """Return the difference between the halves of the map in units of its error."""
        first = ds.isel(wavelength=0).sel(side="reflected")
        sign = np.sign(first.x)
        value = float((first.profile_map * sign).sum())
        # Mirrored pixels hold the same estimate.
        return value / float(np.sqrt(2.0 * (first.profile_map_stderr**2).sum()))

    judge_z([compute_asymmetry(normal)], "a normal beam")
    assert compute_asymmetry(oblique) > 10.0
    for ds in (normal, oblique):
        assert np.allclose(ds.profile_map, ds.profile_map.values[..., ::-1])


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.long
def test_radii_scale_with_density_and_depth():
    # At half the density and twice the depth all paths are twice as long, without absorption and
    # with sparse grains.
    ice = {"ice": 1.31}
    common = {"saturation": 0.0, "refractive_index": ice}
    dense = splits.Snow(density_kg_m3=0.02, depth_m=100.0, **common)
    thin = splits.Snow(density_kg_m3=0.01, depth_m=200.0, **common)
    near, far = (
        splits.beam_spread(snow, [600.0], 30.0, rays=100_000, seed=seed)
        for seed, snow in enumerate((dense, thin))
    )
    z = []
    for name in ("quantile_radius", "mean_radius"):
        error = np.hypot(2.0 * near[f"{name}_stderr"], far[f"{name}_stderr"])
        z.extend(((far[name] - 2.0 * near[name]) / error).values.ravel())
    judge_z(z, "radii of similar samples", independent=1)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.long
def test_stated_errors_agree_with_scatter():
    runs = [
        splits.beam_spread(SNOW, [900.0], 45.0, rays=10_000, seed=s, half_width_m=0.01)
        for s in range(200)
    ]
    for name in ("mean_radius", "quantile_radius", "fraction"):
        values, stated = ([run[f"{name}{end}"].values for run in runs] for end in ("", "_stderr"))
        judge_scatter(values, stated, name)


@pytest.mark.long
@NEEDS_JIT
def test_radius_is_zero_without_exiting_light():
    ds = splits.beam_spread(splits.Snow(), [1450.0], 0.0, rays=8192)
    transmitted = ds.sel(side="transmitted")
    assert not transmitted.mean_radius.values.any() and not transmitted.quantile_radius.values.any()
    assert all(np.isfinite(ds[name]).all() for name in ds.data_vars)


@pytest.mark.long
@pytest.mark.filterwarnings("error")
def test_map_without_light_is_finite():
    ds = splits.beam_spread(splits.ParticleLayer(opaque=True), [550.0], rays=256)
    assert not ds.fraction.values.any()
    assert all(np.isfinite(ds[name]).all() for name in ds.data_vars)


@pytest.mark.long
@NEEDS_JIT
def test_results_are_independent_of_threads():
    runs = [splits.beam_spread(SNOW, [600.0], 30.0, rays=20_000, threads=n) for n in (1, 2, 4)]
    for run in runs[1:]:
        assert all(np.array_equal(runs[0][name], run[name]) for name in run.data_vars)


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("incidence_deg", 91.0, r"in \[0, 89.9999\] degrees"),
        ("rays", 0.5, "a whole number of at least 1"),
        ("half_width_m", 0.0, r"in \[1e-09, 1e\+06\] m"),
        ("kernel", "vector", "did you mean vectorized"),
        ("threads", 0, "a whole number of at least 1"),
    ],
)
def test_invalid_values_are_rejected_by_name(key, value, message):
    with pytest.raises(ValueError, match=message) as error:
        splits.beam_spread(SNOW, [600.0], **{key: value})
    assert str(error.value).startswith(f"{key} = ")
