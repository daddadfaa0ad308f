"""Stacks at their limits: vanishing layers, grains larger than layers, contrasts, many layers."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z

import splits

WAVELENGTHS = [500.0, 1300.0]
OLD = {"saturation": 0.05, "depth_m": 0.01}
COARSE = {"grain_size_um": (800, 1000), "saturation": 0.05}
TINY = {"grain_size_um": (10, 20), "saturation": 0.0, "depth_m": 0.0005}
HUGE = {"grain_size_um": (1000, 2000), "saturation": 0.0, "depth_m": 0.02}


def measured(medium, incidence=30.0, seed=1, **settings):
    ds = splits.spectrophotometer(medium, WAVELENGTHS, incidence, 0.004, seed, **settings)
    names = ("reflectance", "transmittance", "absorptance")
    values = np.stack([ds[name].values for name in names])
    assert np.isfinite(values).all() and ds.reflectance.values.max() <= 1.0
    return values, np.stack([ds[f"{name}_stderr"].values for name in names])


def apart(one, other):
    """Return the differences of two measurements in units of their errors."""
    return (one[0] - other[0]) / np.hypot(one[1], other[1])


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_a_layer_of_no_thickness_changes_nothing(kernel):
    film = splits.Snow(**{**TINY, "depth_m": 1e-8})
    with_film = splits.Stack([splits.Snow(**OLD), film, splits.Snow(**OLD)])
    without = splits.Snow(**{**OLD, "depth_m": 0.02})
    one, other = measured(with_film, seed=1, kernel=kernel), measured(without, seed=2)
    judge_z(apart(one, other), independent=1, bound_added=True)


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_grains_may_be_larger_than_their_layer(kernel):
    pieces = [splits.Snow(**COARSE, depth_m=depth) for depth in (1e-4, 2e-4, 3e-3, 5e-5, 1.65e-3)]
    whole = splits.Snow(**COARSE, depth_m=5e-3)
    one = measured(splits.Stack(pieces), seed=3, kernel=kernel)
    judge_z(apart(one, measured(whole, seed=4)), independent=1, bound_added=True)


def test_fifty_layers_of_one_snow_are_that_snow():
    pieces = [splits.Snow(saturation=0.05, depth_m=0.0004)] * 50
    whole = splits.Snow(saturation=0.05, depth_m=0.02)
    one, other = measured(splits.Stack(pieces), seed=5), measured(whole, seed=6)
    judge_z(apart(one, other), independent=1, bound_added=True)


@pytest.mark.parametrize("order", [(TINY, HUGE), (HUGE, TINY)])
def test_kernels_agree_on_grains_a_hundred_times_larger(order):
    stack = splits.Stack([splits.Snow(**settings) for settings in order], ground=0.5)
    lanes, scalar = (
        measured(stack, 50.0, seed, kernel=kernel)
        for seed, kernel in ((7, "vectorized"), (8, "scalar"))
    )
    judge_z(apart(lanes, scalar), independent=1, bound_added=True)


def test_kernels_agree_on_grazing_light():
    stack = splits.Stack([splits.Snow(**TINY), splits.Snow(**OLD)], ground=0.9)
    lanes, scalar = (
        measured(stack, 89.9, seed, kernel=kernel)
        for seed, kernel in ((9, "vectorized"), (10, "scalar"))
    )
    judge_z(apart(lanes, scalar), independent=1, bound_added=True)
