"""Media with analytical results, and agreement of the estimators."""

import math
from dataclasses import replace

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_scatter, judge_z, start_random_stream
from scenes import make_optics, make_scene, trace_ray
from scipy import integrate

import splits
from splits.kernels.interface import fresnel
from splits.kernels.records import allocate_exits
from splits.kernels.scene import NO_GROUND, NO_MAX_ORDER, TRANSMITTED
from splits.kernels.tallies.exits import tally_weights
from splits.kernels.transport import history

pytestmark = NEEDS_JIT

DEPTH = 2.0
N = 1.4
WAVELENGTHS = np.array([400.0, 700.0, 1500.0])
# Optical thickness 1 at 700 nm.  Large grains in a deep sample keep k small, so that Fresnel
# reflection at grains, of order k², is far below the noise.
K = 700e-9 / (4.0 * math.pi * DEPTH)
PLATES = {
    "Table 1, a hundredfold": {},
    "rough needles": {"facetness": (0.8, 1.0, 0.9, 0.1), "sphericity": (0.3, 0.6, 0.4, 0.1)},
    "dense, projected": {"density_kg_m3": 600.0, "interpretation": {"entry_point": "projected"}},
    "any facet": {"facetness": (1.0, 1.0, 1.0, 0.0), "interpretation": {"facet_sampling": "any"}},
}
ANGLES = (0.0, 60.0, "diffuse")


def plate_spectrum(mu):
    """Return R and T of a plane-parallel plate of index N + iK, reflections added incoherently."""
    r, _, cos_t = fresnel(1.0, N, 0.0, mu)
    attenuation = np.exp(-4.0 * math.pi * K / (WAVELENGTHS * 1e-9) * DEPTH / cos_t)
    series = (1.0 - r) ** 2 * attenuation / (1.0 - (r * attenuation) ** 2)
    return np.concatenate([r + series * r * attenuation, series])


def plate_spectrum_under(incidence):
    if incidence != "diffuse":
        return plate_spectrum(math.cos(math.radians(incidence)))
    return integrate.quad_vec(lambda mu: 2.0 * mu * plate_spectrum(mu), 1e-9, 1.0)[0]


def concatenate_fluxes(ds, suffix=""):
    return np.concatenate([ds[f"reflectance{suffix}"].values, ds[f"transmittance{suffix}"].values])


@pytest.mark.parametrize("estimator", ["spectral", "analog"])
def test_index_matched_grains_give_a_homogeneous_plate(estimator):
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
        z.append(
            (concatenate_fluxes(ds) - plate_spectrum_under(incidence))
            / concatenate_fluxes(ds, "_stderr")
        )
    judge_z(z, f"plate, {estimator}", independent=len(z))


@pytest.mark.parametrize("entry", ["uniform", "projected"])
def test_opaque_grains_transmit_by_beer_lambert(entry):
    # Grains of index 1 do not reflect and absorb all light that enters them: Beer-Lambert law.
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
            result = history.trace_rays(seed + 10 * analog, work, scene, optics, exits, None)
            assert not result.lost
            moments, min_weights, _ = tally_weights(
                exits, result.crossings, absorption[np.newaxis], not analog, NO_GROUND
            )
            assert min_weights[0] == 0.0
            assert moments[0].max() < 1e-9
            expected = math.exp(-depth / mu / snow.mean_grain_distance_m)
            error = math.sqrt(expected * (1.0 - expected) / rays)
            z.append((moments[1, 0, 0] / rays - expected) / error)
    judge_z(z, f"opaque, {entry}")


@pytest.mark.parametrize(
    ("estimator", "depth_m"),
    [*(("spectral", d) for d in (0.001, 0.12, 2.0)), *(("analog", d) for d in (0.001, 0.12, 0.5))],
)
def test_energy_is_conserved_without_absorption(depth_m, estimator):
    # The analog estimator traces wavelengths separately, and all are equal here.
    light = [300.0, 2500.0] if estimator == "spectral" else [500.0]
    snow = splits.Snow(
        depth_m=depth_m, saturation=0.2, refractive_index={"ice": 1.31, "water": 1.33}
    )
    ds = splits.spectrophotometer(snow, light, 30.0, max_stderr=0.05, estimator=estimator)
    total = ds.reflectance + ds.transmittance
    assert np.abs(total - 1.0).max() < 1e-12
    assert np.abs(ds.absorptance).max() < 1e-12


@pytest.mark.parametrize("incidence", [0.0, 75.0, "diffuse"])
def test_very_sparse_grains_transmit_everything(incidence):
    snow = splits.Snow(density_kg_m3=1e-6, saturation=0.0)
    ds = splits.spectrophotometer(snow, [500.0, 2000.0], incidence, max_stderr=0.05)
    assert (ds.transmittance == 1.0).all()
    assert (ds.reflectance == 0.0).all()


@pytest.mark.parametrize("mu", [1.0, 0.5, 0.1])
def test_ray_without_collisions_is_straight(mu):
    snow = splits.Snow(density_kg_m3=1e-9, saturation=0.0)
    scene = make_scene(
        snow.make_grain_population(), 0.12, rules=snow.interpretation.to_sampling_rules(), cos=mu
    )
    ray, length = trace_ray(start_random_stream(), scene, make_optics([1.0, 1.0, 1.31]))
    position, d = ray.position, ray.direction
    sine = math.sqrt(1.0 - mu * mu)
    assert (ray.status, ray.weight, position.y, d.y) == (
        TRANSMITTED,
        1.0,
        0.0,
        0.0,
    )
    assert (d.x, d.z, position.z) == (pytest.approx(sine, rel=1e-15), -mu, -0.12)
    assert (ray.n_segments, ray.order) == (1, 0)
    assert position.x == pytest.approx(0.12 * sine / mu, rel=1e-14)
    assert length == pytest.approx([0.12 / mu, 0.0, 0.0], rel=1e-14)


def test_dry_snow_does_not_evaluate_water_index():
    class ForbiddenIndex:
        name = "forbidden"

        def __call__(self, _wavelength_nm):
            raise AssertionError("evaluated the index of water")

    snow = splits.Snow(saturation=0.0)
    snow.refractive_index["water"] = ForbiddenIndex()
    ds = splits.spectrophotometer(snow, [500.0, 1500.0], max_stderr=0.05)
    assert np.isfinite(ds.reflectance).all()
    wet = splits.Snow(saturation=0.01)
    wet.refractive_index["water"] = ForbiddenIndex()
    with pytest.raises(AssertionError, match="index of water"):
        splits.spectrophotometer(wet, 500.0, max_stderr=0.05)


def test_reflectance_falls_with_absorption_and_grain_size():
    def reflectance(k, size):
        snow = splits.Snow(
            grain_size_um=(size, size), saturation=0.0, refractive_index={"ice": 1.31 + k * 1j}
        )
        return float(splits.spectrophotometer(snow, 1000.0, max_stderr=0.01, seed=3).reflectance[0])

    assert reflectance(1e-7, 300.0) > reflectance(1e-6, 300.0) + 0.03
    assert reflectance(1e-6, 300.0) > reflectance(1e-5, 300.0) + 0.03
    assert reflectance(1e-6, 100.0) > reflectance(1e-6, 1000.0) + 0.03


MEDIA = {
    "Table 1": {},
    "thin and faceted": {
        "grain_size_um": (50.0, 100.0),
        "facetness": (0.6, 1.0, 0.8, 0.1),
        "depth_m": 0.02,
        "saturation": 0.0,
    },
    "wet": {"saturation": 0.3},
}
SPECTRUM = np.linspace(400.0, 2500.0, 12)
QUANTITIES = ("reflectance", "transmittance", "absorptance")


def stack_quantities(ds, suffix=""):
    return np.stack([ds[f"{quantity}{suffix}"].values for quantity in QUANTITIES])


PARTICLES = splits.ParticleLayer(optical_thickness=3.0, single_scattering_albedo=0.8)
WAVES = {"rms_height_m": 0.02, "wave_number_per_m": 20.0, "correlation": "gaussian", "waves": 24}
BELOW = [
    splits.Snow(depth_m=0.006, saturation=0.2),
    splits.Sand(depth_m=0.004, interpretation="splitsnow_2021"),
]
ESTIMATED = {
    **{name: (splits.Snow(**settings), SPECTRUM) for name, settings in MEDIA.items()},
    "sand": (splits.load_medium("tec_10039240"), WAVELENGTHS),
    "wet sand": (splits.load_medium("tec_13j9823", saturation=0.3), WAVELENGTHS),
    "particles": (PARTICLES, WAVELENGTHS),
    "particles on snow and sand": (
        splits.Stack([replace(PARTICLES, ground=None, depth_m=0.01), *BELOW], ground=0.3),
        WAVELENGTHS,
    ),
    "rough particles": (
        splits.Stack(
            [replace(PARTICLES, ground=None, depth_m=0.3, surface=WAVES), *BELOW], ground=0.3
        ),
        WAVELENGTHS,
    ),
}


def test_spectral_and_analog_estimators_agree():
    z = []
    for number, (medium, wavelengths) in enumerate(ESTIMATED.values()):
        # Both estimators number their random streams alike, so their seeds differ.
        analog, spectral = (
            splits.spectrophotometer(
                medium, wavelengths, 20.0, max_stderr=error, seed=seed + number, estimator=estimator
            )
            for estimator, seed, error in (("analog", 10, 0.009), ("spectral", 20, 0.006))
        )
        z.append(compare_results(analog, spectral, *QUANTITIES))
    judge_z(np.concatenate(z), "analog against spectral", independent=len(ESTIMATED))


@pytest.mark.parametrize("estimator", ["spectral", "analog"])
def test_results_are_independent_of_threads(estimator):
    def run(threads, seed=5):
        return splits.spectrophotometer(
            splits.Snow(saturation=0.1),
            [450.0, 1030.0, 1600.0],
            max_stderr=0.01,
            seed=seed,
            estimator=estimator,
            threads=threads,
        )

    one, two, repeated = run(1), run(2), run(2)
    for name in one.data_vars:
        assert (one[name].values == two[name].values).all()
        assert (two[name].values == repeated[name].values).all()
    assert one.attrs["rays"] == two.attrs["rays"]
    assert (one.reflectance != run(1, seed=6).reflectance).any()


@pytest.mark.parametrize("estimator", ["spectral", "analog"])
@pytest.mark.parametrize("medium", MEDIA)
def test_energy_is_conserved(medium, estimator):
    ds = splits.spectrophotometer(
        splits.Snow(**MEDIA[medium]), SPECTRUM, 45.0, max_stderr=0.03, estimator=estimator
    )
    assert np.abs(stack_quantities(ds).sum(axis=0) - 1.0).max() < 1e-12
    if estimator == "analog":
        # These are fractions of rays; weighted results may exceed 0 and 1 by noise of roulette.
        assert stack_quantities(ds).min() >= 0.0 and stack_quantities(ds).max() <= 1.0
    assert (stack_quantities(ds) > -4.0 * stack_quantities(ds, "_stderr")).all()
    assert stack_quantities(ds, "_stderr").max() <= 0.03


@pytest.mark.parametrize("medium", ["Table 1", "thin and faceted"])
def test_diffuse_light_is_the_mean_over_beams(medium):
    snow = splits.Snow(**MEDIA[medium])
    wavelengths = [500.0, 1030.0, 1400.0]
    diffuse = splits.spectrophotometer(snow, wavelengths, "diffuse", max_stderr=0.003, seed=31)
    # Isotropic radiance: 2 μ dμ = d(μ²), by Gauss-Legendre quadrature in μ².
    nodes, weights = np.polynomial.legendre.leggauss(8)
    mean, variance = 0.0, stack_quantities(diffuse, "_stderr") ** 2
    for number, (node, weight) in enumerate(zip(nodes, weights, strict=True)):
        angle = float(np.degrees(np.arccos(np.sqrt(0.5 * (1.0 + node)))))
        beam = splits.spectrophotometer(
            snow, wavelengths, angle, max_stderr=0.006, seed=40 + number
        )
        mean = mean + 0.5 * weight * stack_quantities(beam)
        variance = variance + (0.5 * weight * stack_quantities(beam, "_stderr")) ** 2
    z = (stack_quantities(diffuse) - mean) / np.sqrt(variance)
    judge_z(z, f"diffuse, {medium}", independent=1)
    assert np.abs(z).max() < 3.0


def test_stated_errors_agree_with_scatter():
    # The scatter of 40 independent runs around their mean, in units of stated errors.
    snow = splits.Snow(depth_m=0.01)
    runs = [
        splits.spectrophotometer(snow, [600.0, 1300.0], max_stderr=0.02, seed=seed)
        for seed in range(40)
    ]
    judge_scatter(
        *([stack_quantities(ds, end) for ds in runs] for end in ("", "_stderr")), "spectrum"
    )
