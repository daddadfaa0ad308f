"""Sparse layered snow over a ground against discrete ordinates with the same single scattering."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.analysis.theory.discrete_ordinates import solve_discrete_ordinates

pytest.importorskip("PythonicDISORT")
pytestmark = [NEEDS_JIT, pytest.mark.long]

WAVELENGTHS = np.geomspace(500.0, 1800.0, 12)
# One refractive index, hence one node without interpolation; absorption from weak to strong.
ICE = {"wavelength_nm": [400.0, 2000.0], "n": [1.31, 1.31], "k": [1e-8, 3e-4]}
FINE, MEDIUM, COARSE = (30.0, 60.0), (100.0, 300.0), (500.0, 1500.0)
SMOOTH, ROUGH = (0.0, 0.0, 0.0, 0.0), (0.5, 0.9, 0.7, 0.1)
SOIL = {"wavelength_nm": [400.0, 2000.0], "albedo": [0.05, 0.6]}
SNOWPACKS = {
    "two layers": ([(1.0, FINE, ROUGH), (3.0, COARSE, SMOOTH)], 0.3),
    "coarse above fine": ([(2.0, COARSE, ROUGH), (1.0, FINE, SMOOTH), (4.0, MEDIUM, ROUGH)], SOIL),
    "thin over white": ([(0.2, MEDIUM, SMOOTH), (0.3, FINE, ROUGH), (0.2, COARSE, ROUGH)], 1.0),
}


def make_sparse_snow(thickness, size, facetness):
    """Return dry snow of an optical thickness, with sparse grains of which none is rejected."""
    common = {
        "grain_size_um": size, "facetness": facetness, "saturation": 0.0, "density_kg_m3": 1e-3,
        "interpretation": {
            "overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep",
        },
        "refractive_index": {"ice": ICE},
    }  # fmt: skip
    deep = splits.Snow(**common, depth_m=1e4)
    return splits.Snow(**common, depth_m=thickness * deep.mean_grain_distance_m)


def test_snowpacks_agree_with_discrete_ordinates():
    z = []
    for number, (layers, ground) in enumerate(SNOWPACKS.values()):
        media = [make_sparse_snow(*layer) for layer in layers]
        snowpack = splits.Stack(media, ground=ground)
        optics = [
            splits.single_scattering(medium, WAVELENGTHS, rays=400_000, seed=10 * number + i)
            for i, medium in enumerate(media)
        ]
        for incidence in (20.0, 60.0):
            expected = solve_discrete_ordinates(optics, incidence, ground=ground)
            spectrum = splits.spectrophotometer(
                snowpack, WAVELENGTHS, incidence, 0.001, 100 + 10 * number + round(incidence)
            )
            for name in ("reflectance", "absorptance"):
                error = np.hypot(expected[f"{name}_stderr"], spectrum[f"{name}_stderr"])
                z.append(((spectrum[name] - expected[name]) / error).values)
    # The twelve wavelengths use the same paths.
    judge_z(np.array(z), independent=len(SNOWPACKS) * 2, bound_added=True)
