"""A Lambertian ground: geometric series, energy, both kernels, both estimators, spectra."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z
from scenes import make_medium_scene

import splits
from splits.kernels import vectorized
from splits.kernels.scene import Optics, make_bounding_optics
from splits.kernels.tallies.exits import (
    CROSSING_LENGTH,
    CROSSING_RAY,
    CROSSING_WEIGHT,
    EXIT_LENGTH,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)
from splits.kernels.transport import history
from splits.kernels.vectorized.trace import select_features
from splits.simulation.scene import compute_optical_constants

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
    ds = splits.spectrophotometer(medium, WAVELENGTHS, incidence, 0.002, seed, **settings)
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
                ds = splits.spectrophotometer(medium, 500.0, incidence, 0.02, kernel=kernel)
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
    for number, name in enumerate(MEDIA):
        medium = place_over(MEDIA[name][0], 0.4)
        one = splits.spectrophotometer(medium, WAVELENGTHS, 20.0, 0.003, 20 + number)
        other = splits.spectrophotometer(
            medium, WAVELENGTHS, 20.0, 0.003, 20 + number, estimator="analog"
        )
        for quantity in ("reflectance", "transmittance", "absorptance"):
            error = np.hypot(one[f"{quantity}_stderr"], other[f"{quantity}_stderr"])
            z.append(((one[quantity] - other[quantity]) / error).values)
    judge_z(np.concatenate(z), independent=len(MEDIA), bound_added=True)


def test_spectral_ground_albedo_agrees_with_single_albedos():
    """One ensemble serves black, grey and white grounds."""
    albedo = {"wavelength_nm": WAVELENGTHS, "albedo": [1.0, 0.0, 0.3]}
    ds = splits.spectrophotometer(place_over(WET, albedo), WAVELENGTHS, 10.0, 0.002, 5)
    z = []
    for row, (w, value) in enumerate(zip(WAVELENGTHS, albedo["albedo"], strict=True)):
        single = splits.spectrophotometer(place_over(WET, value), w, 10.0, 0.002, 6 + row)
        for quantity in ("reflectance", "transmittance"):
            error = np.hypot(ds[f"{quantity}_stderr"][row], single[f"{quantity}_stderr"][0])
            if float(error) > 0.0 and value < 1.0:
                z.append(float(ds[quantity][row] - single[quantity][0]) / float(error))
    judge_z(np.array(z), independent=len(WAVELENGTHS), bound_added=True)


def test_brdf_over_a_ground_integrates_to_reflectance():
    thin = place_over(WET, 0.8)
    brdf = splits.goniophotometer(thin, [500.0, 900.0], 40.0, relative_stderr=0.05, seed=2)
    flux = splits.spectrophotometer(thin, [500.0, 900.0], 40.0, 0.001, seed=3)
    error = np.hypot(brdf.reflectance_stderr, flux.reflectance_stderr)
    judge_z(((brdf.reflectance - flux.reflectance) / error).values, bound_added=True)
