"""Spectral against analog estimator, reproducibility, energy, diffuse light, stated errors."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_scatter, judge_z

import splits

pytestmark = NEEDS_JIT

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
WAVELENGTHS = np.linspace(400.0, 2500.0, 12)
QUANTITIES = ("reflectance", "transmittance", "absorptance")


def stack_quantities(ds, suffix=""):
    return np.stack([ds[f"{quantity}{suffix}"].values for quantity in QUANTITIES])


def test_spectral_and_analog_estimators_agree():
    z = []
    for number, settings in enumerate(MEDIA.values()):
        snow = splits.Snow(**settings)
        # Both estimators number their random streams alike, so their seeds differ.
        analog = splits.spectrophotometer(
            snow, WAVELENGTHS, 20.0, max_stderr=0.009, seed=10 + number, estimator="analog"
        )
        spectral = splits.spectrophotometer(
            snow, WAVELENGTHS, 20.0, max_stderr=0.006, seed=20 + number
        )
        error = np.hypot(stack_quantities(analog, "_stderr"), stack_quantities(spectral, "_stderr"))
        z.append((stack_quantities(analog) - stack_quantities(spectral)) / error)
    judge_z(z, "analog against spectral", independent=len(MEDIA))


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
        splits.Snow(**MEDIA[medium]), WAVELENGTHS, 45.0, max_stderr=0.03, estimator=estimator
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
