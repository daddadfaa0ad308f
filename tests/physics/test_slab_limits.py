"""Media whose answer is known: a plain plate, opaque grains, no grains, no absorption."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z, start_random_stream
from scenes import make_optics, make_scene, trace_ray
from scipy import integrate

import splits
from splits.kernels.grains import history
from splits.kernels.grains.scene import NO_GROUND, NO_MAX_ORDER
from splits.kernels.optics.fresnel import fresnel
from splits.kernels.tallies.exits import allocate_exits, tally_weights

pytestmark = NEEDS_JIT

DEPTH = 2.0
N = 1.4
WAVELENGTHS = np.array([400.0, 700.0, 1500.0])
# Optical thickness 1 at 700 nm.  Large grains in a deep sample keep k small, so that Fresnel's
# reflection at the grains, of order k², is far below the noise.
K = 700e-9 / (4.0 * math.pi * DEPTH)
PLATES = {
    "Table 1, a hundredfold": {},
    "rough needles": {"facetness": (0.8, 1.0, 0.9, 0.1), "sphericity": (0.3, 0.6, 0.4, 0.1)},
    "dense, projected": {"density_kg_m3": 600.0, "interpretation": {"entry_point": "projected"}},
    "any facet": {"facetness": (1.0, 1.0, 1.0, 0.0), "interpretation": {"facet_sampling": "any"}},
}
ANGLES = (0.0, 60.0, "diffuse")


def plate(mu):
    """Return R and T of a plane plate of index N + iK with incoherent multiple reflections."""
    r, _, cos_t = fresnel(1.0, N, 0.0, mu)
    passed = np.exp(-4.0 * math.pi * K / (WAVELENGTHS * 1e-9) * DEPTH / cos_t)
    series = (1.0 - r) ** 2 * passed / (1.0 - (r * passed) ** 2)
    return np.concatenate([r + series * r * passed, series])


def plate_under(incidence):
    if incidence != "diffuse":
        return plate(math.cos(math.radians(incidence)))
    return integrate.quad_vec(lambda mu: 2.0 * mu * plate(mu), 1e-9, 1.0)[0]


def both_sides(ds, what=""):
    return np.concatenate([ds[f"reflectance{what}"].values, ds[f"transmittance{what}"].values])


@pytest.mark.parametrize("estimator", ["spectral", "analog"])
def test_grains_in_pores_of_their_own_index_are_invisible(estimator):
    z = []
    for seed, (incidence, settings) in enumerate(
        (angle, settings) for angle in ANGLES for settings in PLATES.values()
    ):
        snow = splits.Snow(
            **{"grain_size_um": (3e4, 7.5e4), "depth_m": DEPTH, "saturation": 1.0, **settings},
            refractive_index={"ice": complex(N, K), "water": complex(N, K)},
        )
        ds = splits.spectrophotometer(
            snow, WAVELENGTHS, incidence, max_stderr=0.006, seed=100 + seed, estimator=estimator
        )
        z.append((both_sides(ds) - plate_under(incidence)) / both_sides(ds, "_stderr"))
    judge_z(z, f"plate, {estimator}", independent=len(z))


@pytest.mark.parametrize("entry", ["uniform", "projected"])
def test_opaque_grains_leave_the_unscattered_beam(entry):
    # Grains of index 1 do not reflect and nothing that enters one leaves it: Beer and Lambert.
    interpretation = {"entry_point": entry, "overlap_with_boundary": "keep"}
    snow = splits.Snow(saturation=0.0, interpretation=interpretation)
    absorption = np.array([0.0, 0.0, 1e15])
    optics = make_optics(np.ones(3), absorption=absorption)
    seed, rays = (51, 52)[entry == "uniform"], 100_000
    z = []
    for ensemble, (mu, depth) in enumerate(((1.0, 3e-4), (1.0, 2e-3), (0.5, 1e-3))):
        for analog in (False, True):
            exits = allocate_exits(rays, 3)
            scene = make_scene(
                snow.make_grain_population(),
                depth,
                0.0,
                snow.interpretation.to_sampling_rules(analog),
                mu,
            )
            work = np.array([ensemble, 0, rays, NO_MAX_ORDER])
            told = history.trace_batch(seed + 10 * analog, work, scene, optics, exits, None, None)
            assert not told.lost
            moments, least, _ = tally_weights(
                exits, told.crossings, absorption[np.newaxis], not analog, NO_GROUND
            )
            assert least[0] == 0.0
            assert moments[0].max() < 1e-9
            expected = math.exp(-depth / mu / snow.mean_grain_distance_m)
            error = math.sqrt(expected * (1.0 - expected) / rays)
            z.append((moments[1, 0, 0] / rays - expected) / error)
    judge_z(z, f"opaque, {entry}")


@pytest.mark.parametrize(
    ("estimator", "depth_m"),
    [*(("spectral", d) for d in (0.001, 0.12, 2.0)), *(("analog", d) for d in (0.001, 0.12, 0.5))],
)
def test_nothing_is_lost_without_absorption(depth_m, estimator):
    # Coin tosses trace every wavelength by itself, and all are the same here.
    light = [300.0, 2500.0] if estimator == "spectral" else [500.0]
    snow = splits.Snow(
        depth_m=depth_m, saturation=0.2, refractive_index={"ice": 1.31, "water": 1.33}
    )
    ds = splits.spectrophotometer(snow, light, 30.0, max_stderr=0.05, estimator=estimator)
    total = ds.reflectance + ds.transmittance
    assert np.abs(total - 1.0).max() < 1e-12
    assert np.abs(ds.absorptance).max() < 1e-12


@pytest.mark.parametrize("incidence", [0.0, 75.0, "diffuse"])
def test_hardly_any_grains_let_everything_through(incidence):
    snow = splits.Snow(density_kg_m3=1e-6, saturation=0.0)
    ds = splits.spectrophotometer(snow, [500.0, 2000.0], incidence, max_stderr=0.05)
    assert (ds.transmittance == 1.0).all()
    assert (ds.reflectance == 0.0).all()


@pytest.mark.parametrize("mu", [1.0, 0.5, 0.1])
def test_a_ray_that_meets_no_grain_goes_straight(mu):
    snow = splits.Snow(density_kg_m3=1e-9, saturation=0.0)
    scene = make_scene(
        snow.make_grain_population(), 0.12, rules=snow.interpretation.to_sampling_rules(), cos=mu
    )
    ray, length = trace_ray(start_random_stream(), scene, make_optics([1.0, 1.0, 1.31]))
    place, d = ray.geometry.position, ray.payload.direction
    sine = math.sqrt(1.0 - mu * mu)
    assert (ray.status, ray.payload.roulette.weight, place.y, d.y) == (
        history.TRANSMITTED,
        1.0,
        0.0,
        0.0,
    )
    assert (d.x, d.z, place.z) == (pytest.approx(sine, rel=1e-15), -mu, -0.12)
    assert (ray.n_segments, ray.order) == (1, 0)
    assert place.x == pytest.approx(0.12 * sine / mu, rel=1e-14)
    assert length == pytest.approx([0.12 / mu, 0.0, 0.0], rel=1e-14)


def test_dry_snow_never_asks_for_water():
    class Refuse:
        name = "refuses"

        def __call__(self, _wavelength_nm):
            raise AssertionError("asked for the index of water")

    snow = splits.Snow(saturation=0.0)
    snow.refractive_index["water"] = Refuse()
    ds = splits.spectrophotometer(snow, [500.0, 1500.0], max_stderr=0.05)
    assert np.isfinite(ds.reflectance).all()
    wet = splits.Snow(saturation=0.01)
    wet.refractive_index["water"] = Refuse()
    with pytest.raises(AssertionError, match="index of water"):
        splits.spectrophotometer(wet, 500.0, max_stderr=0.05)


def test_more_absorption_or_larger_grains_darken_snow():
    def reflectance(k, size):
        snow = splits.Snow(
            grain_size_um=(size, size), saturation=0.0, refractive_index={"ice": 1.31 + k * 1j}
        )
        return float(splits.spectrophotometer(snow, 1000.0, max_stderr=0.01, seed=3).reflectance[0])

    assert reflectance(1e-7, 300.0) > reflectance(1e-6, 300.0) + 0.03
    assert reflectance(1e-6, 300.0) > reflectance(1e-5, 300.0) + 0.03
    assert reflectance(1e-6, 100.0) > reflectance(1e-6, 1000.0) + 0.03
