"""Spectra of natural snow by discrete ordinates against paths: dry, wet, dirty and layered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.discrete_ordinates.grain_tabulation import TableAxes, tabulate_grains
from splits.discrete_ordinates.grains import Axis
from splits.discrete_ordinates.granular_stack import load_natural_grains
from splits.simulation.grain_optics import GRAIN_RAYS_PER_CHUNK
from splits.simulation.run_options import RunOptions

WAVELENGTHS = [400.0, 700.0, 1030.0, 1300.0, 1500.0, 1900.0, 2250.0]
WET_WAVELENGTHS = [900.0, 1150.0, 1700.0]


def make_random_snowpack(generator: np.random.Generator, is_wet: bool) -> splits.Stack:
    """Return a snowpack of one to five layers."""

    def draw(low: float, high: float) -> float:
        return float(np.exp(generator.uniform(np.log(low), np.log(high))))

    n_layers = int(generator.integers(1, 6))
    layers = [
        splits.Snow.natural(
            specific_surface_area_m2_kg=draw(3.0, 80.0),
            density_kg_m3=float(generator.uniform(50.0, 550.0)),
            depth_m=draw(0.005, 0.5),
            liquid_water_content=float(generator.uniform(0.0, 0.1)) * is_wet,
            impurities_ng_g={"black_carbon": float(generator.uniform(0.0, 500.0))},
        )
        for _ in range(n_layers)
    ]
    if generator.uniform() < 0.3:
        layers[-1] = splits.Snow.natural(
            specific_surface_area_m2_kg=draw(3.0, 80.0),
            liquid_water_content=float(generator.uniform(0.0, 0.1)) * is_wet,
        )
        return splits.Stack(layers)
    return splits.Stack(layers, ground=float(generator.uniform(0.0, 0.8)))


def make_wet_snowpack(generator: np.random.Generator) -> splits.Stack | splits.Snow:
    """Return one or two layers, of which up to half of the pores are wet."""
    layers = []
    for _ in range(int(generator.integers(1, 3))):
        density = float(generator.uniform(100.0, 500.0))
        layers.append({
            "specific_surface_area_m2_kg": float(np.exp(generator.uniform(1.6, 4.1))),
            "density_kg_m3": density,
            "depth_m": float(np.exp(generator.uniform(-4.6, -2.3))),
            "liquid_water_content": float(generator.uniform(0.0, 0.49)) * (1.0 - density / 917.0),
        })  # fmt: skip
    if generator.uniform() < 0.5:
        layers[-1].pop("depth_m")
        return splits.Stack([splits.Snow.natural(**layer) for layer in layers])
    ground = float(generator.uniform(0.0, 0.8))
    return splits.Stack([splits.Snow.natural(**layer) for layer in layers], ground=ground)


def compare_snowpacks(seeds: range, error: float, only_wet: bool = False) -> np.ndarray:
    """Return differences from paths over their errors, shape (snowpacks, 2, wavelengths)."""
    z = []
    for seed in seeds:
        generator = np.random.default_rng(seed)
        if only_wet:
            snowpack: Any = make_wet_snowpack(generator)
        else:
            snowpack = make_random_snowpack(generator, is_wet=seed % 2 == 0)
        wavelengths = WET_WAVELENGTHS if only_wet else WAVELENGTHS
        incidence = "diffuse" if seed % 5 == 0 else float(generator.uniform(0.0, 80.0))
        paths, ordinates = (
            splits.spectrophotometer(snowpack, wavelengths, incidence, error, seed, solver=solver)
            for solver in ("monte_carlo", "discrete_ordinates")
        )
        for name in ("reflectance", "transmittance"):
            stderr = np.hypot(ordinates[f"{name}_stderr"], paths[f"{name}_stderr"])
            z.append(((ordinates[name] - paths[name]) / stderr).values)
    return np.array(z).reshape(len(seeds), 2, -1)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_random_snowpacks_agree_with_paths():
    judge_z(compare_snowpacks(range(8), 0.004), independent=8, bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
def test_tables_of_grains_agree_with_new_paths():
    """Moments between the nodes of the tables agree with other paths within their noise."""
    rays, orders = 20 * GRAIN_RAYS_PER_CHUNK, 17
    snow, run = splits.Snow.natural(optical_radius_um=100.0), RunOptions.from_arguments(5)
    contrast, q = np.array([0.21, 0.3]), np.array([0.0, 1e-3, 0.3, 0.9])
    for is_wet in (False, True):
        kept = load_natural_grains(wet=is_wet)
        saturation = np.array([0.07, 0.3] if is_wet else [0.0])
        water = kept.contrast.compute_weights(contrast) @ kept.water
        axes = TableAxes(Axis(contrast), Axis(saturation), Axis(q), water)
        new = tabulate_grains(snow, axes, orders, rays, run)
        for row, wet_fraction in enumerate(saturation):
            absorption = np.repeat(q / (1.0 - q), contrast.size).reshape(q.size, -1)
            expected, found = (
                table.compute_moments(contrast, absorption, float(wet_fraction), orders)
                for table in (kept, new)
            )
            # Per ray, |P_l| is at most 1; light into wet pores is divided by their fraction.
            bound = 4.5 / np.sqrt(rays * (wet_fraction or 1.0))
            assert np.abs(found - expected).max() < bound, (is_wet, row)
