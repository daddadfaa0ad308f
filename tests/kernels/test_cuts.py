"""Stacks of grains: cuts that change nothing, laws that hold for any layers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits

pytestmark = NEEDS_JIT

DRY = splits.Snow(saturation=0.0, depth_m=0.02)
WET = splits.Snow(saturation=0.3, depth_m=0.02)
SAND = splits.Sand(
    hematite_ratio=0.5, magnetite=0.05, saturation=0.3, texture=(0.0, 0.1, 0.9), depth_m=0.01
)
MEDIA = {"dry": (DRY, (500.0, 900.0)), "wet": (WET, (500.0, 900.0)), "sand": (SAND, (600.0, 900.0))}


def cut(medium, pieces):
    """Return a medium in so many unequal pieces, the thinnest below the size of a grain."""
    shares = np.geomspace(1.0, 40.0, pieces)
    return splits.Stack(
        [replace(medium, depth_m=medium.depth_m * s / shares.sum()) for s in shares]
    )


def differences(one, other, quantities=("reflectance", "transmittance")):
    """Return the differences of two results in units of their errors, where there is light."""
    found = []
    for name in quantities:
        error = np.hypot(one[f"{name}_stderr"], other[f"{name}_stderr"])
        seen = np.maximum(one[name], other[name]) > 10.0 * error
        found.extend(((one[name] - other[name]) / error).values[seen.values])
    return found


@pytest.mark.parametrize("name", MEDIA)
def test_a_cut_medium_answers_as_the_whole(name):
    medium, wavelengths = MEDIA[name]
    whole = splits.spectrophotometer(medium, wavelengths, 30.0, max_stderr=0.004, seed=1)
    z = []
    for pieces in (2, 3, 7):
        stack = cut(medium, pieces)
        parts = splits.spectrophotometer(stack, wavelengths, 30.0, max_stderr=0.008, seed=pieces)
        z += differences(parts, whole)
    judge_z(z, f"cuts through {name}", independent=2)


@pytest.mark.long
def test_a_cut_medium_has_the_brdf_of_the_whole():
    angles = {"polar_deg": [0.0, 25.0, 50.0, 75.0], "azimuth_deg": [0.0, 90.0, 180.0]}
    z = []
    for number, (medium, wavelengths) in enumerate(MEDIA.values()):
        whole, *parts = (
            splits.goniophotometer(
                one, wavelengths[1:], 40.0, relative_stderr=0.03, seed=10 * number + seed, **angles
            )
            for seed, one in enumerate((medium, cut(medium, 2), cut(medium, 7)))
        )
        for part in parts:
            error = np.hypot(part.brdf_stderr, whole.brdf_stderr)
            z.append(((part.brdf - whole.brdf) / error).values.ravel())
    # Errors of an expansion go together, and hold what it leaves out.
    judge_z(np.array(z), "BRDFs of cuts", independent=2 * len(MEDIA), bound_added=True)


def test_energy_closes_and_order_matters():
    bright = splits.Snow(depth_m=0.05)
    dark = splits.Sand(depth_m=0.05, interpretation="splitsnow_2021")
    light = {"wavelength_nm": [600.0], "max_stderr": 0.01}
    snow_on_sand = splits.spectrophotometer(splits.Stack([bright, dark]), **light)
    sand_on_snow = splits.spectrophotometer(splits.Stack([dark, bright]), **light)
    for ds in (snow_on_sand, sand_on_snow):
        total = ds.reflectance + ds.transmittance + ds.absorptance
        assert total.values == pytest.approx(1.0, abs=1e-12)
    assert snow_on_sand.reflectance.item() > sand_on_snow.reflectance.item() + 0.2


def test_a_stack_without_absorption_loses_nothing():
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
def test_hard_stacks_end(angle):
    thin = [splits.Snow(depth_m=1e-7, saturation=s) for s in (0.0, 0.5, 1.0)]
    coarse = splits.Snow(grain_size_um=(5000, 5100), depth_m=0.001)
    fine = splits.Snow(grain_size_um=(50, 51), depth_m=0.01)
    stack = splits.Stack([*thin, coarse, fine, *thin])
    ds = splits.spectrophotometer(stack, [900.0], angle, max_stderr=0.02)
    values = [ds[name].item() for name in ("reflectance", "transmittance", "absorptance")]
    assert np.isfinite(values).all() and min(values) >= 0.0
