"""The spread of a thin beam against what is known of it."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_scatter, judge_z

import splits
from splits.instruments.beam_spread_tally import N_MAP_PIXELS
from splits.kernels.tallies.exits import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)
from splits.kernels.tallies.radial import tally_radial

SNOW = splits.Snow(depth_m=0.02)


def test_places_are_sorted_into_rings_and_squares():
    rows = allocate_exits(4, 1)
    rows[:, EXIT_SIDE] = [0, 1, 0, 0]
    rows[:, EXIT_ORDER] = [1, 2, 0, 7]
    rows[:, EXIT_WEIGHT] = 1.0
    rows[:, EXIT_DIRECTION : EXIT_DIRECTION + 3] = [0.0, 0.0, 1.0]
    rows[:, EXIT_POSITION : EXIT_POSITION + 2] = [[0.0, 0.5], [3.0, 4.0], [0.0, 0.0], [200.0, 0.0]]
    rows[:, EXIT_LENGTH] = 0.5
    absorption = np.array([[0.0], [2.0]])
    radial, moment, place = tally_radial(rows, absorption, 1.0, 2, 6, 10.0, 5)
    passed = np.array([1.0, np.exp(-1.0)])
    # Bins end at 1, 10^½, 10, 10^3/2, 100: within 1, between 10^½ and 10, and beyond 100.
    assert radial[0] == pytest.approx(np.outer(passed, [1, 0, 0, 0, 0, 1]))
    assert radial[1] == pytest.approx(np.outer(passed, [0, 0, 1, 0, 0, 0]))
    assert moment == pytest.approx(np.array([200.5 * passed, 5.0 * passed]))
    # Two squares of four share a ray that leaves beside the plane of incidence.
    assert place[0, 0, :, 2, 2] == pytest.approx(passed)
    assert place[0, 1, :, 3, 3] == pytest.approx(0.5 * passed)
    assert place[0, 1, :, 3, 1] == pytest.approx(0.5 * passed)
    assert place[0].sum() == pytest.approx(2.0 * passed.sum())
    assert place[1, 0, :, 2, 2] == pytest.approx(passed**2)
    assert place[1, 1, :, 3, 1] == pytest.approx(0.25 * passed**2)


@NEEDS_JIT
@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_profile_and_map_hold_the_reflectance(incidence):
    # Seeds of their own: instruments name their random streams alike.
    ds = splits.beam_spread(SNOW, [600.0, 1300.0], incidence, 150_000, half_width_m=0.05, seed=1)
    total = splits.spectrophotometer(SNOW, [600.0, 1300.0], incidence, max_stderr=0.0015, seed=2)
    straight = splits.goniophotometer(SNOW, [600.0, 1300.0], incidence, 50_000, seed=3)
    edges = 10.0 ** (np.log10(ds.radius.values[0]) + (np.arange(73) - 0.5) / 8.0)
    inside = (ds.profile * np.pi * np.diff(edges**2)).sum("radius")
    assert inside.values == pytest.approx(ds.fraction.values, rel=1e-3)
    z = []
    # Through 2 cm only visible light gets.
    for side, name, other, seen in (
        ("reflected", "reflectance", "specular_reflectance", 2),
        ("transmitted", "transmittance", "direct_transmittance", 1),
    ):
        share = ds.fraction.sel(side=side).values + straight[other]
        error = np.hypot(ds.fraction_stderr.sel(side=side), total[f"{name}_stderr"])
        error = np.hypot(error, straight[f"{other}_stderr"])
        z.extend(((share - total[name]) / error).values[:seen])
    judge_z(z, "beam spread against reflectance and transmittance", independent=1)
    cell = (0.1 / N_MAP_PIXELS) ** 2
    held = ds.profile_map.sum(("x", "y")) * cell
    assert (held <= ds.fraction + 1e-9).all()
    assert (held.sel(side="reflected") > 0.95 * ds.fraction.sel(side="reflected")).all()


@NEEDS_JIT
def test_a_normal_beam_spreads_evenly_and_an_oblique_one_forward():
    straight = splits.beam_spread(SNOW, [600.0], 0.0, 100_000, half_width_m=0.01)
    oblique = splits.beam_spread(SNOW, [600.0], 70.0, 100_000, half_width_m=0.01)

    def lean(ds):
        """Return the difference between the map's halves and its error."""
        first = ds.isel(wavelength=0).sel(side="reflected")
        sign = np.sign(first.x)
        value = float((first.profile_map * sign).sum())
        # Mirrored squares are one and the same measurement.
        return value / float(np.sqrt(2.0 * (first.profile_map_stderr**2).sum()))

    judge_z([lean(straight)], "a normal beam")
    assert lean(oblique) > 10.0
    for ds in (straight, oblique):
        assert np.allclose(ds.profile_map, ds.profile_map.values[..., ::-1])


@NEEDS_JIT
@pytest.mark.long
def test_radii_scale_with_the_sample():
    # Half the density and twice the depth: all ways are twice as long, where ice does not absorb
    # and grains are far apart.
    ice = {"ice": 1.31}
    common = {"saturation": 0.0, "refractive_index": ice}
    dense = splits.Snow(density_kg_m3=0.02, depth_m=100.0, **common)
    thin = splits.Snow(density_kg_m3=0.01, depth_m=200.0, **common)
    near, far = (
        splits.beam_spread(snow, [600.0], 30.0, 100_000, seed=seed)
        for seed, snow in enumerate((dense, thin))
    )
    z = []
    for name in ("quantile_radius", "mean_radius"):
        error = np.hypot(2.0 * near[f"{name}_stderr"], far[f"{name}_stderr"])
        z.extend(((far[name] - 2.0 * near[name]) / error).values.ravel())
    judge_z(z, "radii of similar samples", independent=1)


@NEEDS_JIT
@pytest.mark.long
def test_errors_are_those_of_repeated_runs():
    runs = [
        splits.beam_spread(SNOW, [900.0], 45.0, 10_000, seed=s, half_width_m=0.01)
        for s in range(200)
    ]
    for name in ("mean_radius", "quantile_radius", "fraction"):
        values, stated = ([run[f"{name}{end}"].values for run in runs] for end in ("", "_stderr"))
        judge_scatter(values, stated, name)


@NEEDS_JIT
def test_where_no_light_leaves_there_is_no_radius():
    ds = splits.beam_spread(splits.Snow(), [1450.0], 0.0, 8192)
    dark = ds.sel(side="transmitted")
    assert not dark.mean_radius.values.any() and not dark.quantile_radius.values.any()
    assert all(np.isfinite(ds[name]).all() for name in ds.data_vars)


@pytest.mark.filterwarnings("error")
def test_a_map_without_any_light_is_finite():
    ds = splits.beam_spread(splits.ParticleLayer(opaque=True), [550.0], rays=256)
    assert not ds.fraction.values.any()
    assert all(np.isfinite(ds[name]).all() for name in ds.data_vars)


@NEEDS_JIT
def test_bits_do_not_depend_on_threads():
    runs = [splits.beam_spread(SNOW, [600.0], 30.0, 20_000, threads=n) for n in (1, 2, 4)]
    for run in runs[1:]:
        assert all(np.array_equal(runs[0][name], run[name]) for name in run.data_vars)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("incidence_deg", 91.0, r"in \[0, 89.9999\] degrees"),
        ("rays", 0.5, "a whole number of at least 1"),
        ("half_width_m", 0.0, r"in \[1e-09, 1e\+06\] m"),
        ("kernel", "vector", "did you mean vectorized"),
        ("threads", 0, "a whole number of at least 1"),
    ],
)
def test_bad_values_are_refused_by_name(key, value, message):
    with pytest.raises(ValueError, match=message) as error:
        splits.beam_spread(SNOW, [600.0], **{key: value})
    assert str(error.value).startswith(f"{key} = ")
