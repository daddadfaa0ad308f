"""Snow and sand by discrete ordinates against paths, and laws of wet layers."""

from typing import Any

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z
from level_fluxes import compute_profile, join_cosines

import splits
from splits.discrete_ordinates.adding import (
    Boundary,
    Element,
    RefractingCells,
    compute_budget,
    make_isotropic,
    make_wet_boundary,
    make_wet_interface,
    reflect_at_bottom,
    refract_directions,
)
from splits.discrete_ordinates.grain_tabulation import TableAxes, tabulate_grains
from splits.discrete_ordinates.grains import Axis
from splits.discrete_ordinates.granular_stack import load_natural_grains
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab
from splits.instruments.solver import choose_solver
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
            splits.spectrophotometer(
                snowpack, wavelengths, incidence, max_stderr=error, seed=seed, solver=solver
            )
            for solver in ("monte_carlo", "discrete_ordinates")
        )
        z.append(compare_results(ordinates, paths, "reflectance", "transmittance"))
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
    snow, run = splits.Snow.natural(optical_radius_um=100.0), RunOptions.start(5)
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


MEDIA_WAVELENGTHS = [500.0, 800.0, 1030.0, 1300.0, 1900.0]
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


def make_random_medium(
    seed: int, wet: bool, interpretation
) -> tuple[splits.Snow | splits.Sand, float | str]:
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
        solved = splits.spectrophotometer(
            medium, MEDIA_WAVELENGTHS, incidence, max_stderr=2.0 * error, **SOLVED
        )
        paths = splits.spectrophotometer(
            medium, MEDIA_WAVELENGTHS, incidence, max_stderr=error, seed=seed, **TRACED
        )
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
        keywords = {"depth_m": [0.01, 0.02], "max_stderr": 0.002}
        paths, solved = (
            splits.irradiance_profile(medium, MEDIA_WAVELENGTHS[1:4], 30.0, **keywords, **how)
            for how in (TRACED, SOLVED)
        )
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
        z = compare_results(solved, paths, "brdf")
        judge_z(z, "BRDF", independent=4, bound_added=True)


@NEEDS_JIT
def test_layers_of_different_grains_are_solved_together():
    """Natural snow on sand; the division of a layer and absent water change nothing."""
    natural = splits.Snow.natural(specific_surface_area_m2_kg=20.0, depth_m=0.002)
    sand = splits.Sand(depth_m=0.01, interpretation=POINTS)
    half = splits.Sand(depth_m=0.005, interpretation=POINTS)
    one, two = (
        splits.spectrophotometer(splits.Stack(layers), [1000.0], 40.0, max_stderr=0.01, **SOLVED)
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
        splits.spectrophotometer(
            splits.Stack([top, below]), [1300.0], 40.0, max_stderr=0.01, **SOLVED
        )
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
        solved = splits.spectrophotometer(medium, [600.0], 40.0, max_stderr=0.02, **SOLVED)
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
        splits.irradiance_profile(sand, [1000.0], depth_m=[0.001], **SOLVED)


@pytest.mark.parametrize("interpretation", [POINTS, FINITE])
def test_auto_traces_no_paths_through_single_grains(interpretation):
    sand = splits.Sand(interpretation=interpretation)
    choice = choose_solver("auto", [sand], np.array([1000.0]), max_stderr=0.02)
    assert (choice.solver, choice.stacks) == ("monte_carlo", [])


N = 16
STREAMS = Streams.from_number(N)
COSINES = np.cos(np.radians([0.0, 60.0, 85.0]))
WATER = np.array([1.33, 1.31])
"""Refractive indices at two wavelengths."""
CELLS = RefractingCells.from_index(WATER, STREAMS)
SATURATIONS = [(0.05, 0.3), (0.3, 0.05), (1e-9, 0.2), (0.4, 0.4)]


def make_wet_optics(thickness, saturation, albedo, index=WATER, water=0.0):
    """Return a layer in which a part of the scattered light changes the pore.

    Light changes the pore so that isotropic radiance is in equilibrium, n² as strong in wet pores.
    """
    n, f, orders = index[:, np.newaxis], saturation, np.arange(N + 1)
    moments, exchange = (
        np.asarray(albedo)[:, np.newaxis] * factor * asymmetry**orders
        for factor, asymmetry in ((1.0, 0.75), (0.5, 0.5))
    )
    scattering = np.empty((index.size, 2, 2, N + 1))
    scattering[:, 0, 1] = scattering[:, 1, 0] = np.sqrt(f * (1.0 - f)) * exchange
    scattering[:, 0, 0] = moments - f * n * exchange
    scattering[:, 1, 1] = moments - (1.0 - f) / n * exchange
    extinction = np.tile([1.0, 1.0 + water], (index.size, 1))
    equilibrium = np.stack([0.0 * index + 1.0 - f, f * index**2], axis=-1)
    return LayerOptics(np.full(index.size, thickness), extinction, scattering, equilibrium)


class Stack:
    """Layers with their interfaces and boundaries; a saturation of None is one state."""

    def __init__(self, layers, saturations, ground=0.0, index=WATER):
        wet = saturations[0] is not None
        self.directions = refract_directions(COSINES, index) if wet else COSINES[np.newaxis]
        self.n_streams = (1 + wet) * STREAMS.cosines.size
        cells = RefractingCells.from_index(index, STREAMS)
        self.elements, self.isotropic = [], []
        for i, optics in enumerate(layers):
            pair = saturations[max(i - 1, 0)], saturations[i]
            if pair[0] != pair[1]:
                self.isotropic.append(self.isotropic[-1])
                self.elements.append(make_wet_interface(pair, index, cells, COSINES))
            self.isotropic.append(make_isotropic(optics, STREAMS, COSINES.size))
            slab = solve_slab(optics.truncate(N), STREAMS, self.directions)
            self.elements.append(Element.from_slab(slab, self.isotropic[-1]))
        self.isotropic.append(self.isotropic[-1])
        self.boundaries = [
            make_wet_boundary(end, index, cells, COSINES) if wet
            else Boundary.make_transparent(self.n_streams, COSINES.size)
            for end in (saturations[0], saturations[-1])
        ]  # fmt: skip
        self.cosines = join_cosines(STREAMS, self.directions)
        self.ground = np.full(index.size, ground)
        outside = self.boundaries, self.ground, self.n_streams
        self.profile = compute_profile(self.elements, self.isotropic, self.cosines, *outside)
        ends = self.isotropic[0], self.isotropic[-1]
        self.budget = compute_budget(self.elements, ends, *outside, with_absorption=True)

    @classmethod
    def from_layers(cls, layers, ground=0.0, water=0.0):
        """Return a stack of layers of thickness, saturation and albedo."""
        optics = [make_wet_optics(*layer, water=water) for layer in layers]
        return cls(optics, [saturation for _, saturation, _ in layers], ground)

    def check_energy(self, tolerance=1e-12):
        """Check that no light is lost, in the stack and in each element."""
        budget, net = self.budget, self.profile.downward - self.profile.upward
        total = budget.reflectance + budget.transmittance + budget.absorption.sum(axis=0)
        np.testing.assert_allclose(total, 1.0, atol=tolerance)
        np.testing.assert_allclose(net[0], 1.0 - budget.reflectance, atol=tolerance)
        np.testing.assert_allclose(net[-1], budget.transmittance, atol=tolerance)
        absorption = iter(budget.absorption)
        for element, loss in zip(self.elements, net[:-1] - net[1:], strict=True):
            expected = 0.0 if element.isotropic is None else next(absorption)
            np.testing.assert_allclose(loss, expected, atol=tolerance)


@pytest.mark.parametrize("saturations", SATURATIONS)
def test_interfaces_keep_equilibrium(saturations):
    interface = make_wet_interface(saturations, WATER, CELLS, COSINES)
    above, below = (
        make_isotropic(make_wet_optics(1.0, s, [1.0, 1.0]), STREAMS, COSINES.size)[..., np.newaxis]
        for s in saturations
    )
    rising = interface.reflection_above @ above + interface.transmission_up @ below
    falling = interface.reflection_below @ below + interface.transmission_down @ above
    np.testing.assert_allclose(rising, above, rtol=1e-12)
    np.testing.assert_allclose(falling, below, rtol=1e-12)


@pytest.mark.parametrize("saturation", [1e-9, 0.05, 0.5])
def test_boundaries_keep_equilibrium(saturation):
    """Isotropic light outside and inside: the same flux enters and leaves."""
    boundary = make_wet_boundary(saturation, WATER, CELLS, COSINES)
    isotropic = make_isotropic(make_wet_optics(1.0, saturation, [1.0, 1.0]), STREAMS, COSINES.size)
    np.testing.assert_allclose(boundary.reflection + boundary.transmission, 1.0, rtol=1e-12)
    leaving = 2.0 * (boundary.transmission * isotropic**2)[:, :N].sum(axis=-1)
    np.testing.assert_allclose(leaving + boundary.outer_reflectance[:, -1], 1.0, rtol=1e-12)
    beams = boundary.shares.reshape(2, 2, -1).sum(axis=1) + boundary.outer_reflectance[:, :-1]
    np.testing.assert_allclose(beams, 1.0, rtol=1e-12)


@pytest.mark.parametrize("saturations", SATURATIONS)
@pytest.mark.parametrize("thickness", [1e-3, 3.0])
def test_white_ground_without_absorption_encloses_equilibrium(saturations, thickness):
    stack = Stack.from_layers([(thickness, s, [1.0, 1.0]) for s in saturations], ground=1.0)
    profile = stack.profile
    np.testing.assert_allclose(stack.budget.reflectance, 1.0, rtol=1e-12)
    for level, isotropic in enumerate(stack.isotropic):
        streams = (isotropic**2)[:, :N]
        flux = 2.0 * streams.sum(axis=-1)
        actinic = 4.0 * (streams / stack.cosines[:, :N]).sum(axis=-1)
        np.testing.assert_allclose(profile.downward[level, :, -1], flux, rtol=1e-12)
        np.testing.assert_allclose(profile.upward[level, :, -1], flux, rtol=1e-12)
        np.testing.assert_allclose(profile.actinic[level, :, -1], actinic, rtol=1e-12)


@pytest.mark.parametrize("ground", [0.0, 0.6])
@pytest.mark.parametrize("water", [0.0, 0.1])
def test_energy_is_conserved(water, ground):
    albedo = [0.999, 0.9]
    layers = [(0.5, 0.02, albedo), (3.0, 0.3, albedo), (2.0, 0.3, [0.9, 1.0]), (1.0, 0.1, albedo)]
    stack = Stack.from_layers(layers, ground, water)
    stack.check_energy()
    assert stack.profile.actinic.shape == (7, 2, 4)
    for values in (*stack.profile, *stack.budget):
        assert (values > -1e-13).all()


@pytest.mark.parametrize("thickness", [0.0, 1e-8, 1e4, 1e8])
@pytest.mark.parametrize("albedo", [0.0, 1.0 - 1e-12, 1.0])
def test_extremes_are_finite(thickness, albedo):
    for ground in (0.0, 1.0):
        stack = Stack.from_layers([(thickness, s, [albedo] * 2) for s in (0.05, 0.3)], ground)
        stack.check_energy()
        for values in (*stack.profile, *stack.budget):
            assert np.isfinite(values).all()


def test_divisions_do_not_change_fluxes():
    albedo, ground = [0.99, 0.8], 0.4
    merged = Stack.from_layers([(2.0, 0.1, albedo), (3.0, 0.25, albedo)], ground, water=0.05)
    parts = [(0.7, 0.1, albedo), (1.3, 0.1, albedo), (1.0, 0.25, albedo), (2.0, 0.25, albedo)]
    divided = Stack.from_layers(parts, ground, water=0.05)
    np.testing.assert_allclose(merged.budget.reflectance, divided.budget.reflectance, atol=1e-13)
    absorption = divided.budget.absorption.reshape(2, 2, 2, -1).sum(axis=1)
    np.testing.assert_allclose(merged.budget.absorption, absorption, atol=1e-13)
    for one, other in zip(merged.profile, divided.profile, strict=True):
        np.testing.assert_allclose(one, other[[0, 2, 3, 5]], atol=1e-13)


def test_fluxes_are_those_of_radiances():
    """All radiances under diffuse light as one system of equations, without reciprocity."""
    albedo = [0.99, 0.8]
    stack = Stack.from_layers(
        [(0.5, 0.1, albedo), (2.0, 0.3, albedo), (1.0, 0.3, albedo)], 0.4, water=0.05
    )
    top, bottom = stack.boundaries
    at_ground, _ = reflect_at_bottom(bottom, stack.isotropic[-1], stack.ground, N)
    n_levels = len(stack.isotropic)
    for i in range(WATER.size):
        # Radiances downwards and upwards at the levels.
        matrix = np.eye(2 * n_levels * N).reshape(2, n_levels, N, 2, n_levels, N)
        down, up = matrix
        source = np.zeros((2, n_levels, N))
        source[0, 0] = (top.transmission * stack.isotropic[0])[i, :N]
        down[0, :, 1, 0] -= np.diag(top.reflection[i, :N])
        up[-1, :, 0, -1] -= at_ground[i, :N, :N]
        for j, element in enumerate(stack.elements):
            above, below, falling, rising = (values[i, :N, :N] for values in element[:4])
            up[j, :, 0, j] -= above
            up[j, :, 1, j + 1] -= rising
            down[j + 1, :, 1, j + 1] -= below
            down[j + 1, :, 0, j] -= falling
        size = 2 * n_levels * N
        radiances = np.linalg.solve(matrix.reshape(size, size), source.ravel())
        isotropic = np.array(stack.isotropic)[:, i, :N]
        fluxes = 2.0 * isotropic * radiances.reshape(2, n_levels, N)
        expected = *fluxes.sum(axis=-1), (fluxes / stack.cosines[i, :N]).sum(axis=(0, -1))
        for actual, values in zip(stack.profile[1:], expected, strict=True):
            np.testing.assert_allclose(actual[:, i, -1], values, atol=1e-13)


def test_states_of_equal_optics_are_one_state():
    """Water of a refractive index of 1 changes nothing, at any saturation."""
    # Without a forward peak, which is only that of light that stays in its state.
    moments = np.where(np.arange(N + 1) < N, 0.75 ** np.arange(N + 1), 0.0)
    albedo, index, saturations = np.array([0.99, 0.7]), np.ones(2), [0.02, 0.3, 0.1]
    layers = [
        LayerOptics.from_albedo(np.full(2, thickness), albedo, moments)
        for thickness in (0.5, 3.0, 2.0)
    ]
    divided = []
    for optics, saturation in zip(layers, saturations, strict=True):
        parts = np.array([1.0 - saturation, saturation])
        factors = np.sqrt(np.outer(parts, parts))[..., np.newaxis]
        scattering, unit = factors * optics.scattering, np.ones((2, 1))
        divided.append(LayerOptics(optics.thickness, unit + 0.0 * parts, scattering, unit * parts))
    dry, wet = Stack(layers, [None] * 3, 0.4), Stack(divided, saturations, 0.4, index)
    for one, other in zip(dry.budget, wet.budget, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-13)
    for one, other in zip(dry.profile, wet.profile, strict=True):
        np.testing.assert_allclose(one[[0, 1, 1, 2, 2, 3]], other, atol=1e-13)


def test_transmission_without_absorption_decreases_as_inverse_thickness():
    """1/T is linear in τ, also where k² is smaller than rounding errors of the matrices.

    All coefficients are exact in binary, so that nothing is absorbed.
    """
    thickness = np.array([1e4, 1e6, 1e8, 1e10])
    optics = make_wet_optics(1.0, 0.5, np.ones(4), np.full(4, 2.0))
    optics = optics._replace(thickness=thickness).truncate(N)
    slab = solve_slab(optics, STREAMS, np.empty((2, 0)))
    isotropic = make_isotropic(optics, STREAMS, 0)[..., np.newaxis]
    resistance = 1.0 / (np.swapaxes(isotropic, -1, -2) @ slab.transmission @ isotropic)[:, 0, 0]
    slope = np.diff(resistance) / np.diff(thickness)
    np.testing.assert_allclose(slope, slope[0], rtol=1e-9)


@pytest.mark.parametrize("water", [0.0, 1e-9, 0.1])
@pytest.mark.parametrize("albedo", [0.5, 1.0 - 1e-9, 1.0])
@pytest.mark.parametrize("thickness", [1e-8, 0.5, 80.0, 1e4])
def test_transmission_has_a_small_relative_error(thickness, albedo, water):
    """Transmission of a slab, down to the smallest numbers, is that of two halves."""
    directions = refract_directions(COSINES, WATER)
    whole, half = (
        solve_slab(
            make_wet_optics(t, 0.1, [albedo] * 2, water=water).truncate(N), STREAMS, directions
        )
        for t in (thickness, 0.5 * thickness)
    )
    passed = np.linalg.inv(np.eye(N) - half.reflection @ half.reflection) @ half.transmission
    direct = half.direct[..., np.newaxis]
    rows = half.beam_transmission + direct * half.beam_reflection @ half.reflection
    for one, two in (
        (whole.transmission, half.transmission @ passed),
        (whole.beam_transmission, direct * half.beam_transmission + rows @ passed),
    ):
        np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-11 * two.max() + 1e-300)
