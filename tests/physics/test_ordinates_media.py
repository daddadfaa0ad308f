"""Discrete ordinates for sand and for snow of other grains than natural snow, against paths."""

from __future__ import annotations

import re

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.discrete_ordinates.applicability import compute_packing_error
from splits.instruments.solver import choose_solver

WAVELENGTHS = [500.0, 800.0, 1030.0, 1300.0, 1900.0]
POINTS = "radiative_transfer"
FINITE = {
    "set": "geometric", "overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep",
}  # fmt: skip
MIN_VALUE = 5.0
"""Smallest value that is compared, in units of the requested error of paths."""
SOLVED = {"solver": "discrete_ordinates"}


def draw_log(generator: np.random.Generator, low: float, high: float) -> float:
    """Return a number with a uniform logarithm."""
    return float(np.exp(generator.uniform(np.log(low), np.log(high))))


def make_random_snow(generator: np.random.Generator, wet: bool, **settings) -> splits.Snow:
    """Return snow of other grains than natural ones."""
    largest, facetness = draw_log(generator, 100.0, 3000.0), float(generator.uniform(0.1, 0.9))
    sphericity = float(generator.uniform(0.65, 0.9))
    return splits.Snow(
        grain_size_um=(largest / float(generator.uniform(1.0, 4.0)), largest),
        facetness=(facetness - 0.1, facetness + 0.1, facetness, 0.05),
        sphericity=(sphericity - 0.1, sphericity + 0.1, sphericity, 0.05),
        density_kg_m3=float(generator.uniform(50.0, 550.0)),
        depth_m=draw_log(generator, 0.005, 1.0),
        saturation=float(generator.uniform(0.02, 0.5)) * wet,
        impurities_ng_g={"black_carbon": float(generator.uniform(0.0, 500.0))},
        **settings,
    )


def make_random_sand(generator: np.random.Generator, wet: bool, **settings) -> splits.Sand:
    """Return sand of pure, mixed and coated grains."""
    silt = float(generator.uniform(0.0, 0.15))
    partition = generator.dirichlet([1.0, 1.0, 1.0])
    return splits.Sand(
        iron_oxide=draw_log(generator, 1e-4, 0.03),
        hematite_ratio=float(generator.uniform()),
        magnetite=float(generator.uniform(0.0, 0.01)),
        partition=tuple((partition / partition.sum()).tolist()),
        texture=(0.0, silt, 1.0 - silt),
        porosity=float(generator.uniform(0.4, 0.9)),
        roundness=(float(generator.uniform(0.2, 0.8)), 0.07),
        depth_m=draw_log(generator, 0.005, 1.0),
        saturation=float(generator.uniform(0.02, 0.5)) * wet,
        **settings,
    )


def make_random_medium(seed: int, wet: bool, interpretation) -> tuple[splits.Medium, float | str]:
    """Return snow (odd seeds) or sand, and an incidence."""
    generator = np.random.default_rng(seed)
    make = make_random_snow if seed % 2 else make_random_sand
    ground = float(generator.uniform(0.0, 0.8)) if generator.uniform() < 0.5 else None
    medium = make(generator, wet, interpretation=interpretation, ground=ground)
    incidence = "diffuse" if seed % 5 == 0 else float(generator.uniform(0.0, 80.0))
    return medium, incidence


def compare_media(seeds, error: float, wet=lambda seed: False, interpretation=POINTS) -> np.ndarray:
    """Return differences from paths over their errors, shape (media, 2, wavelengths)."""
    z = []
    for seed in seeds:
        medium, incidence = make_random_medium(seed, wet(seed), interpretation)
        solved = splits.spectrophotometer(medium, WAVELENGTHS, incidence, 2.0 * error, **SOLVED)
        paths = splits.spectrophotometer(medium, WAVELENGTHS, incidence, error, seed)
        for name in ("reflectance", "transmittance"):
            stderr = np.hypot(solved[f"{name}_stderr"], paths[f"{name}_stderr"]).values
            difference = (solved[name] - paths[name]).values
            is_small = solved[name].values < MIN_VALUE * error
            assert (np.abs(difference) < MIN_VALUE * error).all(), (seed, difference)
            z.append(np.where(is_small, 0.0, difference / stderr))
    return np.array(z).reshape(len(seeds), 2, -1)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_random_media_agree_with_paths():
    z = compare_media(range(6), 0.004, wet=lambda seed: seed >= 4)
    judge_z(z, independent=6, bound_added=True)
