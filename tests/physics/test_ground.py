"""A Lambertian ground: geometric series, energy, both kernels, both estimators, spectra."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z
from scenes import make_medium_scene

import splits
from splits.kernels import vectorized
from splits.kernels.grains import history
from splits.kernels.grains.scene import Optics, make_bounding_optics
from splits.kernels.tallies.crossings import CROSSING_LENGTH, CROSSING_RAY, CROSSING_WEIGHT
from splits.kernels.tallies.exits import EXIT_LENGTH, EXIT_SIDE, EXIT_WEIGHT, allocate_exits
from splits.kernels.vectorized.eligibility import select_features
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
"""Samples, and the same as seen from below."""


def over(medium, ground):
    """Return a medium over a ground."""
    if isinstance(medium, splits.Stack):
        return splits.Stack(medium.layers, ground=ground, interpretation=medium.interpretation)
    settings = {name: getattr(medium, name) for name in ("depth_m", "saturation")}
    if isinstance(medium, splits.Sand):
        settings["partition"] = medium.partition
    return type(medium)(**settings, ground=ground)


def measured(medium, incidence, seed, **settings):
    ds = splits.spectrophotometer(medium, WAVELENGTHS, incidence, 0.002, seed, **settings)
    values = ds.reflectance.values, ds.transmittance.values
    return *values, ds.reflectance_stderr.values, ds.transmittance_stderr.values


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("kernel", ["vectorized", pytest.param("scalar", marks=pytest.mark.long)])
def test_light_goes_to_and_fro_between_sample_and_ground(name, kernel):
    """R(ρ) = R + T ρ T′/(1 − ρ R′), and the ground keeps (1 − ρ) T/(1 − ρ R′)."""
    medium, reverse = MEDIA[name]
    r, t, dr, dt = measured(medium, 40.0, 1)
    r2, t2, dr2, dt2 = measured(reverse, "diffuse", 2)
    z = []
    for seed, albedo in enumerate(ALBEDOS, start=3):
        found, kept, dfound, dkept = measured(over(medium, albedo), 40.0, seed, kernel=kernel)
        series = 1.0 / (1.0 - albedo * r2)
        expected = r + t * albedo * t2 * series
        # Of R and T, of the same rays, and of R′ and T′; with what the sums of both can be at most.
        parts = [
            dr, dt * albedo * t2 * series, dt2 * albedo * t * series,
            dr2 * t * t2 * (albedo * series) ** 2,
        ]  # fmt: skip
        error = np.hypot(dfound, np.hypot(parts[0] + parts[1], parts[2] + parts[3]))
        z.append((found - expected) / error)
        if albedo < 1.0:
            expected = (1.0 - albedo) * t * series
            parts = [dt * (1.0 - albedo) * series, dr2 * expected * albedo * series]
            z.append((kept - expected) / np.hypot(dkept, np.hypot(*parts)))
        else:
            assert not kept.any()
    judge_z(np.concatenate(z), name, independent=len(ALBEDOS), bound_added=True)


def test_nothing_absorbed_over_a_white_ground_comes_back_whole():
    clear = {"ice": 1.31, "water": 1.33}
    for medium in (
        splits.Snow(depth_m=0.005, refractive_index=clear, ground=1.0),
        splits.Stack([splits.Snow(depth_m=0.002, refractive_index=clear)] * 2, ground=1.0),
    ):
        for incidence in (0.0, 80.0, "diffuse"):
            for kernel in ("vectorized", "scalar"):
                ds = splits.spectrophotometer(medium, 500.0, incidence, 0.02, kernel=kernel)
                assert abs(float(ds.reflectance[0]) - 1.0) < 1e-12
                assert abs(float(ds.absorptance[0])) < 1e-12
                assert float(ds.transmittance[0]) == 0.0


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_what_leaves_and_what_the_ground_keeps_is_all_where_nothing_else_absorbs(kernel):
    """Ray by ray, by the lengths in their exits and notes, in double precision."""
    snow = splits.Snow(
        depth_m=0.005, saturation=0.3, refractive_index={"ice": 1.31, "water": 1.33}, ground=0.6
    )
    scene = make_medium_scene(snow, 30.0)
    index, absorption = compute_optical_constants(snow, np.array([500.0]))
    # Roulette is told of no absorption, so that no ray plays it, and each balances by itself.
    optics = make_bounding_optics(index[0], np.zeros_like(absorption))
    exits = allocate_exits(512, index.shape[1])
    work = np.array([[7, 0, len(exits), 2**31 - 1]])
    if kernel == "vectorized":
        alone = Optics(*(part[np.newaxis] for part in optics))
        told = vectorized.trace_batch(1, work, scene, alone, exits, select_features(scene, optics))
    else:
        told = history.trace_batch(1, work[0], scene, optics, exits, None, None)
    kept = np.zeros(len(exits))
    weights = told.crossings[:, CROSSING_WEIGHT] * np.exp(
        -told.crossings[:, CROSSING_LENGTH:] @ absorption[0]
    )
    np.add.at(kept, told.crossings[:, CROSSING_RAY].astype(int), (1.0 - 0.6) * weights)
    left = exits[:, EXIT_SIDE] == 0.0
    assert not (exits[:, EXIT_SIDE] == 1.0).any() and len(told.crossings) > len(exits) / 4
    back = exits[left, EXIT_WEIGHT] * np.exp(-exits[left, EXIT_LENGTH:] @ absorption[0])
    assert left.sum() > 400 and (back < 0.5).any()
    np.testing.assert_allclose(kept[left] + back, 1.0, rtol=0.0, atol=1e-12)


def test_coin_tosses_and_weights_agree_over_a_ground():
    z = []
    for number, name in enumerate(MEDIA):
        medium = over(MEDIA[name][0], 0.4)
        one = splits.spectrophotometer(medium, WAVELENGTHS, 20.0, 0.003, 20 + number)
        other = splits.spectrophotometer(
            medium, WAVELENGTHS, 20.0, 0.003, 20 + number, estimator="analog"
        )
        for quantity in ("reflectance", "transmittance", "absorptance"):
            error = np.hypot(one[f"{quantity}_stderr"], other[f"{quantity}_stderr"])
            z.append(((one[quantity] - other[quantity]) / error).values)
    judge_z(np.concatenate(z), independent=len(MEDIA), bound_added=True)


def test_a_spectrum_of_albedos_is_as_good_as_each_by_itself():
    """One ensemble serves black, grey and white at once."""
    albedo = {"wavelength_nm": WAVELENGTHS, "albedo": [1.0, 0.0, 0.3]}
    ds = splits.spectrophotometer(over(WET, albedo), WAVELENGTHS, 10.0, 0.002, 5)
    z = []
    for row, (w, value) in enumerate(zip(WAVELENGTHS, albedo["albedo"], strict=True)):
        alone = splits.spectrophotometer(over(WET, value), w, 10.0, 0.002, 6 + row)
        for quantity in ("reflectance", "transmittance"):
            error = np.hypot(ds[f"{quantity}_stderr"][row], alone[f"{quantity}_stderr"][0])
            if float(error) > 0.0 and value < 1.0:
                z.append(float(ds[quantity][row] - alone[quantity][0]) / float(error))
    judge_z(np.array(z), independent=len(WAVELENGTHS), bound_added=True)


def test_the_brdf_over_a_ground_holds_its_light():
    thin = over(WET, 0.8)
    brdf = splits.goniophotometer(thin, [500.0, 900.0], 40.0, relative_stderr=0.05, seed=2)
    flux = splits.spectrophotometer(thin, [500.0, 900.0], 40.0, 0.001, seed=3)
    error = np.hypot(brdf.reflectance_stderr, flux.reflectance_stderr)
    judge_z(((brdf.reflectance - flux.reflectance) / error).values, bound_added=True)
