"""Optical shape of grains: spheres against theory, and media without a shape."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.analysis.theory.grain_shape import compute_optical_shape

SPHERES = {"facetness": (0, 0, 0, 0), "sphericity": (1, 1, 1, 0), "saturation": 0.0}
N, K, SIZE = 1.3032, 4.1e-7, 500e-6


def compute_sphere_shape():
    """Return B and g of a sphere hit over its projected area, by summation of internal orders."""
    node, weight = np.polynomial.legendre.leggauss(4000)
    square, weight = 0.5 * (1.0 + node), 0.5 * weight
    out = np.sqrt(1.0 - square)
    inside = np.sqrt(1.0 - square / N**2)
    reflected = np.zeros_like(square)
    for one, two in ((out, N * inside), (N * out, inside)):
        reflected += 0.5 * ((one - two) / (one + two)) ** 2
    attenuation = np.exp(-4.0 * np.pi * K / 900e-9 * SIZE * inside)
    external_deviation = 2.0 * np.arccos(out)
    # External reflection deviates by π − 2θ.
    external = -np.cos(external_deviation)
    refraction_deviation = np.arccos(out) - np.arccos(inside)
    total, mean = reflected.copy(), reflected * external
    remaining, angle = (1.0 - reflected) * attenuation, 2.0 * refraction_deviation
    for _ in range(60):
        total += remaining * (1.0 - reflected)
        mean += remaining * (1.0 - reflected) * np.cos(angle)
        remaining *= reflected * attenuation
        angle += np.pi - 2.0 * np.arccos(inside)
    albedo = (weight * total).sum()
    b = (1.0 - albedo) * 1.5 / SIZE / (4.0 * np.pi * K / 900e-9)
    return b, (weight * mean).sum() / albedo


@NEEDS_JIT
def test_smooth_spheres_agree_with_theory():
    """B is 1.25 and g is 0.79 (Robledano et al. 2023, Fig 2)."""
    ice = {"ice": complex(N, K)}
    snow = splits.Snow(
        grain_size_um=(500, 500),
        interpretation={"entry_point": "projected"},
        refractive_index=ice,
        **SPHERES,
    )
    b, g = compute_sphere_shape()
    assert b == pytest.approx(1.25, abs=0.01)
    assert g == pytest.approx(0.79, abs=0.005)
    shape = compute_optical_shape(snow, rays=131_072)
    for estimate, exact in ((shape.absorption_enhancement, b), (shape.asymmetry_parameter, g)):
        assert abs(estimate.value - exact) < 3.0 * estimate.stderr, (estimate, exact)
        assert estimate.stderr < 0.005


def test_optical_shape_requires_clean_dry_absorbing_snow():
    with pytest.raises(ValueError, match=r"saturation = 0\.05"):
        compute_optical_shape(splits.Snow())
    with pytest.raises(ValueError, match="impurities_ng_g"):
        compute_optical_shape(splits.Snow(saturation=0.0, impurities_ng_g={"black_carbon": 1.0}))
    with pytest.raises(ValueError, match="where ice absorbs"):
        compute_optical_shape(splits.Snow(saturation=0.0, refractive_index={"ice": 1.31}))
