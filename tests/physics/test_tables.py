"""Lookup tables: detection of axes that share paths, unbiased path reuse, restart of a build."""

import math

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, compare_results, judge_z

import splits
from splits.core.validation import InvalidValue
from splits.instruments.spectrophotometer import SpectralRequest
from splits.io.cache import compute_digest
from splits.simulation.run_options import RunOptions
from splits.simulation.shared_paths import PathSharingMedia, compute_path_signature
from splits.tables import build
from splits.tables.axes import ParameterGrid
from splits.tables.blocks import TablePlan
from splits.tables.build import list_block_inputs

WAVELENGTHS = np.array([450.0, 800.0, 1030.0, 1300.0])
SOOT = [0.0, 50.0, 500.0]
GRID = {
    "optical_radius_um": [50.0, 100.0, 400.0], "incidence_deg": [0.0, 60.0], "soot": SOOT,
    "water": [0.0, 0.03],
}  # fmt: skip


def make_snow(optical_radius_um=100.0, soot=0.0, water=0.0, **more):
    return splits.Snow.natural(
        optical_radius_um=optical_radius_um, liquid_water_content=water,
        impurities_ng_g={"black_carbon": soot}, **more,
    )  # fmt: skip


def make_plan(make, grid):
    request = SpectralRequest(WAVELENGTHS, 0.0, 0.01, 1000, RunOptions.start(1, 1))
    return TablePlan.from_grid(make, ParameterGrid.from_mapping(grid), request)


def test_axes_that_share_paths_are_detected():
    plan = make_plan(make_snow, GRID)
    assert plan.path_sharing_axes == ("optical_radius_um", "soot")
    assert len(plan.path_groups) == 4
    assert sorted(np.concatenate([e.positions for e in plan.path_groups])) == list(range(36))
    assert str(plan) == (
        "2 of 4 axes share paths (optical_radius_um, soot): 4 ensembles for 36 spectra of 4 "
        "wavelengths"
    )


def test_ground_below_a_semi_infinite_snowpack_is_rejected():
    with pytest.raises(ValueError, match=r"ground = 0\.1.*no light reaches it below"):
        make_plan(make_snow, {"ground": [0.1, 0.5], "soot": SOOT})


@pytest.mark.parametrize(
    ("grid", "more", "shared"),
    [
        ({"optical_radius_um": [50.0, 100.0]}, {"depth_m": 0.1}, ()),
        ({"ground": [0.1, 0.5]}, {"depth_m": 0.1}, ("ground",)),
        ({"ground": ["open", "0.5"]}, {"depth_m": 0.1}, ()),
        ({"density_kg_m3": [200.0, 300.0]}, {}, ()),
        ({"temperature_c": [-10.0, -1.0]}, {}, ()),
        ({"impurities_in": ["ice", "pores"]}, {"soot": 10.0}, ("impurities_in",)),
    ],
)
def test_axes_that_change_paths_are_not_shared(grid, more, shared):
    def make(**point):
        if "ground" in point and point["ground"] == "0.5":
            point["ground"] = 0.5
        return make_snow(**more, **point)

    assert make_plan(make, grid).path_sharing_axes == shared


def test_depths_proportional_to_sizes_share_paths():
    def scaled(by):
        return splits.Snow(
            grain_size_um=(300.0 * by, 750.0 * by), depth_m=0.1 * by, saturation=0.0, ground=0.3
        )

    assert make_plan(scaled, {"by": [1.0, 1.7, 3.0]}).path_sharing_axes == ("by",)
    assert (
        compute_path_signature(scaled(1.0))[0]
        != compute_path_signature(splits.Snow(depth_m=0.1, saturation=0.0))[0]
    )


def test_path_sharing_of_stacks_and_rough_tops():
    def make_stack(by=1.0, soot=0.0, top_layer=None):
        snow = [make_snow(100.0 * by, soot, depth_m=0.02 * by), make_snow(200.0 * by)]
        return splits.Stack([top_layer, *snow] if top_layer else snow)

    assert make_plan(make_stack, {"by": [1.0, 2.0], "soot": SOOT}).path_sharing_axes == (
        "by",
        "soot",
    )
    surface = splits.RoughSurface(
        {"rms_height_m": 1e-3, "wave_number_per_m": 100.0, "waves": 4, "correlation": "gaussian"}
    )

    def make_rough_stack(by):
        top_layer = splits.ParticleLayer(
            optical_thickness=1.0, depth_m=0.01 * by, surface=surface, refractive_index=1.31,
            ground=None,
        )  # fmt: skip
        return make_stack(by, top_layer=top_layer)

    # The waves of a surface do not scale with the grains.
    assert make_plan(make_rough_stack, {"by": [1.0, 2.0]}).path_sharing_axes == ()

    def make_rough_layer_stack(index, wave_number=100.0, depth_m=0.01):
        top = splits.RoughSurface(
            {"rms_height_m": 1e-3, "wave_number_per_m": wave_number, "waves": 4,
             "correlation": "gaussian"}
        )  # fmt: skip
        return make_stack(top_layer=splits.ParticleLayer(
            optical_thickness=1.0, depth_m=depth_m, refractive_index=index, ground=None,
            surface=top,
        ))  # fmt: skip

    assert make_plan(make_rough_layer_stack, {"index": [1.2, 1.31]}).path_sharing_axes == ()
    assert make_plan(
        lambda wave_number: make_rough_layer_stack(1.31, wave_number),
        {"wave_number": [100.0, 100.1]},
    ).path_sharing_axes == ()  # fmt: skip
    layers = {
        index: splits.Stack(
            [splits.ParticleLayer(refractive_index=index, ground=None, depth_m=0.01)]
        )
        for index in (1.0, 1.3)
    }
    assert compute_path_signature(layers[1.0])[0] != compute_path_signature(layers[1.3])[0]


@NEEDS_JIT
@pytest.mark.parametrize("saturation", [0.0, 0.2])
@pytest.mark.parametrize(("scale", "max_rms"), [(2.0, 0.0), (4.0, 0.0), (1.3, 0.7)])
def test_paths_scale_with_grain_size(scale, max_rms, saturation):
    """For equal seeds the results are bitwise equal where the scale is a power of two.

    At other scales rounding makes a few rays diverge; the mean square of 20 such differences stays
    below half of that between different seeds.
    """

    def snow(scale):
        # Extinction this small does not change the reflectance.
        ice, water = 1.31 + 4e-7j / scale, 1.33 + 1e-7j / scale
        return splits.Snow(
            grain_size_um=(50.0 * scale, 125.0 * scale), saturation=saturation, depth_m=math.inf,
            refractive_index={"ice": ice, "water": water}, interpretation="geometric",
        )  # fmt: skip

    z = []
    for seed in range(1 if max_rms == 0.0 else 20):
        small, large = (
            splits.spectrophotometer(
                snow(x),
                [600.0],
                30.0,
                max_stderr=0.02,
                seed=seed,
                kernel="vectorized",
                solver="monte_carlo",
            )
            for x in (1.0, scale)
        )
        z.append(compare_results(large, small, "reflectance"))
    assert np.sqrt(np.mean(np.square(z))) <= max_rms


@NEEDS_JIT
@pytest.mark.parametrize("water", [0.0, 0.04])
def test_media_that_share_paths_agree_with_single_runs(water):
    run = RunOptions.start(5)
    shared_request = SpectralRequest(WAVELENGTHS, 30.0, 0.005, 20_000_000, run)
    radii = np.array([60.0, 130.0, 400.0])
    media = tuple(make_snow(radius, 20.0, water) for radius in radii)

    def estimate(path_sharing, request):
        return request.simulate(path_sharing, request.truncate(path_sharing))

    shared = estimate(PathSharingMedia(media, radii / radii[0]), shared_request)
    z = []
    for number, medium in enumerate(media):
        single_request = shared_request._replace(run=run._replace(seed=100 + number))
        single = estimate(PathSharingMedia.from_media([medium]), single_request)
        rows = slice(number * WAVELENGTHS.size, (number + 1) * WAVELENGTHS.size)
        error = np.hypot(shared.stderr[0, rows], single.stderr[0])
        z.append((shared.mean[0, rows] - single.mean[0]) / error)
    judge_z(np.array(z), f"water {water}", independent=WAVELENGTHS.size, bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("solver", ["monte_carlo", "discrete_ordinates"])
def test_grid_nodes_agree_with_single_runs(solver):
    """Ten grid nodes against paths of other seeds; benchmarks/tables.py compares 60 at 0.001.

    Nodes of one ensemble use the same rays, so each of the four ensembles counts as one.
    """
    table = splits.build_table(make_snow, GRID, WAVELENGTHS, max_stderr=0.01, solver=solver).dataset
    assert table.attrs["max_stderr_reached"] <= 0.01
    random = np.random.default_rng(3)
    points = list(ParameterGrid.from_mapping(GRID).iterate_points())
    z = []
    for number in random.choice(len(points), 10, replace=False):
        point = dict(points[number])
        node = table.sel(point)
        incidence = point.pop("incidence_deg")
        single = splits.spectrophotometer(
            make_snow(**point),
            WAVELENGTHS,
            incidence,
            max_stderr=0.01,
            seed=100 + int(number),
            solver="monte_carlo",
        )
        z.append(compare_results(node, single, "reflectance"))
    judge_z(np.array(z), "nodes against runs", independent=4, bound_added=True)


@NEEDS_JIT
def test_interrupted_build_is_resumed(tmp_path, monkeypatch):
    reference = splits.build_table(
        make_snow,
        GRID,
        WAVELENGTHS,
        max_stderr=0.3,
        folder=tmp_path / "whole",
        solver="monte_carlo",
    ).dataset
    unsaved = splits.build_table(
        make_snow, GRID, WAVELENGTHS, max_stderr=0.3, solver="monte_carlo"
    ).dataset
    xr.testing.assert_equal(reference, unsaved)
    blocks = sorted((tmp_path / "whole").glob("block_*.nc"))
    # Along both axes that share paths, values between nodes have an ensemble of each other node.
    assert reference.attrs["ensembles"] == 4 and len(blocks) == 12
    blocks[2].unlink()
    damaged = bytearray(blocks[1].read_bytes())
    damaged[len(damaged) // 2] ^= 1
    blocks[1].write_bytes(damaged)
    computed = []
    original = build.compute_block
    monkeypatch.setattr(build, "compute_block", lambda e, *a: computed.append(e) or original(e, *a))
    resumed = splits.build_table(
        make_snow,
        GRID,
        WAVELENGTHS,
        max_stderr=0.3,
        folder=tmp_path / "whole",
        solver="monte_carlo",
    ).dataset
    assert len(computed) == 2
    xr.testing.assert_equal(resumed, reference)
    # With another seed, no stored block can be reused.
    computed.clear()
    splits.build_table(
        make_snow,
        GRID,
        WAVELENGTHS,
        max_stderr=0.3,
        seed=2,
        folder=tmp_path / "whole",
        solver="monte_carlo",
    )
    assert len(computed) == 12


@pytest.mark.parametrize(
    "other",
    [
        {"optical_radius_um": [100.0, 200.0]},
        {"soot": [0.0, 60.0]},
        {"incidence_deg": [0.0, 59.0]},
        {"water": [0.01]},
    ],
    ids=lambda other: next(iter(other)),
)
def test_keys_of_blocks_depend_on_the_table(other):
    grid = {
        "optical_radius_um": [50.0, 100.0], "incidence_deg": [0.0, 60.0], "soot": [0.0, 50.0],
        "water": [0.0],
    }  # fmt: skip
    plan, other_plan = make_plan(make_snow, grid), make_plan(make_snow, grid | other)
    digests, other_digests = (
        [compute_digest(*list_block_inputs(e, one)) for e in one.path_groups]
        for one in (plan, other_plan)
    )
    assert digests[-1] != other_digests[-1]
    first, request = plan.path_groups[0], plan.request
    run = request.run
    assert len(set(digests)) == len(digests)
    for changed in (
        plan._replace(covariance=True), plan._replace(quantities=("transmittance",)),
        plan._replace(request=request._replace(run=run._replace(seed=2))),
        plan._replace(request=request._replace(max_stderr=0.02)),
    ):  # fmt: skip
        assert compute_digest(*list_block_inputs(first, changed)) != digests[0]
    threads = plan._replace(request=request._replace(run=run._replace(threads=7)))
    assert compute_digest(*list_block_inputs(first, threads)) == digests[0]


@NEEDS_JIT
def test_results_are_independent_of_threads_and_other_nodes():
    one = splits.build_table(
        make_snow, GRID, WAVELENGTHS, max_stderr=0.03, threads=1, solver="monte_carlo"
    ).dataset
    two = splits.build_table(
        make_snow, GRID, WAVELENGTHS, max_stderr=0.03, threads=2, solver="monte_carlo"
    ).dataset
    xr.testing.assert_equal(one, two)
    narrow = {**GRID, "incidence_deg": [60.0], "water": [0.03]}
    subset = splits.build_table(
        make_snow, narrow, WAVELENGTHS, max_stderr=0.03, solver="monte_carlo"
    ).dataset
    nodes = one.sel(incidence_deg=[60.0], water=[0.03])
    for name in ("reflectance", "reflectance_stderr"):
        xr.testing.assert_equal(subset[name], nodes[name])


@NEEDS_JIT
def test_saved_table_is_opened_and_interpolated(tmp_path):
    grid = {"optical_radius_um": [50.0, 100.0, 200.0, 400.0], "soot": SOOT}
    table = splits.build_table(
        make_snow, grid, WAVELENGTHS, 40.0, max_stderr=0.02, covariance=True
    ).dataset
    splits.save(table, tmp_path / "table.nc")
    opened = splits.Table(tmp_path / "table.nc")
    assert opened.quantities == ["reflectance"]
    assert table.reflectance_batches.sizes["batch"] == 32
    interpolated = opened.interp(optical_radius_um=150.0, soot=20.0)
    low, high = table.reflectance.min(), table.reflectance.max()
    assert ((interpolated.reflectance > low) & (interpolated.reflectance < high)).all()
    assert (interpolated.reflectance_stderr > 0.0).all()
    square = (table.reflectance_batches**2).sum("batch")
    assert (square <= table.reflectance_stderr**2 * 1.001).all()


@NEEDS_JIT
def test_particle_layers_of_any_size_share_paths():
    """The reflectance depends on the optical thickness, not on the depth."""
    grid = {"optical_thickness": [0.5, 2.0], "depth_m": [0.1, 1.0]}
    table = splits.build_table(splits.ParticleLayer, grid, [500.0], max_stderr=0.01).dataset
    assert table.attrs["ensembles"] == 2
    assert (table.reflectance.isel(depth_m=0) == table.reflectance.isel(depth_m=1)).all()
    for thickness in grid["optical_thickness"]:
        one = splits.spectrophotometer(
            splits.ParticleLayer(optical_thickness=thickness), [500.0], max_stderr=0.01, seed=2
        )
        cell = table.sel(optical_thickness=thickness, depth_m=1.0)
        assert abs(compare_results(cell, one, "reflectance")) < 4.0


def test_invalid_grid_points_are_named():
    with pytest.raises(
        InvalidValue, match=r"^grid = 'optical_radius_um = 100000.0': must be a medium"
    ):
        make_plan(make_snow, {"optical_radius_um": [100.0, 1e5]})
    with pytest.raises(InvalidValue, match=r"^grid = 'size = 1.0': must be a medium .*size"):
        make_plan(make_snow, {"size": [1.0]})
    assert math.isinf(make_snow().depth_m)
