"""Transmittance of deep media by splitting, against Beer's law and plain Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_z_bound, judge_z
from scipy import stats

import splits

pytestmark = [NEEDS_JIT, pytest.mark.long]


def test_grains_without_contrast_follow_beers_law():
    # Grains have the index and absorption of the pores, so paths are straight: exp(−α d).
    index = 1.0 + 2e-6j
    for alpha_d, depth in ((4.0, 0.1273), (20.0, 0.6366)):
        snow = splits.Snow(
            saturation=1.0,
            depth_m=depth,
            refractive_index={"ice": index, "water": index},
        )
        ds = splits.deep_transmittance(snow, [800.0], relative_stderr=0.01, seed=3)
        exact = np.exp(-4.0 * np.pi * 2e-6 / 800e-9 * depth)
        assert exact == pytest.approx(np.exp(-alpha_d), rel=1e-2)
        value, error = float(ds.transmittance[0]), float(ds.transmittance_stderr[0])
        print(f"Beer's law: {value / exact - 1.0:.1e} off, stated {error / exact:.1e}")
        assert abs(value - exact) <= max(compute_z_bound(1) * error, 1e-12 * exact)
        assert ds.attrs["stop_reason"] == "converged"


def test_splitting_agrees_with_plain_monte_carlo():
    z = []
    wavelengths = [500.0, 800.0]
    for number, depth in enumerate((0.03, 0.06)):
        snow = splits.Snow(depth_m=depth)
        deep = splits.deep_transmittance(snow, wavelengths, relative_stderr=0.05, seed=number)
        assert (deep.transmittance_stderr <= 0.05 * deep.transmittance).all()
        plain = splits.spectrophotometer(snow, wavelengths, max_stderr=0.0025, seed=50 + number)
        error = np.hypot(deep.transmittance_stderr, plain.transmittance_stderr)
        z.extend(((deep.transmittance - plain.transmittance) / error).values)
    judge_z(z, "splitting against plain Monte Carlo", independent=2)


@pytest.mark.parametrize("error", [0.2, pytest.param(0.1, marks=pytest.mark.long)])
def test_stated_errors_agree_with_scatter(error):
    snow = splits.Snow(depth_m=0.06, saturation=0.0)
    runs = [
        splits.deep_transmittance(snow, [950.0], relative_stderr=error, seed=seed)
        for seed in range(20)
    ]
    values = np.array([float(ds.transmittance[0]) for ds in runs])
    # A run that misses rare histories with large progeny states too small an error together with
    # too small a value, so the mean of the stated variances is tested.
    stated = np.sqrt(np.mean([float(ds.transmittance_stderr[0]) ** 2 for ds in runs]))
    # Each value is part of the mean that it is compared with.
    z = (values - values.mean()) / stated / np.sqrt(1.0 - 1.0 / len(runs))
    judge_z(z, "deep transmittance between seeds")
    square = float(np.sum((values - values.mean()) ** 2) / stated**2)
    assert 0.005 < stats.chi2.sf(square, len(runs) - 1) < 0.995


def test_results_are_independent_of_threads():
    snow = splits.Snow(depth_m=0.05)
    one, two = (
        splits.deep_transmittance(snow, [900.0], relative_stderr=0.3, threads=threads)
        for threads in (1, 2)
    )
    assert one.transmittance.values == two.transmittance.values
    assert one.transmittance_stderr.values == two.transmittance_stderr.values


@pytest.mark.parametrize(
    ("key", "value"),
    [("relative_stderr", 0.0), ("seed", -1), ("max_rays", 0), ("threads", 0)],
)
def test_invalid_values_are_rejected(key, value):
    with pytest.raises(ValueError, match=key):
        splits.deep_transmittance(splits.Snow(), [900.0], **{key: value})
