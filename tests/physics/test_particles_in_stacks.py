"""Stacks: particle layers, sparse snow over a ground, subdivision, and limits."""

from dataclasses import replace

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z
from scattering_matrices import make_matrix

import splits
from splits.analysis.theory.spectra import solve_discrete_ordinates

TABLE = {"cosine": [-1.0, 0.0, 0.5, 1.0], "density": [0.3, 0.1, 0.4, 2.0]}
LAYERS = {
    "forward": {"optical_thickness": 5.0, "single_scattering_albedo": 0.95, "asymmetry": 0.75,
                "refractive_index": 1.3},
    "rayleigh": {"optical_thickness": 2.0, "phase_function": "rayleigh", "refractive_index": 1.0},
    "table": {"optical_thickness": 1.0, "phase_function": TABLE, "refractive_index": 1.5,
              "single_scattering_albedo": 0.6},
    "absorbing": {"optical_thickness": 3.0, "single_scattering_albedo": 0.0,
                  "refractive_index": 1.33},
}  # fmt: skip
TOP = splits.ParticleLayer(optical_thickness=1.0, refractive_index=1.31, ground=None, depth_m=0.01)
SNOW = splits.Snow(depth_m=0.006, saturation=0.0)
SAND = splits.Sand(depth_m=0.004, interpretation="splitsnow_2021")
WAVELENGTHS = [500.0, 900.0]
PROFILES = ("downward_irradiance", "upward_irradiance", "absorptance", "actinic_flux")


def measure(medium, incidence, seed, **settings):
    """Return R, T and A and their standard errors, shape (2, 3, wavelengths)."""
    wavelengths = settings.pop("wavelengths", [550.0])
    ds = splits.spectrophotometer(
        medium, wavelengths, incidence, max_stderr=0.002, seed=seed, **settings
    )
    names = ("reflectance", "transmittance", "absorptance")
    return np.array([[ds[name] for name in names], [ds[f"{name}_stderr"] for name in names]])


def compute_z(one, other):
    """Return the differences of two measurements in standard errors, where these are positive."""
    error = np.hypot(one[1], other[1])
    uncertain = error > 0.0
    assert (one[0][~uncertain] == other[0][~uncertain]).all()
    return ((one[0] - other[0])[uncertain] / error[uncertain]).ravel()


def subdivide(settings, n_sublayers):
    """Return a particle layer subdivided into unequal sublayers."""
    fractions = np.geomspace(1.0, 20.0, n_sublayers)
    fractions /= fractions.sum()
    thickness = settings["optical_thickness"]
    return splits.Stack(
        [
            splits.ParticleLayer(
                **{**settings, "optical_thickness": fraction * thickness}, ground=None,
                depth_m=fraction,
            )
            for fraction in fractions
        ]
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", LAYERS)
def test_layer_in_stack_equals_the_layer(name):
    """Stacks of 1, 2, 3 and 7 sublayers agree with the particle-layer kernel."""
    layer = splits.ParticleLayer(**LAYERS[name], ground=None)
    z = []
    for number, incidence in enumerate((0.0, 60.0, "diffuse")):
        reference = measure(layer, incidence, 10 * number)
        for n_sublayers in (1, 2, 3, 7):
            stack = subdivide(LAYERS[name], n_sublayers)
            z.append(compute_z(measure(stack, incidence, 10 * number + n_sublayers), reference))
    judge_z(np.concatenate(z), name, independent=3, bound_added=True)


@pytest.mark.long
@pytest.mark.parametrize("albedo", [0.95, 1.0])
def test_subdivided_infinite_layer_equals_the_layer(albedo):
    layer = splits.ParticleLayer(
        optical_thickness=np.inf, single_scattering_albedo=albedo, asymmetry=0.5,
        refractive_index=1.33, ground=None, depth_m=0.5,
    )  # fmt: skip
    stack = splits.Stack([replace(layer, optical_thickness=2.0, depth_m=1.0), layer])
    assert stack.is_semi_infinite
    depths, view = [0.2, 0.7, 1.5], {"polar_deg": [0.0, 40.0], "azimuth_deg": [0.0, 120.0]}
    values = []
    for seed, medium in enumerate((layer, stack)):
        profile = splits.irradiance_profile(
            medium, 550.0, 30.0, depth_m=depths, max_stderr=0.005, seed=seed
        )
        next_event = {"estimator": "next_event", "rays": 20_000, "seed": seed}
        radiance = splits.goniophotometer(medium, 550.0, 30.0, **view, **next_event)
        flux = [profile[name].values.ravel() for name in PROFILES]
        flux_stderr = [profile[f"{name}_stderr"].values.ravel() for name in PROFILES]
        scattered = radiance.isel(azimuth_deg=slice(1, None))
        brdf = [scattered.brdf.values.ravel()], [scattered.brdf_stderr.values.ravel()]
        values.append([np.concatenate(flux + brdf[0]), np.concatenate(flux_stderr + brdf[1])])
    judge_z(compute_z(*values), albedo, independent=3, bound_added=True)
    measured = [measure(medium, 30.0, 5 + n) for n, medium in enumerate((layer, stack))]
    judge_z(compute_z(*measured), albedo, independent=1, bound_added=True)


@pytest.mark.long
def test_brdf_of_subdivided_layer_equals_that_of_the_layer():
    view = {"polar_deg": [15.0, 45.0, 70.0], "azimuth_deg": [0.0, 90.0, 180.0], "rays": 200_000}
    layer = splits.ParticleLayer(**LAYERS["forward"], ground=None)
    reference = splits.goniophotometer(layer, 550.0, 40.0, **view)
    z = []
    for n_sublayers in (2, 3, 7):
        subdivided = splits.goniophotometer(
            subdivide(LAYERS["forward"], n_sublayers), 550.0, 40.0, seed=n_sublayers, **view
        )
        z.append(compare_results(subdivided, reference, "brdf"))
    judge_z(np.concatenate(z), independent=3, bound_added=True)


@pytest.mark.long
def test_ground_reflections_follow_the_adding_series():
    layers = [TOP, SNOW, SAND]
    light = {"wavelengths": WAVELENGTHS}
    (r, t, _), (dr, dt, _) = measure(splits.Stack(layers), 40.0, 1, **light)
    (r2, t2, _), (dr2, dt2, _) = measure(splits.Stack(layers[::-1]), "diffuse", 2, **light)
    z = []
    for seed, albedo in enumerate((0.1, 0.5, 0.9, 1.0), start=3):
        measurement = measure(splits.Stack(layers, ground=albedo), 40.0, seed, **light)
        series = 1.0 / (1.0 - albedo * r2)
        expected = r + t * albedo * t2 * series
        one, other = dr + dt * albedo * t2 * series, dt2 * albedo * t * series
        error = np.hypot(one, other + dr2 * t * t2 * (albedo * series) ** 2)
        z.append((measurement[0, 0] - expected) / np.hypot(error, measurement[1, 0]))
    judge_z(np.concatenate(z), independent=4, bound_added=True)


@pytest.mark.long
def test_energy_is_conserved_without_absorption():
    transparent = splits.Snow(
        depth_m=0.003, saturation=0.2, refractive_index={"ice": 1.31, "water": 1.33}
    )
    conservative = splits.ParticleLayer(
        optical_thickness=4.0, single_scattering_albedo=1.0, refractive_index=1.4,
        ground=None, depth_m=0.01,
    )  # fmt: skip
    for ground in (None, 1.0):
        stack = splits.Stack([transparent, conservative, transparent], ground=ground)
        balance = measure(stack, 70.0, 4)[0]
        assert balance[:2].sum() == pytest.approx(1.0, abs=1e-12)
        assert balance[2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.long
def test_matrix_of_pore_index_needs_no_interface():
    """Rays enter the snow below with and without an interface; rejected grains have no effect."""
    haze = {"optical_thickness": 0.7, "ground": None, "depth_m": 0.005}
    thin = splits.Snow(saturation=0.0, depth_m=0.0008)
    z = []
    for incidence in (0.0, 60.0):
        without_interface, with_interface = (
            measure(
                splits.Stack([splits.ParticleLayer(**haze, refractive_index=n), thin]),
                incidence,
                seed,
            )
            for seed, n in ((21, 1.0), (22, 1.0 + 1e-9))
        )
        z.append(compute_z(without_interface, with_interface))
    judge_z(np.concatenate(z), independent=2, bound_added=True)


@pytest.mark.long
@pytest.mark.parametrize("thickness", [0.0, 1e-6])
def test_transparent_plate_on_wet_snow_conserves_energy(thickness):
    """Light enters the plate from wet pores at angles that dry pores and air reflect totally."""
    plate = splits.ParticleLayer(
        optical_thickness=thickness, single_scattering_albedo=1.0, refractive_index=1.5,
        ground=None, depth_m=0.01,
    )  # fmt: skip
    transparent = {"refractive_index": {"ice": 1.31, "water": 1.33}}
    snow = splits.Snow(depth_m=0.004, saturation=0.3, **transparent)
    one = measure(splits.Stack([plate, snow]), 30.0, 40)
    assert one[0, 2] == pytest.approx(0.0, abs=1e-12)
    other = measure(splits.Stack([plate, snow]), 30.0, 41, estimator="analog")
    judge_z(compute_z(one, other), independent=1, bound_added=True)


@pytest.mark.long
def test_matrix_interfaces_ignore_boundary_fresnel_of_pores():
    """Dry snow has no interface of its own, so `boundary_fresnel` does not apply."""
    plate = splits.ParticleLayer(
        optical_thickness=0.1, refractive_index=1.5, ground=None, depth_m=0.01
    )
    z = []
    for number, interpretation in enumerate(({}, {"boundary_fresnel": "no"})):
        snow = splits.Snow(depth_m=0.004, saturation=0.0, interpretation=interpretation)
        z.append(measure(splits.Stack([plate, snow], ground=0.1), 30.0, 30 + number))
    judge_z(compute_z(*z), independent=1, bound_added=True)


@pytest.mark.long
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"ground": 0.3}, r"layers\[0\].ground = 0.3: must be left out"),
        ({"ground": None, "opaque": True}, r"layers\[0\].opaque = True"),
        ({"ground": None, "optical_thickness": np.inf}, r"layers\[0\].*must be finite"),
    ],
)  # fmt: skip
def test_invalid_settings_of_stacked_layers_are_rejected(settings, message):
    with pytest.raises(ValueError, match=message):
        splits.Stack([splits.ParticleLayer(**settings), SNOW])


@pytest.mark.long
def test_infinite_particle_layer_hides_no_ground():
    infinite = splits.ParticleLayer(optical_thickness=np.inf, ground=None)
    with pytest.raises(ValueError, match=r"ground = .* must be left out .*layers\[1\]"):
        splits.Stack([SNOW, infinite], ground=0.3)


@pytest.mark.long
@pytest.mark.parametrize("polarized", [False, True])
def test_next_event_estimates_of_subdivided_layers_agree(polarized):
    """Layers of one index in a stack, at depths of different extinction coefficients."""
    settings = {"optical_thickness": 2.0, "refractive_index": 1.33, "polarized": polarized,
                "single_scattering_albedo": 0.9, "asymmetry": 0.5}  # fmt: skip
    media = [splits.ParticleLayer(**settings, ground=None), subdivide(settings, 3)]
    thin_top = [replace(media[1].layers[0], depth_m=7.0), *media[1].layers[1:]]
    runs = [
        splits.goniophotometer(
            medium, [550.0], 40.0, seed=seed, estimator="next_event", relative_stderr=0.005,
            polar_deg=[0.0, 30.0, 60.0], azimuth_deg=[0.0, 90.0, 180.0],
        )
        for seed, medium in enumerate([*media, splits.Stack(thin_top)])
    ]  # fmt: skip
    names = ["brdf", "btdf", *(["brdf_q", "brdf_u", "btdf_q"] if polarized else [])]
    z = [compare_results(runs[0], other, *names) for other in runs[1:]]
    judge_z(np.concatenate(z), "subdivided layers", independent=2)


@pytest.mark.long
@pytest.mark.parametrize("polarized", [False, True])
def test_next_event_estimates_of_stacks_agree_with_bins(polarized):
    """Layers of three indices: light is refracted and reflected at each interface."""
    middle = (
        {"scattering_matrix": make_matrix(0.9)} if polarized else {"phase_function": "rayleigh"}
    )
    names = ["brdf", "btdf"]
    names += [f"{name}_{component}" for name in names for component in "quv"] if polarized else []
    stack = splits.Stack(
        [
            splits.ParticleLayer(1.0, 0.9, 0.3, 1.33, None, depth_m=0.1, polarized=polarized),
            splits.ParticleLayer(0.5, 1.0, 0.0, 1.0, None, polarized=polarized, **middle),
            splits.ParticleLayer(2.0, 0.9, 0.6, 1.6, None, polarized=polarized),
        ]
    )  # fmt: skip
    bins = splits.goniophotometer(stack, [550.0], 30.0, estimator="bins", n_bins=(30, 8))
    bins = bins.isel(polar_deg=bins.polar_deg.values < 75.0)
    local = splits.goniophotometer(
        stack, [550.0], 30.0, seed=2, estimator="next_event", relative_stderr=0.01,
        polar_deg=bins.polar_deg.values, azimuth_deg=bins.azimuth_deg.values[:4],
    )  # fmt: skip
    bins = bins.sel(azimuth_deg=local.azimuth_deg)
    for name in (*names, "reflectance"):
        judge_z(compare_results(bins, local, name), name)


@pytest.mark.long
def test_polarized_subdivided_layers_agree_with_single_layers():
    settings = {"optical_thickness": 2.0, "phase_function": "rayleigh", "polarized": True,
                "refractive_index": 1.5}  # fmt: skip
    single = splits.ParticleLayer(**settings, ground=None)
    z = compute_z(measure(single, 50.0, 50), measure(subdivide(settings, 3), 50.0, 51))
    judge_z(z, independent=1)
    profile = splits.irradiance_profile(
        subdivide(settings, 2), [550.0], 50.0, depth_m=[0.5], max_stderr=0.004
    )
    error = np.hypot(profile.upward_irradiance_stderr[0, 0], 0.002)
    reflectance = measure(single, 50.0, 50)[0, 0]
    judge_z((profile.upward_irradiance.values[0, 0] - reflectance) / error.values, independent=1)


@pytest.mark.long
@pytest.mark.parametrize(
    ("layers", "ground", "message"),
    [
        ([TOP, SNOW], None, "for grains"),
        ([TOP, replace(TOP, asymmetry=0.95)], None, "require a single layer"),
        ([TOP, TOP], 0.5, "over the ground of a stack"),
        ([TOP], 0.5, "over the ground of a stack"),
    ],
)
def test_unsupported_next_event_estimates_are_rejected(layers, ground, message):
    stack = splits.Stack(layers, ground)
    with pytest.raises(ValueError, match=f"estimator = 'next_event'.*{message}"):
        splits.goniophotometer(stack, 550.0, 30.0, estimator="next_event")


@pytest.mark.long
def test_next_event_estimates_at_grazing_directions_are_finite():
    layer = splits.ParticleLayer(0.5, 0.9, 0.3, 1.0, None)
    view = {"polar_deg": [89.999, 89.9999999], "azimuth_deg": [0.0], "rays": 2000}
    grazing = splits.goniophotometer(layer, 550.0, 30.0, estimator="next_event", **view)
    assert (grazing.brdf.values >= 0.0).all() and (grazing.brdf_stderr.values > 0.0).all()


@pytest.mark.long
def test_stokes_parameters_without_scores_have_errors():
    layer = splits.ParticleLayer(1e-9, ground=None, polarized=True)
    view = {"polar_deg": [45.0], "azimuth_deg": [0.0, 120.0], "rays": 2000}
    ds = splits.goniophotometer(layer, 550.0, 30.0, estimator="next_event", **view)
    for name in ("brdf", "brdf_q", "brdf_u", "brdf_v"):
        np.testing.assert_allclose(ds[f"{name}_stderr"], 1.0 / (np.pi * ds.attrs["rays"]))


@pytest.mark.long
def test_layers_lost_in_rounding_are_rejected():
    layers = [replace(TOP, depth_m=1e5), replace(TOP, depth_m=1e-6)]
    with pytest.raises(ValueError, match=r"layers\[1\].depth_m = 1e-06: must be at least 1e-05 m"):
        splits.Stack(layers)


@pytest.mark.long
@pytest.mark.parametrize("others", [[SNOW], [TOP], [TOP, SNOW]])
def test_polarization_requires_that_all_layers_are_polarized(others):
    polarized = replace(TOP, polarized=True)
    with pytest.raises(ValueError, match=r"layers\[0\].polarized = True: must be false, or true"):
        splits.Stack([polarized, *others])
    with pytest.raises(ValueError, match=r"polarized = True: must be false, or true for all"):
        splits.Stack([*others, polarized])


@pytest.mark.long
def test_only_the_top_layer_may_be_rough():
    waves = {"rms_height_m": 1e-3, "wave_number_per_m": 1.0, "waves": 4, "correlation": "gaussian"}
    rough = splits.ParticleLayer(ground=None, surface=waves)
    assert splits.Stack([rough, TOP]).depth_m == 1.01
    with pytest.raises(ValueError, match=r"layers\[1\].surface = .*: must be left out"):
        splits.Stack([TOP, rough])


@pytest.mark.long
def test_vectorized_kernel_rejects_particle_layers():
    with pytest.raises(ValueError, match="not for particle layers"):
        splits.spectrophotometer(splits.Stack([TOP, SNOW]), 500.0, kernel="vectorized")


SPECTRUM = np.geomspace(500.0, 1800.0, 12)
# One refractive index, hence one node without interpolation; absorption from weak to strong.
ICE = {"wavelength_nm": [400.0, 2000.0], "n": [1.31, 1.31], "k": [1e-8, 3e-4]}
FINE, MEDIUM, COARSE_GRAINS = (30.0, 60.0), (100.0, 300.0), (500.0, 1500.0)
SMOOTH, ROUGH = (0.0, 0.0, 0.0, 0.0), (0.5, 0.9, 0.7, 0.1)
SOIL = {"wavelength_nm": [400.0, 2000.0], "albedo": [0.05, 0.6]}
SNOWPACKS = {
    "two layers": ([(1.0, FINE, ROUGH), (3.0, COARSE_GRAINS, SMOOTH)], 0.3),
    "coarse above fine": (
        [(2.0, COARSE_GRAINS, ROUGH), (1.0, FINE, SMOOTH), (4.0, MEDIUM, ROUGH)],
        SOIL,
    ),
    "thin over white": (
        [(0.2, MEDIUM, SMOOTH), (0.3, FINE, ROUGH), (0.2, COARSE_GRAINS, ROUGH)],
        1.0,
    ),
}


def make_sparse_snow(thickness, size, facetness):
    """Return dry snow of an optical thickness, with sparse grains of which none is rejected."""
    common = {
        "grain_size_um": size, "facetness": facetness, "saturation": 0.0, "density_kg_m3": 1e-3,
        "interpretation": {
            "overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep",
        },
        "refractive_index": {"ice": ICE},
    }  # fmt: skip
    deep = splits.Snow(**common, depth_m=1e4)
    return splits.Snow(**common, depth_m=thickness * deep.mean_grain_distance_m)


@NEEDS_JIT
@pytest.mark.long
def test_snowpacks_agree_with_discrete_ordinates():
    pytest.importorskip("PythonicDISORT")
    z = []
    for number, (layers, ground) in enumerate(SNOWPACKS.values()):
        media = [make_sparse_snow(*layer) for layer in layers]
        snowpack = splits.Stack(media, ground=ground)
        optics = [
            splits.single_scattering(medium, SPECTRUM, rays=400_000, seed=10 * number + i)
            for i, medium in enumerate(media)
        ]
        for incidence in (20.0, 60.0):
            expected = solve_discrete_ordinates(optics, incidence, ground=ground)
            spectrum = splits.spectrophotometer(
                snowpack,
                SPECTRUM,
                incidence,
                max_stderr=0.001,
                seed=100 + 10 * number + round(incidence),
            )
            z.append(compare_results(spectrum, expected, "reflectance", "absorptance"))
    # The twelve wavelengths use the same paths.
    judge_z(np.array(z), independent=len(SNOWPACKS) * 2, bound_added=True)


TWO_WAVELENGTHS = [500.0, 1300.0]
WET = {"saturation": 0.05, "depth_m": 0.01}
COARSE_SNOW = {"grain_size_um": (800, 1000), "saturation": 0.05}
TINY = {"grain_size_um": (10, 20), "saturation": 0.0, "depth_m": 0.0005}
HUGE = {"grain_size_um": (1000, 2000), "saturation": 0.0, "depth_m": 0.02}


def measure_snow(medium, incidence=30.0, seed=1, **settings):
    ds = splits.spectrophotometer(
        medium, TWO_WAVELENGTHS, incidence, max_stderr=0.004, seed=seed, **settings
    )
    names = ("reflectance", "transmittance", "absorptance")
    values = np.stack([ds[name].values for name in names])
    assert np.isfinite(values).all() and ds.reflectance.values.max() <= 1.0
    return values, np.stack([ds[f"{name}_stderr"].values for name in names])


def compute_scores(one, other):
    """Return the differences of two measurements in units of their standard errors."""
    return (one[0] - other[0]) / np.hypot(one[1], other[1])


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_vanishing_layer_has_no_effect(kernel):
    film = splits.Snow(**{**TINY, "depth_m": 1e-8})
    with_film = splits.Stack([splits.Snow(**WET), film, splits.Snow(**WET)])
    without = splits.Snow(**{**WET, "depth_m": 0.02})
    one, other = measure_snow(with_film, seed=1, kernel=kernel), measure_snow(without, seed=2)
    judge_z(compute_scores(one, other), independent=1, bound_added=True)


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_grains_may_be_larger_than_sublayers(kernel):
    sublayers = [
        splits.Snow(**COARSE_SNOW, depth_m=depth) for depth in (1e-4, 2e-4, 3e-3, 5e-5, 1.65e-3)
    ]
    single_layer = splits.Snow(**COARSE_SNOW, depth_m=5e-3)
    one = measure_snow(splits.Stack(sublayers), seed=3, kernel=kernel)
    judge_z(
        compute_scores(one, measure_snow(single_layer, seed=4)), independent=1, bound_added=True
    )


def test_fifty_equal_layers_equal_one_layer():
    sublayers = [splits.Snow(saturation=0.05, depth_m=0.0004)] * 50
    single_layer = splits.Snow(saturation=0.05, depth_m=0.02)
    one, other = measure_snow(splits.Stack(sublayers), seed=5), measure_snow(single_layer, seed=6)
    judge_z(compute_scores(one, other), independent=1, bound_added=True)


@pytest.mark.parametrize("order", [(TINY, HUGE), (HUGE, TINY)])
def test_kernels_agree_on_size_ratios_of_a_hundred(order):
    stack = splits.Stack([splits.Snow(**settings) for settings in order], ground=0.5)
    vector, scalar = (
        measure_snow(stack, 50.0, seed, kernel=kernel)
        for seed, kernel in ((7, "vectorized"), (8, "scalar"))
    )
    judge_z(compute_scores(vector, scalar), independent=1, bound_added=True)


def test_kernels_agree_at_grazing_incidence():
    stack = splits.Stack([splits.Snow(**TINY), splits.Snow(**WET)], ground=0.9)
    vector, scalar = (
        measure_snow(stack, 89.9, seed, kernel=kernel)
        for seed, kernel in ((9, "vectorized"), (10, "scalar"))
    )
    judge_z(compute_scores(vector, scalar), independent=1, bound_added=True)
