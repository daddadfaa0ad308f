"""Stacks at their limits: vanishing layers, grains larger than layers, contrasts, many layers."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import judge_z

import splits

WAVELENGTHS = [500.0, 1300.0]
WET = {"saturation": 0.05, "depth_m": 0.01}
COARSE = {"grain_size_um": (800, 1000), "saturation": 0.05}
TINY = {"grain_size_um": (10, 20), "saturation": 0.0, "depth_m": 0.0005}
HUGE = {"grain_size_um": (1000, 2000), "saturation": 0.0, "depth_m": 0.02}


def measure(medium, incidence=30.0, seed=1, **settings):
    ds = splits.spectrophotometer(medium, WAVELENGTHS, incidence, 0.004, seed, **settings)
    names = ("reflectance", "transmittance", "absorptance")
    values = np.stack([ds[name].values for name in names])
    assert np.isfinite(values).all() and ds.reflectance.values.max() <= 1.0
    return values, np.stack([ds[f"{name}_stderr"].values for name in names])


def compute_z(one, other):
    """Return the differences of two measurements in units of their standard errors."""
    return (one[0] - other[0]) / np.hypot(one[1], other[1])


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_vanishing_layer_has_no_effect(kernel):
    film = splits.Snow(**{**TINY, "depth_m": 1e-8})
    with_film = splits.Stack([splits.Snow(**WET), film, splits.Snow(**WET)])
    without = splits.Snow(**{**WET, "depth_m": 0.02})
    one, other = measure(with_film, seed=1, kernel=kernel), measure(without, seed=2)
    judge_z(compute_z(one, other), independent=1, bound_added=True)


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
def test_grains_may_be_larger_than_sublayers(kernel):
    sublayers = [
        splits.Snow(**COARSE, depth_m=depth) for depth in (1e-4, 2e-4, 3e-3, 5e-5, 1.65e-3)
    ]
    single_layer = splits.Snow(**COARSE, depth_m=5e-3)
    one = measure(splits.Stack(sublayers), seed=3, kernel=kernel)
    judge_z(compute_z(one, measure(single_layer, seed=4)), independent=1, bound_added=True)


def test_fifty_equal_layers_equal_one_layer():
    sublayers = [splits.Snow(saturation=0.05, depth_m=0.0004)] * 50
    single_layer = splits.Snow(saturation=0.05, depth_m=0.02)
    one, other = measure(splits.Stack(sublayers), seed=5), measure(single_layer, seed=6)
    judge_z(compute_z(one, other), independent=1, bound_added=True)


@pytest.mark.parametrize("order", [(TINY, HUGE), (HUGE, TINY)])
def test_kernels_agree_on_size_ratios_of_a_hundred(order):
    stack = splits.Stack([splits.Snow(**settings) for settings in order], ground=0.5)
    vector, scalar = (
        measure(stack, 50.0, seed, kernel=kernel)
        for seed, kernel in ((7, "vectorized"), (8, "scalar"))
    )
    judge_z(compute_z(vector, scalar), independent=1, bound_added=True)


def test_kernels_agree_at_grazing_incidence():
    stack = splits.Stack([splits.Snow(**TINY), splits.Snow(**WET)], ground=0.9)
    vector, scalar = (
        measure(stack, 89.9, seed, kernel=kernel)
        for seed, kernel in ((9, "vectorized"), (10, "scalar"))
    )
    judge_z(compute_z(vector, scalar), independent=1, bound_added=True)
