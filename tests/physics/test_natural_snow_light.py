"""Light from natural snow: its grains' optical shape, the law of small absorption, and its BRDF."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.analysis.directions import principal_plane
from splits.analysis.grain_shape import optical_shape
from splits.materials import ice_density
from splits.media.natural_snow import SHAPE

B, G = (1.68, 0.02), (0.65, 0.03)
"""Mean and standard deviation of 33 samples at 900 nm (Robledano et al. 2023)."""


def snow(area=20.0, **settings):
    """Return natural snow."""
    return splits.Snow.natural(specific_surface_area_m2_kg=area, **settings)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("area", [5.0, 20.0, 60.0])
def test_grains_have_the_shape_of_natural_snow(area):
    shape = optical_shape(snow(area), rays=131_072)
    for found, measured, kept, error in (
        (shape.enhancement, B, SHAPE.enhancement, SHAPE.enhancement_stderr),
        (shape.asymmetry, G, SHAPE.asymmetry, SHAPE.asymmetry_stderr),
    ):
        assert abs(found.value - measured[0]) < measured[1] + 3.0 * found.stderr
        # A coarse grain absorbs a little of what it is met by, which is beyond "little".
        assert abs(found.value - kept) < 3.0 * math.hypot(found.stderr, error) + 0.003


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("area", [5.0, 20.0, 60.0])
def test_deep_snow_follows_the_law_of_small_absorption(area):
    """Diffuse albedo exp(-4 √(2Bγ/(3 ρ SSA (1 - g)))), g with diffraction (Kokhanovsky & Zege)."""
    wavelengths = np.array([700.0, 800.0, 900.0])
    deep = snow(area)
    k = deep.refractive_index["ice"](wavelengths).imag
    gamma = 4.0 * np.pi * k / (wavelengths * 1e-9)
    diffracted = 0.5 * (1.0 + SHAPE.asymmetry)
    absorbed = 2.0 * SHAPE.enhancement * gamma / (ice_density(-1.0) * area)
    expected = np.exp(-4.0 * np.sqrt(absorbed / (3.0 * (1.0 - diffracted))))
    found = splits.spectrophotometer(deep, wavelengths, "diffuse", 0.0015)
    away = found.reflectance.values - expected
    assert (np.abs(away) < 3.0 * found.reflectance_stderr.values + 0.004).all(), away


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.parametrize("wavelength", [600.0, 1000.0])
def test_snow_is_brighter_forwards(wavelength):
    found = splits.goniophotometer(
        snow(depth_m=0.05), [wavelength], 60.0, relative_stderr=0.015, azimuth_deg=[0.0, 180.0],
        polar_deg=[0.0, 45.0, 60.0, 75.0],
    )  # fmt: skip
    plane = principal_plane(found).isel(wavelength=0)
    for angle in (45.0, 60.0, 75.0):
        ahead, back = plane.sel(angle=angle), plane.sel(angle=-angle)
        gap = float(ahead.brdf - back.brdf)
        assert gap > 3.0 * math.hypot(float(ahead.brdf_stderr), float(back.brdf_stderr)), angle


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
def test_packed_natural_snow_is_reciprocal():
    pairs = ((0, 40, 0), (20, 70, 0), (20, 70, 180), (45, 75, 90), (60, 30, 180), (10, 80, 45))
    angles = sorted({angle for pair in pairs for angle in pair[:2]})
    runs = {
        angle: splits.goniophotometer(
            snow(depth_m=0.05), [1000.0], angle, seed=angle, relative_stderr=0.015,
            polar_deg=angles, azimuth_deg=sorted({float(pair[2]) for pair in pairs}),
        ).isel(wavelength=0)
        for angle in angles
    }  # fmt: skip
    z = []
    for one, other, azimuth in pairs:
        there = runs[one].sel(polar=other, azimuth=azimuth)
        back = runs[other].sel(polar=one, azimuth=azimuth)
        error = math.hypot(float(there.brdf_stderr), float(back.brdf_stderr))
        z.append(float(there.brdf - back.brdf) / error)
    judge_z(z, "reciprocity", bound_added=True)
