"""Reflection of natural snow: optical shape of grains, weak absorption, density, and BRDF."""

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z

import splits
from splits.analysis.directions import select_principal_plane
from splits.analysis.theory.grain_shape import compute_optical_shape
from splits.analysis.theory.spectra import correct_dense_packing, solve_discrete_ordinates
from splits.materials import ice_density
from splits.media.snow import NATURAL_GRAIN_SHAPE

B, G = (1.68, 0.02), (0.65, 0.03)
"""Mean and standard deviation of 33 samples at 900 nm (Robledano et al. 2023)."""

DENSITIES = (10.0, 100.0, 300.0, 550.0)
"""kg/m³"""


def make_weak_absorber(index, absorption):
    """Return a material of an index and an absorption coefficient (1/m) at 1000 nm."""
    k = absorption * 1e-6 / (4.0 * np.pi)
    return {"wavelength_nm": [900.0, 1100.0], "n": [index, index], "k": [k, k]}


def make_snow(area=20.0, **settings):
    """Return natural snow."""
    return splits.Snow.natural(specific_surface_area_m2_kg=area, **settings)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("area", [5.0, 20.0, 60.0])
def test_grains_have_the_optical_shape_of_natural_snow(area):
    shape = compute_optical_shape(make_snow(area), rays=131_072)
    for estimate, measurement, stored, error in (
        (
            shape.absorption_enhancement,
            B,
            NATURAL_GRAIN_SHAPE.absorption_enhancement,
            NATURAL_GRAIN_SHAPE.absorption_enhancement_stderr,
        ),
        (
            shape.asymmetry_parameter,
            G,
            NATURAL_GRAIN_SHAPE.asymmetry_parameter,
            NATURAL_GRAIN_SHAPE.asymmetry_parameter_stderr,
        ),
    ):
        assert abs(estimate.value - measurement[0]) < measurement[1] + 3.0 * estimate.stderr
        # Absorption by a coarse grain slightly exceeds the limit of weak absorption.
        assert abs(estimate.value - stored) < 3.0 * math.hypot(estimate.stderr, error) + 0.003


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("area", [5.0, 20.0, 60.0])
def test_deep_snow_follows_the_weak_absorption_limit(area):
    """The diffuse albedo is exp(-4 √(2Bγ/(3 ρ SSA (1 - g)))) after Kokhanovsky and Zege.

    The asymmetry parameter g includes diffraction.
    """
    wavelengths = np.array([700.0, 800.0, 900.0])
    deep = make_snow(area)
    k = deep.refractive_index["ice"](wavelengths).imag
    gamma = 4.0 * np.pi * k / (wavelengths * 1e-9)
    diffracted = 0.5 * (1.0 + NATURAL_GRAIN_SHAPE.asymmetry_parameter)
    absorbed = 2.0 * NATURAL_GRAIN_SHAPE.absorption_enhancement * gamma / (ice_density(-1.0) * area)
    expected = np.exp(-4.0 * np.sqrt(absorbed / (3.0 * (1.0 - diffracted))))
    spectrum = splits.spectrophotometer(
        deep, wavelengths, "diffuse", max_stderr=0.0015, solver="monte_carlo"
    )
    difference = spectrum.reflectance.values - expected
    assert (np.abs(difference) < 3.0 * spectrum.reflectance_stderr.values + 0.004).all(), difference


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("wavelength", [600.0, 1000.0])
def test_brdf_is_larger_in_forward_directions(wavelength):
    brdf = splits.goniophotometer(
        make_snow(depth_m=0.05), [wavelength], 60.0, relative_stderr=0.015,
        azimuth_deg=[0.0, 180.0], polar_deg=[0.0, 45.0, 60.0, 75.0], solver="monte_carlo",
    )  # fmt: skip
    plane = select_principal_plane(brdf).isel(wavelength=0)
    for angle in (45.0, 60.0, 75.0):
        forward, backward = plane.sel(angle=angle), plane.sel(angle=-angle)
        assert compare_results(forward, backward, "brdf") > 3.0, angle


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("incidence", [0.0, 60.0, 75.0, 80.0, "diffuse"])
def test_semi_infinite_albedo_is_independent_of_density(incidence):
    """All lengths scale with the distance between grains, and no boundary below sets a scale."""
    spectra = [
        splits.spectrophotometer(
            make_snow(density_kg_m3=density),
            [1300.0],
            incidence,
            max_stderr=0.002,
            solver="monte_carlo",
        )
        for density in DENSITIES
    ]
    assert np.ptp([one.reflectance.item() for one in spectra]) < 2e-4


@NEEDS_JIT
@pytest.mark.slow
def test_dense_snow_agrees_with_discrete_ordinates():
    """Semi-infinite and finite layers of two densities agree, with the optics of their grains."""
    z = []
    wavelengths = [600.0, 1030.0, 1300.0]
    for number, (density, depth, ground) in enumerate(
        ((550.0, 1.0, None), (550.0, 0.02, 0.5), (100.0, 0.05, None))
    ):
        layer = make_snow(density_kg_m3=density, depth_m=depth, ground=ground)
        optics = correct_dense_packing(
            splits.single_scattering(layer, wavelengths, rays=200_000, seed=number + 3)
        )
        for incidence in (75.0, "diffuse"):
            expected = solve_discrete_ordinates(optics, incidence, ground=ground)
            spectrum = splits.spectrophotometer(
                layer, wavelengths, incidence, max_stderr=0.002, seed=number, solver="monte_carlo"
            )
            for name in ("reflectance", "transmittance"):
                error = np.hypot(expected[f"{name}_stderr"], spectrum[f"{name}_stderr"])
                z.append(((spectrum[name] - expected[name]) / np.maximum(error, 1e-5)).values)
    judge_z(np.array(z), independent=6, bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("density", [100.0, 550.0])
def test_mean_path_in_ice_of_dense_snow(density):
    """Straight paths follow the ice mass; the mean path in a white slab follows its theorem."""
    alpha, depth, rays = 0.03, 0.02, 200_000

    def absorbed_path(index, light, scale=1.0, air=1.0):
        tables = {
            "ice": make_weak_absorber(index, scale * alpha),
            "air": make_weak_absorber(1.0, air * scale * alpha),
        }
        layer = make_snow(density_kg_m3=density, depth_m=depth, refractive_index=tables)
        run = splits.spectrophotometer(
            layer, [1000.0], light, max_stderr=1e-6, max_rays=rays, solver="monte_carlo"
        )
        return run.absorptance.item() / alpha, run.absorptance_stderr.item() / alpha

    fraction = make_snow(density_kg_m3=density).ice_fraction
    ice, error = absorbed_path(1.0, 0.0, air=0.0)
    assert abs(ice - fraction * depth) < 3.0 * error + 1e-3 * fraction * depth
    # <L> α − <L²> α²/2 at α and at 2α, from the same paths.
    (once, error), (twice, _) = absorbed_path(1.31, "diffuse"), absorbed_path(1.31, "diffuse", 2.0)
    path = 2.0 * once - 0.5 * twice
    optics = splits.single_scattering(
        make_snow(
            density_kg_m3=density, depth_m=depth,
            refractive_index={"ice": make_weak_absorber(1.31, alpha)},
        ),
        [1000.0], moments=1, rays=400_000,
    ).isel(wavelength=0)  # fmt: skip
    per_path = make_snow().attenuation_per_m / alpha
    enhancement = per_path * (1.0 - optics.single_scattering_albedo.item())
    enhancement_error = per_path * optics.single_scattering_albedo_stderr.item()
    expected = 2.0 * depth * (1.0 - fraction + enhancement * fraction)
    assert (
        abs(path - expected)
        < 3.0 * math.hypot(error, 2.0 * depth * fraction * enhancement_error) + 1e-3 * expected
    )


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("density", [300.0, 550.0])
def test_packed_natural_snow_is_reciprocal(density):
    pairs = ((0, 40, 0), (20, 70, 0), (20, 70, 180), (45, 75, 90), (60, 30, 180), (10, 80, 45))
    angles = sorted({angle for pair in pairs for angle in pair[:2]})
    runs = {
        angle: splits.goniophotometer(
            make_snow(depth_m=0.05, density_kg_m3=density), [1000.0], angle, seed=angle,
            relative_stderr=0.015, polar_deg=angles,
            azimuth_deg=sorted({float(pair[2]) for pair in pairs}), solver="monte_carlo",
        ).isel(wavelength=0)
        for angle in angles
    }  # fmt: skip
    z = []
    for one, other, azimuth in pairs:
        forward = runs[one].sel(polar_deg=other, azimuth_deg=azimuth)
        reverse = runs[other].sel(polar_deg=one, azimuth_deg=azimuth)
        z.append(compare_results(forward, reverse, "brdf"))
    judge_z(z, "reciprocity", bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("density", [50.0, 550.0])
def test_actinic_flux_of_white_snow_equals_mean_path(density):
    """The mean actinic flux of a white slab under diffuse light is its mean path over its depth."""
    white = {"ice": 1.31, "water": 1.33}
    layer = make_snow(density_kg_m3=density, depth_m=0.02, refractive_index=white)
    halves = splits.irradiance_profile(
        layer,
        [1000.0],
        "diffuse",
        depth_m=[0.01],
        max_stderr=0.01,
        solver="monte_carlo",
    ).isel(wavelength=0)
    flux, stderr = halves.actinic_flux.mean().item(), halves.actinic_flux_stderr.mean().item()
    optics = splits.single_scattering(
        make_snow(
            density_kg_m3=density, depth_m=0.02,
            refractive_index={"ice": make_weak_absorber(1.31, 0.03)},
        ),
        [1000.0], moments=1, rays=400_000,
    ).isel(wavelength=0)  # fmt: skip
    enhancement = layer.attenuation_per_m / 0.03 * (1.0 - optics.single_scattering_albedo.item())
    expected = 2.0 * (1.0 - layer.ice_fraction + enhancement * layer.ice_fraction)
    assert abs(flux - expected) < 3.0 * math.hypot(stderr, 0.005)
