"""Discrete ordinates for sand and for snow of other grains than natural snow, against paths."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.instruments.solver import choose_solver

WAVELENGTHS = [500.0, 800.0, 1030.0, 1300.0, 1900.0]
POINTS = "radiative_transfer"
FINITE = {
    "set": "geometric", "overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep",
}  # fmt: skip
MIN_VALUE = 5.0
"""Smallest value that is compared, in units of the requested error of paths."""
TRACED, SOLVED = {"solver": "monte_carlo"}, {"solver": "discrete_ordinates"}


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
        paths = splits.spectrophotometer(medium, WAVELENGTHS, incidence, error, seed, **TRACED)
        for name in ("reflectance", "transmittance"):
            stderr = np.hypot(solved[f"{name}_stderr"], paths[f"{name}_stderr"]).values
            difference = (solved[name] - paths[name]).values
            is_small = solved[name].values < MIN_VALUE * error
            limit = MIN_VALUE * np.maximum(error, stderr)
            assert (np.abs(difference) < limit).all(), (seed, difference)
            z.append(np.where(is_small, 0.0, difference / stderr))
    return np.array(z).reshape(len(seeds), 2, -1)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_random_media_agree_with_paths():
    z = compare_media(range(6), 0.004, wet=lambda seed: seed >= 4)
    judge_z(z, independent=6, bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_random_finite_grains_agree_with_paths():
    judge_z(compare_media(range(10, 14), 0.004, interpretation=FINITE), bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_profiles_and_directions_of_point_grains_agree_with_paths():
    snow = splits.Snow(interpretation=POINTS, saturation=0.0, depth_m=0.03, ground=0.3)
    wet = splits.Snow(
        interpretation={"set": POINTS, "mean_free_path": "pore_only"}, saturation=0.2, depth_m=0.03
    )
    for medium in (snow, wet):
        arguments = (medium, WAVELENGTHS[1:4], [0.01, 0.02], 30.0, 0.002)
        paths, solved = (splits.irradiance_profile(*arguments, **how) for how in (TRACED, SOLVED))
        for name in ("downward_irradiance", "upward_irradiance", "absorptance_of_material"):
            stderr = np.hypot(paths[f"{name}_stderr"], solved[f"{name}_stderr"])
            z = ((solved[name] - paths[name]) / stderr).where(solved[name] > 0.01).values
            judge_z(z[np.isfinite(z)], name, independent=3, bound_added=True)
    sand = splits.Sand(interpretation=POINTS, depth_m=0.02)
    for medium in (snow, sand):
        directions = {"polar_deg": [0, 20, 40, 60], "azimuth_deg": [0, 90, 180]}
        paths, solved = (
            splits.goniophotometer(
                medium, [600.0, 1000.0], 50.0, relative_stderr=0.04, **directions, **how
            )
            for how in (TRACED, SOLVED)
        )
        stderr = np.hypot(paths.brdf_stderr, solved.brdf_stderr)
        judge_z((solved.brdf - paths.brdf) / stderr, "BRDF", independent=4, bound_added=True)


@NEEDS_JIT
def test_layers_of_different_grains_are_solved_together():
    """Natural snow on sand; the division of a layer and absent water change nothing."""
    natural = splits.Snow.natural(specific_surface_area_m2_kg=20.0, depth_m=0.002)
    sand = splits.Sand(depth_m=0.01, interpretation=POINTS)
    half = splits.Sand(depth_m=0.005, interpretation=POINTS)
    one, two = (
        splits.spectrophotometer(splits.Stack(layers), [1000.0], 40.0, 0.01, **SOLVED)
        for layers in ([natural, sand], [natural, half, half])
    )
    np.testing.assert_allclose(one.reflectance, two.reflectance, atol=1e-9)
    np.testing.assert_allclose(one.reflectance_stderr, two.reflectance_stderr, rtol=1e-6)
    assert (one.reflectance_stderr > 0.0).all() and one.attrs["solver"] == "discrete_ordinates"


@NEEDS_JIT
def test_dry_layers_of_a_wet_stack_keep_their_optics():
    """With a trace of water far below, the reflectance is that without."""
    top = splits.Snow(interpretation=POINTS, saturation=0.0, depth_m=0.3)
    wet, dry = (
        splits.Snow(interpretation=POINTS, saturation=water, depth_m=0.01) for water in (0.1, 0.0)
    )
    one, two = (
        splits.spectrophotometer(splits.Stack([top, below]), [1300.0], 40.0, 0.01, **SOLVED)
        for below in (wet, dry)
    )
    np.testing.assert_allclose(one.reflectance, two.reflectance, atol=2e-5)


@NEEDS_JIT
@pytest.mark.parametrize("water", [0.0, 0.3])
def test_media_without_absorption_lose_no_light(water):
    """Also where dry and wet pores are not in the equilibrium of n²."""
    index = {"ice": 1.31, "water": 1.33}
    snow = splits.Snow(
        interpretation=POINTS, saturation=water, depth_m=0.02, refractive_index=index
    )
    for medium in (snow, splits.Stack([snow, splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.02, refractive_index=index,
    )])):  # fmt: skip
        solved = splits.spectrophotometer(medium, [600.0], 40.0, 0.02, **SOLVED)
        # The tables of natural snow have single precision.
        assert abs(float(solved.absorptance.item())) < 2e-6


@pytest.mark.parametrize(
    ("medium", "reason"),
    [
        (splits.Snow(), "overlap_with_boundary 'reject'"),
        (splits.Sand(), "overlap_with_boundary 'reject'"),
        (splits.Snow(interpretation="geometric"), "overlap_with_boundary 'skip'"),
        (splits.Snow(interpretation=POINTS, saturation=0.6), "a saturation of 0.6"),
        (
            splits.Snow(interpretation={"set": POINTS, "entry_point": "uniform"}),
            "has water, and entry_point is 'uniform'",
        ),
        (
            splits.Snow(interpretation={"set": POINTS, "boundary_fresnel": "no"}),
            "boundary_fresnel 'no'",
        ),
        (
            splits.Snow(saturation=0.0, interpretation={**FINITE, "facet_sampling": "any"}),
            "has no point grains, and facet_sampling is 'any'",
        ),
        (splits.Snow(interpretation=FINITE), "has water between grains that are no points"),
        (splits.ParticleLayer(optical_thickness=1.0), "has no grains"),
    ],
)
def test_refusals_name_the_rule(medium, reason):
    with pytest.raises(ValueError, match=rf"(?s)solver.*{reason}"):
        splits.spectrophotometer(medium, [1000.0], **SOLVED)


def test_refusals_of_derivatives_and_profiles_name_the_layer():
    sand = splits.Sand(interpretation=POINTS)
    with pytest.raises(ValueError, match="can vary only in natural snow"):
        splits.spectrophotometer(sand, [1000.0], jacobian=["porosity"], **SOLVED)
    with pytest.raises(ValueError, match=r"layers\[0\] has grains of several materials"):
        splits.irradiance_profile(sand, [1000.0], [0.001], **SOLVED)


@pytest.mark.parametrize("interpretation", [POINTS, FINITE])
def test_auto_traces_no_paths_through_single_grains(interpretation):
    sand = splits.Sand(interpretation=interpretation)
    assert choose_solver("auto", [sand], np.array([1000.0]), max_stderr=0.02) == "monte_carlo"
