"""Tables: who shares paths, that sharing changes nothing, and that nothing is lost on the way."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.core.validation import InvalidValue
from splits.instruments.spectral_run import SpectralRequest
from splits.simulation.path_reuse import compute_path_signature
from splits.simulation.path_tally import PathSharingMedia
from splits.tables import build
from splits.tables.axes import ParameterGrid
from splits.tables.block import TableRequest
from splits.tables.plan import TablePlan

WAVELENGTHS = np.array([450.0, 800.0, 1030.0, 1300.0])
SOOT = [0.0, 50.0, 500.0]
GRID = {
    "optical_radius_um": [50.0, 100.0, 400.0], "incidence_deg": [0.0, 60.0], "soot": SOOT,
    "water": [0.0, 0.03],
}  # fmt: skip


def pack(optical_radius_um=100.0, soot=0.0, water=0.0, **more):
    return splits.Snow.natural(
        optical_radius_um=optical_radius_um, liquid_water_content=water,
        impurities_ng_g={"black_carbon": soot}, **more,
    )  # fmt: skip


def plan_of(make, grid):
    return TablePlan.from_grid(make, ParameterGrid.from_mapping(grid), WAVELENGTHS)


def test_axes_that_share_paths_are_found():
    plan = plan_of(pack, GRID)
    assert plan.path_sharing_axes == ("optical_radius_um", "soot")
    assert len(plan.path_groups) == 4
    assert sorted(np.concatenate([e.positions for e in plan.path_groups])) == list(range(36))
    assert str(plan) == (
        "2 of 4 axes share paths (optical_radius_um, soot): 4 ensembles for 36 spectra of 4 "
        "wavelengths"
    )


def test_a_ground_below_a_pack_without_end_is_no_medium_of_its_own():
    plan = plan_of(pack, {"ground": [0.1, 0.5], "soot": SOOT})
    (ensemble,) = plan.path_groups
    assert plan.path_sharing_axes == ("ground", "soot")
    assert len(ensemble.path_sharing.media) == 3
    # A soil that ends at 1000 nm says nothing about it.
    plan_of(pack, {"ground": ["camborthid"]})


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
def test_what_has_paths_of_its_own(grid, more, shared):
    def make(**point):
        if "ground" in point and point["ground"] == "0.5":
            point["ground"] = 0.5
        return pack(**more, **point)

    assert plan_of(make, grid).path_sharing_axes == shared


def test_depths_that_go_with_sizes_share_paths():
    def scaled(by):
        return splits.Snow(
            grain_size_um=(300.0 * by, 750.0 * by), depth_m=0.1 * by, saturation=0.0, ground=0.3
        )

    assert plan_of(scaled, {"by": [1.0, 1.7, 3.0]}).path_sharing_axes == ("by",)
    assert (
        compute_path_signature(scaled(1.0))[0]
        != compute_path_signature(splits.Snow(depth_m=0.1, saturation=0.0))[0]
    )


def test_stacks_and_rough_tops():
    def packs(by=1.0, soot=0.0, lid=None):
        snow = [pack(100.0 * by, soot, depth_m=0.02 * by), pack(200.0 * by)]
        return splits.Stack([lid, *snow] if lid else snow)

    assert plan_of(packs, {"by": [1.0, 2.0], "soot": SOOT}).path_sharing_axes == ("by", "soot")
    surface = splits.RoughSurface(
        {"rms_height_m": 1e-3, "wave_number_per_m": 100.0, "waves": 4, "correlation": "gaussian"}
    )

    def lidded(by):
        lid = splits.ParticleLayer(
            optical_thickness=1.0, depth_m=0.01 * by, surface=surface, refractive_index=1.31,
            bottom_albedo=None,
        )  # fmt: skip
        return packs(by, lid=lid)

    # The waves of a surface do not grow with the grains.
    assert plan_of(lidded, {"by": [1.0, 2.0]}).path_sharing_axes == ()

    def in_ice(index, wave_number=100.0, depth_m=0.01):
        top = splits.RoughSurface(
            {"rms_height_m": 1e-3, "wave_number_per_m": wave_number, "waves": 4,
             "correlation": "gaussian"}
        )  # fmt: skip
        return packs(lid=splits.ParticleLayer(
            optical_thickness=1.0, depth_m=depth_m, refractive_index=index, bottom_albedo=None,
            surface=top,
        ))  # fmt: skip

    assert plan_of(in_ice, {"index": [1.2, 1.31]}).path_sharing_axes == ()
    assert plan_of(
        lambda wave_number: in_ice(1.31, wave_number), {"wave_number": [100.0, 100.1]}
    ).path_sharing_axes == ()  # fmt: skip
    alone = {
        index: splits.Stack(
            [splits.ParticleLayer(refractive_index=index, bottom_albedo=None, depth_m=0.01)]
        )
        for index in (1.0, 1.3)
    }
    assert compute_path_signature(alone[1.0])[0] != compute_path_signature(alone[1.3])[0]


@NEEDS_JIT
@pytest.mark.parametrize("saturation", [0.0, 0.2])
@pytest.mark.parametrize(("by", "part"), [(2.0, 0.0), (4.0, 0.0), (1.3, 0.7)])
def test_light_takes_the_same_paths_among_larger_grains(by, part, saturation):
    """Same seed, same bits where the scale is a power of two.

    By another, a few rays part from those of the small grains where rounding decides; of 20 such
    differences the mean square stays below half of that of runs with other seeds.
    """

    def snow(by):
        # So little extinction does not show in reflection.
        ice, water = 1.31 + 4e-7j / by, 1.33 + 1e-7j / by
        return splits.Snow(
            grain_size_um=(50.0 * by, 125.0 * by), saturation=saturation, depth_m=math.inf,
            refractive_index={"ice": ice, "water": water}, interpretation="geometric",
        )  # fmt: skip

    z = []
    for seed in range(1 if part == 0.0 else 20):
        small, large = (
            splits.spectrophotometer(snow(x), [600.0], 30.0, 0.02, seed, kernel="vectorized")
            for x in (1.0, by)
        )
        away = (large.reflectance - small.reflectance).item()
        z.append(away / np.hypot(large.reflectance_stderr, small.reflectance_stderr).item())
    assert np.sqrt(np.mean(np.square(z))) <= part


@NEEDS_JIT
@pytest.mark.parametrize("water", [0.0, 0.04])
def test_members_of_a_family_are_what_runs_of_their_own_give(water):
    run = SpectralRequest.from_arguments(WAVELENGTHS, 30.0, 0.005, 5, 20_000_000, None, "auto")
    radii = np.array([60.0, 130.0, 400.0])
    media = tuple(pack(radius, 20.0, water) for radius in radii)
    told = run.estimate(PathSharingMedia(media, radii / radii[0])).estimate
    z = []
    for number, medium in enumerate(media):
        own = (
            run._replace(seed=100 + number).estimate(PathSharingMedia.from_media([medium])).estimate
        )
        rows = slice(number * WAVELENGTHS.size, (number + 1) * WAVELENGTHS.size)
        error = np.hypot(told.stderr[0, rows], own.stderr[0])
        z.append((told.mean[0, rows] - own.mean[0]) / error)
    judge_z(np.array(z), f"water {water}", independent=WAVELENGTHS.size, bound_added=True)


@NEEDS_JIT
def test_every_cell_is_what_a_run_of_its_own_gives():
    """Ten cells, other seeds; benchmarks/tables.py does the same with 60 at 0.001.

    Cells of one ensemble share rays, so each of the four counts as one.
    """
    found = splits.build_table(pack, GRID, WAVELENGTHS, max_stderr=0.01)
    assert found.attrs["max_stderr_reached"] <= 0.01
    random = np.random.default_rng(3)
    points = list(ParameterGrid.from_mapping(GRID).iterate_points())
    z = []
    for number in random.choice(len(points), 10, replace=False):
        point = dict(points[number])
        cell = found.sel(point)
        incidence = point.pop("incidence_deg")
        own = splits.spectrophotometer(
            pack(**point), WAVELENGTHS, incidence, max_stderr=0.01, seed=100 + int(number)
        )
        error = np.hypot(cell.reflectance_stderr, own.reflectance_stderr)
        z.append(((cell.reflectance - own.reflectance) / error).values)
    judge_z(np.array(z), "cells against runs", independent=4, bound_added=True)


@NEEDS_JIT
def test_a_table_that_was_broken_off_goes_on(tmp_path, monkeypatch):
    whole = splits.build_table(pack, GRID, WAVELENGTHS, max_stderr=0.03, folder=tmp_path / "whole")
    once = splits.build_table(pack, GRID, WAVELENGTHS, max_stderr=0.03)
    xr.testing.assert_equal(whole, once)
    kept = sorted((tmp_path / "whole").glob("block_*.nc"))
    assert len(kept) == whole.attrs["ensembles"] == 4
    kept[2].unlink()
    damaged = bytearray(kept[1].read_bytes())
    damaged[len(damaged) // 2] ^= 1
    kept[1].write_bytes(damaged)
    measured = []
    original = build.compute_block
    monkeypatch.setattr(
        build, "compute_block", lambda e, *a: measured.append(e.number) or original(e, *a)
    )
    again = splits.build_table(pack, GRID, WAVELENGTHS, max_stderr=0.03, folder=tmp_path / "whole")
    assert measured == [1, 2]
    xr.testing.assert_equal(again, whole)
    # Other orders find nothing that would serve.
    measured.clear()
    splits.build_table(pack, GRID, WAVELENGTHS, max_stderr=0.03, seed=2, folder=tmp_path / "whole")
    assert measured == [0, 1, 2, 3]


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
def test_blocks_of_other_tables_are_none_of_this_one(other):
    grid = {
        "optical_radius_um": [50.0, 100.0], "incidence_deg": [0.0, 60.0], "soot": [0.0, 50.0],
        "water": [0.0],
    }  # fmt: skip
    run = SpectralRequest.from_arguments(WAVELENGTHS, 0.0, 0.01, 1, 1000, 1, "auto")
    order = TableRequest(run, ("reflectance",), False)
    one, two = (
        [build.compute_block_digest(e, order) for e in plan_of(pack, g).path_groups]
        for g in (grid, grid | other)
    )
    assert one[-1] != two[-1]
    assert len(set(one)) == len(one)
    for changed in (
        order._replace(covariance=True), order._replace(quantities=("transmittance",)),
        order._replace(spectral_request=run._replace(seed=2)),
        order._replace(spectral_request=run._replace(max_stderr=0.02)),
    ):  # fmt: skip
        assert build.compute_block_digest(plan_of(pack, grid).path_groups[0], changed) != one[0]
    threads = order._replace(spectral_request=run._replace(threads=7))
    assert build.compute_block_digest(plan_of(pack, grid).path_groups[0], threads) == one[0]


@NEEDS_JIT
def test_bits_do_not_depend_on_threads_or_on_what_else_is_in_the_table():
    one = splits.build_table(pack, GRID, WAVELENGTHS, max_stderr=0.03, threads=1)
    two = splits.build_table(pack, GRID, WAVELENGTHS, max_stderr=0.03, threads=2)
    xr.testing.assert_equal(one, two)
    narrow = {**GRID, "incidence_deg": [60.0], "water": [0.03]}
    part = splits.build_table(pack, narrow, WAVELENGTHS, max_stderr=0.03)
    xr.testing.assert_equal(part, one.sel(incidence_deg=[60.0], water=[0.03]))


@NEEDS_JIT
def test_a_table_written_is_opened_and_read(tmp_path):
    grid = {"optical_radius_um": [50.0, 100.0, 200.0, 400.0], "soot": SOOT}
    made = splits.build_table(pack, grid, WAVELENGTHS, 40.0, max_stderr=0.02, covariance=True)
    splits.save(made, tmp_path / "table.nc")
    opened = splits.open_table(tmp_path / "table.nc")
    assert opened.quantities == ["reflectance"]
    assert made.reflectance_batches.sizes["batch"] == 32
    found = opened.interp(optical_radius_um=150.0, soot=20.0)
    low, high = made.reflectance.min(), made.reflectance.max()
    assert ((found.reflectance > low) & (found.reflectance < high)).all()
    assert (found.reflectance_stderr > 0.0).all()
    square = (made.reflectance_batches**2).sum("batch")
    assert (square <= made.reflectance_stderr**2 * 1.001).all()


def test_points_that_cannot_be_are_named():
    with pytest.raises(
        InvalidValue, match=r"^grid = 'optical_radius_um = 100000.0': must be a medium"
    ):
        plan_of(pack, {"optical_radius_um": [100.0, 1e5]})
    with pytest.raises(InvalidValue, match=r"^grid = 'size = 1.0': must be a medium .*size"):
        plan_of(pack, {"size": [1.0]})
    with pytest.raises(InvalidValue, match=r"must be a granular medium"):
        plan_of(lambda optical_thickness: splits.ParticleLayer(optical_thickness=optical_thickness),
                {"optical_thickness": [1.0]})  # fmt: skip
    assert math.isinf(pack().depth_m)
