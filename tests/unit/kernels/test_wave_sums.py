"""Sums of waves: heights, slopes, and bounds on them."""

import math

import numpy as np
import pytest
from chi2 import scale_sample_size
from mpmath import mp
from rough_surfaces import SURFACES, draw_realization, sum_waves

from splits.kernels.arithmetic import Vector
from splits.kernels.rough_surface import intersection, realization
from splits.kernels.rough_surface.realization import (
    AMPLITUDE,
    BAND_END,
    KX,
    KY,
    N_WAVE_LANES,
    PHASE,
)
from splits.media.rough_surface import RoughSurface


@pytest.mark.parametrize("name", SURFACES)
def test_heights_and_slopes_match_wave_sums(name):
    waves = draw_realization(SURFACES[name]).waves
    assert waves.shape[1] % N_WAVE_LANES == 0
    assert (waves[AMPLITUDE] > 0.0).sum() == sum(
        f.waves for f in RoughSurface(SURFACES[name]).fields
    )
    x, y = np.random.default_rng(1).uniform(-30.0, 30.0, (2, 200))
    height, (slope_x, slope_y) = realization.compute_heights_and_slopes(waves, x, y)
    scale = waves[AMPLITUDE].sum()
    np.testing.assert_allclose(height, sum_waves(waves, x, y), atol=1e-13 * scale)
    step = 1e-5 / (2.0 * np.pi * np.hypot(waves[KX], waves[KY]).max())
    for slope, dx, dy in ((slope_x, step, 0.0), (slope_y, 0.0, step)):
        rise = sum_waves(waves, x + dx, y + dy) - sum_waves(waves, x - dx, y - dy)
        np.testing.assert_allclose(slope, rise / (2.0 * step), atol=1e-10 * scale / step)
    assert realization.compute_height_and_slope(waves, x[0], y[0]) == (
        height[0],
        (slope_x[0], slope_y[0]),
    )


def test_arguments_up_to_a_million_are_reduced_exactly():
    # One wave of amplitude 1 along x: the argument is 2πx, which needs exact argument reduction.
    waves = np.zeros((4, N_WAVE_LANES))
    waves[AMPLITUDE, 0] = waves[KX, 0] = 1.0
    generator = np.random.default_rng(2)
    x = np.concatenate([
        np.linspace(-1.5, 1.5, 601), generator.uniform(-1.0, 1.0, 2000) * 1e6 / (2.0 * np.pi)
    ])  # fmt: skip
    height, (slope, across) = realization.compute_heights_and_slopes(waves, x, np.zeros_like(x))
    with mp.workdps(30):
        half_turns = [2 * mp.mpf(float(v)) for v in x]
        cosine = np.array([float(mp.cospi(v)) for v in half_turns])
        sine = np.array([float(mp.sinpi(v)) for v in half_turns])
    print(f"errors {abs(height - cosine).max():.1e}, {abs(slope / -2 / np.pi - sine).max():.1e}")
    np.testing.assert_allclose(height, cosine, atol=4e-15)
    np.testing.assert_allclose(slope, -2.0 * np.pi * sine, atol=3e-14)
    assert (across == 0.0).all()


@pytest.mark.parametrize("name", SURFACES)
def test_bounds_hold_along_rays(name):
    for index in range(3):
        surface = draw_realization(SURFACES[name], index)
        waves, bands, n_bands = surface.waves, surface.bands, surface.n_bands
        # Bands are ordered from coarse to fine, and the first one contains all waves.
        k = np.hypot(waves[KX], waves[KY])
        ends = bands[BAND_END, :n_bands]
        assert ends[0] == waves.shape[1] and (np.diff(ends) < 0).all()
        for azimuth in np.linspace(0.0, 3.0, 4):
            dx, dy = 0.8 * math.cos(azimuth), 0.8 * math.sin(azimuth)
            intersection.set_ray_bounds(surface, Vector(dx, dy, 0.6))
            s = np.linspace(0.0, 200.0, scale_sample_size(4000))
            t = (
                2.0
                * np.pi
                * (np.multiply.outer(waves[KX] * dx + waves[KY] * dy, s) - waves[PHASE][:, None])
            )
            q = 2.0 * np.pi * (waves[KX] * dx + waves[KY] * dy)
            a = waves[AMPLITUDE]
            for band in range(n_bands):
                end, rest, slope, curvature = bands[:, band]
                end = int(end)
                assert (k[:end].max() < k[end:].max(initial=np.inf)) or end == waves.shape[1]
                assert np.abs(a[end:] @ np.cos(t[end:])).max(initial=0.0) <= rest
                assert np.abs((a * q)[:end] @ np.sin(t[:end])).max() <= slope
                assert np.abs((a * q * q)[:end] @ np.cos(t[:end])).max() <= curvature
                assert slope <= surface.max_slope * 0.8 * (1.0 + 1e-12)
        assert np.abs(sum_waves(waves, s, 0.3 * s)).max() <= surface.max_height


@pytest.mark.parametrize("curvature", [0.0, 1e-3, 1.0, 30.0])
@pytest.mark.parametrize("rate", [-0.9, -1e-6, 0.0, 1e-6, 0.9])
def test_safe_steps_stay_above_the_bounds(rate, curvature):
    slope, climb = 1.2, 0.1
    for gap in (1e-12, 1e-3, 1.0, 50.0):
        step = intersection.compute_safe_step(gap, rate, slope, curvature, climb)
        # The smallest possible gap along the ray, by either bound.
        s = np.linspace(0.0, min(step, 1e6), 101)
        parabolic = gap + rate * s - 0.5 * curvature * s * s
        linear = gap - (slope - climb) * s
        assert (np.maximum(parabolic, linear) >= -1e-12 * gap).all()
        assert step >= gap / (slope - climb)
    assert intersection.compute_safe_step(1.0, rate, 0.1, curvature, 0.2) == math.inf


def test_realizations_are_determined_by_the_seed():
    surface = RoughSurface(SURFACES["two scales"])
    waves = surface.sample_realization(3, 5)
    np.testing.assert_array_equal(waves, surface.sample_realization(3, 5))
    assert not np.array_equal(waves, surface.sample_realization(3, 6))
    assert not np.array_equal(waves, surface.sample_realization(4, 5))
    with pytest.raises(ValueError, match="seed = -1: must be a whole number"):
        surface.sample_realization(-1)
