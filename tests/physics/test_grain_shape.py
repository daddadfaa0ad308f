"""The optical shape of grains: spheres as theory has them, and what it is not defined for."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.analysis.theory.grain_shape import compute_optical_shape

SPHERES = {"facetness": (0, 0, 0, 0), "sphericity": (1, 1, 1, 0), "saturation": 0.0}
N, K, SIZE = 1.3032, 4.1e-7, 500e-6


def sphere_by_quadrature():
    """Return B and g of a sphere, rays by projected area: chords between internal reflections."""
    node, weight = np.polynomial.legendre.leggauss(4000)
    square, weight = 0.5 * (1.0 + node), 0.5 * weight
    out = np.sqrt(1.0 - square)
    inside = np.sqrt(1.0 - square / N**2)
    reflected = np.zeros_like(square)
    for one, two in ((out, N * inside), (N * out, inside)):
        reflected += 0.5 * ((one - two) / (one + two)) ** 2
    passes = np.exp(-4.0 * np.pi * K / 900e-9 * SIZE * inside)
    turn_out = 2.0 * np.arccos(out)
    # Reflected at once: by π − 2θ from straight on.
    external = -np.cos(turn_out)
    through = np.arccos(out) - np.arccos(inside)
    total, mean = reflected.copy(), reflected * external
    left, angle = (1.0 - reflected) * passes, 2.0 * through
    for _ in range(60):
        total += left * (1.0 - reflected)
        mean += left * (1.0 - reflected) * np.cos(angle)
        left *= reflected * passes
        angle += np.pi - 2.0 * np.arccos(inside)
    albedo = (weight * total).sum()
    b = (1.0 - albedo) * 1.5 / SIZE / (4.0 * np.pi * K / 900e-9)
    return b, (weight * mean).sum() / albedo


@NEEDS_JIT
def test_smooth_spheres_are_those_of_theory():
    """B 1.25 and g 0.79 (Robledano et al. 2023, Fig 2)."""
    ice = {"ice": complex(N, K)}
    snow = splits.Snow(
        grain_size_um=(500, 500),
        interpretation={"entry_point": "projected"},
        refractive_index=ice,
        **SPHERES,
    )
    b, g = sphere_by_quadrature()
    assert b == pytest.approx(1.25, abs=0.01)
    assert g == pytest.approx(0.79, abs=0.005)
    shape = compute_optical_shape(snow, rays=131_072)
    for found, exact in ((shape.absorption_enhancement, b), (shape.asymmetry_parameter, g)):
        assert abs(found.value - exact) < 3.0 * found.stderr, (found, exact)
        assert found.stderr < 0.005


def test_only_clean_dry_snow_that_absorbs_has_a_shape():
    with pytest.raises(ValueError, match=r"saturation = 0\.05"):
        compute_optical_shape(splits.Snow())
    with pytest.raises(ValueError, match="impurities_ng_g"):
        compute_optical_shape(splits.Snow(saturation=0.0, impurities_ng_g={"black_carbon": 1.0}))
    with pytest.raises(ValueError, match="where ice absorbs"):
        compute_optical_shape(splits.Snow(saturation=0.0, refractive_index={"ice": 1.31}))
