"""Single-scattering properties of grains, and their optical shape."""

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_scatter, judge_z
from scipy import stats

import splits
from splits.analysis.theory.grain_shape import compute_optical_shape
from splits.analysis.theory.spectra import compute_shape_factors
from splits.instruments.single_scattering import GRAIN_RAYS_PER_CHUNK, single_scattering
from splits.materials import ice_density

SPHERES = {"facetness": (0.0, 0.0, 0.0, 0.0), "sphericity": (1.0, 1.0, 1.0, 0.0)}
PROJECTED = {"entry_point": "projected"}
RAYS = 100_000


def make_dry_snow(ice, **settings):
    return splits.Snow(saturation=0.0, refractive_index={"ice": ice}, **settings)


@NEEDS_JIT
def test_asymmetry_of_a_smooth_ice_sphere():
    from test_sphere_scattering import integrate_impacts, mean_cosine, projected_density

    ds = single_scattering(
        make_dry_snow(1.31, **SPHERES, interpretation=PROJECTED), 500.0, rays=400_000
    )
    expected = integrate_impacts(lambda i: mean_cosine(i, 1.31), projected_density)
    assert abs(expected - 0.78) < 0.005
    error = float(ds.asymmetry_parameter_stderr[0])
    assert 0.0 < error < 0.002
    judge_z([(float(ds.asymmetry_parameter[0]) - expected) / error], "asymmetry")


@NEEDS_JIT
@pytest.mark.parametrize("saturation", [0.0, 0.3])
def test_albedo_is_one_without_absorption(saturation):
    snow = splits.Snow(saturation=saturation, refractive_index={"ice": 1.31, "water": 1.33})
    ds = single_scattering(snow, [400.0, 1500.0], rays=RAYS)
    assert (ds.single_scattering_albedo == 1.0).all()
    assert (ds.single_scattering_albedo_stderr == 0.0).all()


@NEEDS_JIT
def test_matched_grain_scatters_forward_only():
    ds = single_scattering(make_dry_snow(1.0, facetness=(0.5, 1.0, 0.8, 0.1)), 500.0, rays=RAYS)
    assert np.abs(ds.legendre_moment - 1.0).max() < 1e-10
    assert np.abs(ds.legendre_moment_stderr).max() < 1e-6


@NEEDS_JIT
def test_matched_grain_absorbs_along_its_chord():
    # Over its projected area, a convex grain has the mean chord volume / projected area.
    alpha = 1.0
    snow = make_dry_snow(complex(1.0, alpha * 500e-9 / (4.0 * math.pi)), interpretation=PROJECTED)
    chord = 1.0 / snow.attenuation_per_m
    runs = [single_scattering(snow, 500.0, rays=400_000, seed=seed) for seed in range(1, 5)]
    absorbed = np.array([1.0 - float(ds.single_scattering_albedo[0]) for ds in runs])
    error = np.array([float(ds.single_scattering_albedo_stderr[0]) for ds in runs])
    # The second-order term in αl is at most 1e-6, as <l²> < 3 <l>².
    second = 1.5 * (alpha * chord) ** 2
    judge_z((absorbed - alpha * chord) / np.hypot(error, second), "each seed")
    mean_error = np.hypot(error.mean() / len(runs) ** 0.5, second)
    judge_z([(absorbed.mean() - alpha * chord) / mean_error], "mean over seeds")
    displacements = np.array([float(ds.displacement_along_incident[0]) for ds in runs])
    assert (
        abs(displacements.mean() - chord)
        < stats.t.isf(0.005, 3) * displacements.std(ddof=1) / len(runs) ** 0.5
    )


@NEEDS_JIT
def test_shape_factors_of_smooth_spheres():
    # B = n² (1 − (1 − 1/n²)^(3/2)): path in a weakly absorbing sphere over its mean chord.
    snow = make_dry_snow(1.31 + 1e-8j, **SPHERES, interpretation=PROJECTED)
    ds = single_scattering(snow, 1000.0, rays=400_000, seed=2)
    enhancement, asymmetry = compute_shape_factors(ds, snow.specific_surface_area_m2_kg, 1e-8)
    density = ice_density(snow.temperature_c)
    expected = 1.31**2 * (1.0 - (1.0 - 1.31**-2) ** 1.5) * 917.0 / density
    # The enhancement is proportional to 1 − ω, whose error is known.
    albedo, error = (float(ds[f"single_scattering_albedo{end}"][0]) for end in ("", "_stderr"))
    judge_z([(enhancement[0] / expected - 1.0) / (error / (1.0 - albedo))], "enhancement")
    assert asymmetry[0] == pytest.approx(0.89, abs=0.003)


@NEEDS_JIT
def test_first_legendre_moments_are_one_and_asymmetry():
    ds = single_scattering(splits.Snow(), [500.0, 1030.0, 1500.0], rays=RAYS, moments=8)
    first = ds.legendre_moment.sel(order=1)
    assert (first == ds.asymmetry_parameter).all()
    assert (ds.legendre_moment_stderr.sel(order=1) == ds.asymmetry_parameter_stderr).all()
    assert (ds.legendre_moment.sel(order=0) == 1.0).all()
    assert ds.sizes["order"] == 9
    assert np.abs(ds.legendre_moment).max() <= 1.0


@NEEDS_JIT
@pytest.mark.parametrize("medium", [splits.Snow(), splits.Sand()])
def test_results_are_independent_of_threads(medium):
    runs = [
        single_scattering(medium, [500.0, 900.0], rays=5 * GRAIN_RAYS_PER_CHUNK, seed=4, threads=n)
        for n in (1, 2)
    ]
    assert runs[0].equals(runs[1])
    other = single_scattering(medium, [500.0, 900.0], rays=5 * GRAIN_RAYS_PER_CHUNK, seed=5)
    assert not runs[0].equals(other)


@NEEDS_JIT
def test_stated_errors_agree_with_scatter():
    names = ("single_scattering_albedo", "legendre_moment", "displacement_along_incident")
    names += ("displacement_along_exit", "mean_square_displacement", "wet_fraction")
    wet = splits.Snow(saturation=0.3, refractive_index={"ice": 1.31 + 1e-4j, "water": 1.33})
    runs = [
        single_scattering(wet, 1000.0, moments=4, rays=2 * GRAIN_RAYS_PER_CHUNK, seed=seed)
        for seed in range(40, 120)
    ]
    for name in names:
        values, stated = ([run[f"{name}{end}"].values for run in runs] for end in ("", "_stderr"))
        judge_scatter(values, stated, name)


@NEEDS_JIT
def test_interpolation_between_indices_is_within_errors():
    snow = splits.Snow()
    wavelengths = np.array([500.0, 800.0, 1100.0, 1400.0, 1600.0, 1900.0, 2300.0])
    shared = single_scattering(snow, wavelengths, moments=16, rays=400_000)
    assert shared.attrs["ensembles"] < len(wavelengths)
    z = {"single_scattering_albedo": [], "legendre_moment": []}
    for seed, wavelength in enumerate(wavelengths, start=2):
        single = single_scattering(snow, wavelength, moments=16, rays=400_000, seed=seed)
        selected = shared.sel(wavelength=[wavelength])
        for name, values in z.items():
            # Moment 0 is 1, without an error.
            values.append(compare_results(single, selected, name))
    for name, values in z.items():
        # Errors include the interpolation bound, and moments use the same paths.
        judge_z(values, name, independent=len(wavelengths), bound_added=True)


@NEEDS_JIT
def test_extinction_is_grain_attenuation_plus_pore_absorption():
    alpha = 200.0
    water = complex(1.33, alpha * 1500e-9 / (4.0 * math.pi))
    snow = splits.Snow(saturation=0.25, refractive_index={"ice": 1.31, "water": water})
    ds = single_scattering(snow, 1500.0, rays=RAYS, moments=2)
    grains = snow.make_grain_population().collision_coefficient
    assert float(ds.extinction[0]) == pytest.approx(grains + 0.25 * alpha, rel=1e-12)
    assert float(ds.optical_thickness[0]) == pytest.approx(float(ds.extinction[0]) * snow.depth_m)
    # Neither ice nor reflection absorbs, so all absorption occurs between grains.
    assert float(ds.single_scattering_albedo[0]) == pytest.approx(
        grains / (grains + 0.25 * alpha), rel=1e-12
    )
    equilibrium = single_scattering(snow, 1500.0, rays=RAYS, moments=2, wet_pores="equilibrium")
    fraction = 0.25 * 1.33**2 / (0.25 * 1.33**2 + 0.75)
    assert float(equilibrium.extinction[0]) == pytest.approx(grains + fraction * alpha, rel=1e-12)


@NEEDS_JIT
def test_equilibrium_between_pores_is_preserved():
    # By étendue the fraction is proportional to n² times the volume of a pore medium.  This is
    # exact only for smooth grains with projected entry, 0.37; uniform entry gives 0.40, facets
    # give 0.35.
    index = {"ice": 1.31, "water": 1.33}
    snow = splits.Snow(
        saturation=0.25,
        facetness=SPHERES["facetness"],
        interpretation=PROJECTED,
        refractive_index=index,
    )
    ds = single_scattering(snow, 1500.0, rays=RAYS, moments=2, wet_pores="equilibrium")
    fraction = 0.25 * 1.33**2 / (0.25 * 1.33**2 + 0.75)
    error = math.sqrt(fraction * (1.0 - fraction) / RAYS)
    judge_z([(float(ds.wet_fraction[0]) - fraction) / error], "wet fraction")


@NEEDS_JIT
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"moments": 0}, "moments = 0"),
        ({"rays": 1}, "rays = 1"),
        ({"seed": -1}, "seed = -1"),
        ({"threads": 0}, "threads = 0"),
        ({"wet_pores": "dry"}, "wet_pores = 'dry'"),
    ],
)
def test_invalid_settings_are_rejected_by_name(settings, message):
    with pytest.raises(ValueError, match=message):
        single_scattering(splits.Snow(), 500.0, **settings)


DRY_SPHERES = {"facetness": (0, 0, 0, 0), "sphericity": (1, 1, 1, 0), "saturation": 0.0}
N, K, SIZE = 1.3032, 4.1e-7, 500e-6


def compute_sphere_shape():
    """Return B and g of a sphere hit over its projected area, by summation of internal orders."""
    node, weight = np.polynomial.legendre.leggauss(4000)
    square, weight = 0.5 * (1.0 + node), 0.5 * weight
    out = np.sqrt(1.0 - square)
    inside = np.sqrt(1.0 - square / N**2)
    reflected = np.zeros_like(square)
    for one, two in ((out, N * inside), (N * out, inside)):
        reflected += 0.5 * ((one - two) / (one + two)) ** 2
    attenuation = np.exp(-4.0 * np.pi * K / 900e-9 * SIZE * inside)
    external_deviation = 2.0 * np.arccos(out)
    # External reflection deviates by π − 2θ.
    external = -np.cos(external_deviation)
    refraction_deviation = np.arccos(out) - np.arccos(inside)
    total, mean = reflected.copy(), reflected * external
    remaining, angle = (1.0 - reflected) * attenuation, 2.0 * refraction_deviation
    for _ in range(60):
        total += remaining * (1.0 - reflected)
        mean += remaining * (1.0 - reflected) * np.cos(angle)
        remaining *= reflected * attenuation
        angle += np.pi - 2.0 * np.arccos(inside)
    albedo = (weight * total).sum()
    b = (1.0 - albedo) * 1.5 / SIZE / (4.0 * np.pi * K / 900e-9)
    return b, (weight * mean).sum() / albedo


@NEEDS_JIT
def test_smooth_spheres_agree_with_theory():
    """B is 1.25 and g is 0.79 (Robledano et al. 2023, Fig 2)."""
    ice = {"ice": complex(N, K)}
    snow = splits.Snow(
        grain_size_um=(500, 500),
        interpretation={"entry_point": "projected"},
        refractive_index=ice,
        **DRY_SPHERES,
    )
    b, g = compute_sphere_shape()
    assert b == pytest.approx(1.25, abs=0.01)
    assert g == pytest.approx(0.79, abs=0.005)
    shape = compute_optical_shape(snow, rays=131_072)
    for estimate, exact in ((shape.absorption_enhancement, b), (shape.asymmetry_parameter, g)):
        assert abs(estimate.value - exact) < 3.0 * estimate.stderr, (estimate, exact)
        assert estimate.stderr < 0.005


def test_optical_shape_requires_clean_dry_absorbing_snow():
    with pytest.raises(ValueError, match=r"saturation = 0\.05"):
        compute_optical_shape(splits.Snow())
    with pytest.raises(ValueError, match="impurities_ng_g"):
        compute_optical_shape(splits.Snow(saturation=0.0, impurities_ng_g={"black_carbon": 1.0}))
    with pytest.raises(ValueError, match="where ice absorbs"):
        compute_optical_shape(splits.Snow(saturation=0.0, refractive_index={"ice": 1.31}))


@NEEDS_JIT
def test_errors_decrease_with_the_square_root_of_the_number_of_rays():
    few, many = (
        splits.single_scattering(splits.Snow(saturation=0.0), [1500.0], moments=2, rays=rays)
        for rays in (20_000, 320_000)
    )
    for name in ("single_scattering_albedo", "asymmetry_parameter"):
        ratio = few[f"{name}_stderr"].item() / many[f"{name}_stderr"].item()
        # Errors are estimated from batches, to about a tenth each.
        assert 2.6 < ratio < 6.0
