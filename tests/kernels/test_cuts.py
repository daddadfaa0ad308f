"""Stacks of grain layers: invariance under division into layers, and energy conservation."""

from dataclasses import replace

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z

import splits

pytestmark = NEEDS_JIT

DRY = splits.Snow(saturation=0.0, depth_m=0.02)
WET = splits.Snow(saturation=0.3, depth_m=0.02)
SAND = splits.Sand(
    hematite_ratio=0.5, magnetite=0.05, saturation=0.3, texture=(0.0, 0.1, 0.9), depth_m=0.01
)
MEDIA = {"dry": (DRY, (500.0, 900.0)), "wet": (WET, (500.0, 900.0)), "sand": (SAND, (600.0, 900.0))}


def divide(medium, n_layers):
    """Return a stack of `n_layers` unequal layers, the thinnest thinner than a grain."""
    weights = np.geomspace(1.0, 40.0, n_layers)
    return splits.Stack(
        [replace(medium, depth_m=medium.depth_m * s / weights.sum()) for s in weights]
    )


def compute_z(one, other, quantities=("reflectance", "transmittance")):
    """Return significant differences of two results in units of their standard errors."""
    z = []
    for name in quantities:
        error = np.hypot(one[f"{name}_stderr"], other[f"{name}_stderr"])
        significant = np.maximum(one[name], other[name]) > 10.0 * error
        z.extend(((one[name] - other[name]) / error).values[significant.values])
    return z


@pytest.mark.parametrize("name", MEDIA)
def test_divided_medium_has_spectrum_of_the_whole(name):
    medium, wavelengths = MEDIA[name]
    whole = splits.spectrophotometer(medium, wavelengths, 30.0, max_stderr=0.004, seed=1)
    z = []
    for n_layers in (2, 3, 7):
        stack = divide(medium, n_layers)
        divided = splits.spectrophotometer(
            stack, wavelengths, 30.0, max_stderr=0.008, seed=n_layers
        )
        z += compute_z(divided, whole)
    judge_z(z, f"divisions of {name}", independent=2)


@pytest.mark.long
def test_divided_medium_has_brdf_of_the_whole():
    angles = {"polar_deg": [0.0, 25.0, 50.0, 75.0], "azimuth_deg": [0.0, 90.0, 180.0]}
    z = []
    for number, (medium, wavelengths) in enumerate(MEDIA.values()):
        whole, *divided = (
            splits.goniophotometer(
                one, wavelengths[1:], 40.0, relative_stderr=0.03, seed=10 * number + seed, **angles
            )
            for seed, one in enumerate((medium, divide(medium, 2), divide(medium, 7)))
        )
        for result in divided:
            z.append(compare_results(result, whole, "brdf"))
    # Errors of an expansion are correlated, and include its truncation error.
    judge_z(np.array(z), "BRDFs of divided media", independent=2 * len(MEDIA), bound_added=True)


def test_energy_is_conserved_for_either_order_of_layers():
    weakly_absorbing = splits.Snow(depth_m=0.05)
    absorbing = splits.Sand(depth_m=0.05, interpretation="splitsnow_2021")
    settings = {"wavelength_nm": [600.0], "max_stderr": 0.01}
    snow_on_sand = splits.spectrophotometer(splits.Stack([weakly_absorbing, absorbing]), **settings)
    sand_on_snow = splits.spectrophotometer(splits.Stack([absorbing, weakly_absorbing]), **settings)
    for ds in (snow_on_sand, sand_on_snow):
        total = ds.reflectance + ds.transmittance + ds.absorptance
        assert total.values == pytest.approx(1.0, abs=1e-12)
    assert snow_on_sand.reflectance.item() > sand_on_snow.reflectance.item() + 0.2


def test_absorptance_is_zero_without_absorption():
    clear = {"refractive_index": {"ice": 1.31, "water": 1.33}}
    stack = splits.Stack(
        [
            splits.Snow(saturation=0.4, depth_m=0.004, **clear),
            splits.Snow(saturation=0.0, depth_m=1e-6, **clear),
            splits.Snow(saturation=0.9, depth_m=0.003, **clear),
        ]
    )
    ds = splits.spectrophotometer(stack, [600.0], 60.0, max_stderr=0.01)
    assert ds.absorptance.values == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("angle", [0.0, 89.9])
def test_extreme_stacks_give_finite_fluxes(angle):
    thin = [splits.Snow(depth_m=1e-7, saturation=s) for s in (0.0, 0.5, 1.0)]
    coarse = splits.Snow(grain_size_um=(5000, 5100), depth_m=0.001)
    fine = splits.Snow(grain_size_um=(50, 51), depth_m=0.01)
    stack = splits.Stack([*thin, coarse, fine, *thin])
    ds = splits.spectrophotometer(stack, [900.0], angle, max_stderr=0.02)
    values = [ds[name].item() for name in ("reflectance", "transmittance", "absorptance")]
    assert np.isfinite(values).all() and min(values) >= 0.0
