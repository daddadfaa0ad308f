"""Spread of a narrow beam: tallies, totals, symmetry, scaling, stated errors."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_scatter, judge_z

import splits
from splits.instruments.beam_spread import N_MAP_PIXELS
from splits.kernels.tallies.distributions import tally_radial
from splits.kernels.tallies.exits import (
    EXIT_DIRECTION,
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_POSITION,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)

pytestmark = pytest.mark.long

SNOW = splits.Snow(depth_m=0.02)


def test_exits_are_tallied_by_radius_and_pixel():
    rows = allocate_exits(4, 1)
    rows[:, EXIT_SIDE] = [0, 1, 0, 0]
    rows[:, EXIT_ORDER] = [1, 2, 0, 7]
    rows[:, EXIT_WEIGHT] = 1.0
    rows[:, EXIT_DIRECTION : EXIT_DIRECTION + 3] = [0.0, 0.0, 1.0]
    rows[:, EXIT_POSITION : EXIT_POSITION + 2] = [[0.0, 0.5], [3.0, 4.0], [0.0, 0.0], [200.0, 0.0]]
    rows[:, EXIT_LENGTH] = 0.5
    absorption = np.array([[0.0], [2.0]])
    radial, moment, pixel_map = tally_radial(rows, absorption, 1.0, 2, 6, 10.0, 5)
    attenuated = np.array([1.0, np.exp(-1.0)])
    # Bins end at 1, 10^½, 10, 10^3/2, 100: rays lie within 1, between 10^½ and 10, above 100.
    assert radial[0] == pytest.approx(np.outer(attenuated, [1, 0, 0, 0, 0, 1]))
    assert radial[1] == pytest.approx(np.outer(attenuated, [0, 0, 1, 0, 0, 0]))
    assert moment == pytest.approx(np.array([200.5 * attenuated, 5.0 * attenuated]))
    # A ray that exits beside the plane of incidence is divided between two mirrored pixels.
    assert pixel_map[0, 0, :, 2, 2] == pytest.approx(attenuated)
    assert pixel_map[0, 1, :, 3, 3] == pytest.approx(0.5 * attenuated)
    assert pixel_map[0, 1, :, 3, 1] == pytest.approx(0.5 * attenuated)
    assert pixel_map[0].sum() == pytest.approx(2.0 * attenuated.sum())
    assert pixel_map[1, 0, :, 2, 2] == pytest.approx(attenuated**2)
    assert pixel_map[1, 1, :, 3, 1] == pytest.approx(0.25 * attenuated**2)


@NEEDS_JIT
@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_profile_and_map_integrate_to_the_reflectance(incidence):
    # Instruments number their random streams alike, so their seeds differ.
    ds = splits.beam_spread(SNOW, [600.0, 1300.0], incidence, 150_000, half_width_m=0.05, seed=1)
    total = splits.spectrophotometer(SNOW, [600.0, 1300.0], incidence, max_stderr=0.0015, seed=2)
    unscattered = splits.goniophotometer(SNOW, [600.0, 1300.0], incidence, 50_000, seed=3)
    edges = 10.0 ** (np.log10(ds.radius.values[0]) + (np.arange(73) - 0.5) / 8.0)
    inside = (ds.profile * np.pi * np.diff(edges**2)).sum("radius")
    assert inside.values == pytest.approx(ds.fraction.values, rel=1e-3)
    z = []
    # Only visible light is transmitted by 2 cm.
    for side, name, other, n_wavelengths in (
        ("reflected", "reflectance", "specular_reflectance", 2),
        ("transmitted", "transmittance", "direct_transmittance", 1),
    ):
        fraction = ds.fraction.sel(side=side).values + unscattered[other]
        error = np.hypot(ds.fraction_stderr.sel(side=side), total[f"{name}_stderr"])
        error = np.hypot(error, unscattered[f"{other}_stderr"])
        z.extend(((fraction - total[name]) / error).values[:n_wavelengths])
    judge_z(z, "beam spread against reflectance and transmittance", independent=1)
    pixel_area = (0.1 / N_MAP_PIXELS) ** 2
    map_fraction = ds.profile_map.sum(("x", "y")) * pixel_area
    assert (map_fraction <= ds.fraction + 1e-9).all()
    assert (map_fraction.sel(side="reflected") > 0.95 * ds.fraction.sel(side="reflected")).all()


@NEEDS_JIT
def test_oblique_beam_spreads_forward():
    normal = splits.beam_spread(SNOW, [600.0], 0.0, 100_000, half_width_m=0.01)
    oblique = splits.beam_spread(SNOW, [600.0], 70.0, 100_000, half_width_m=0.01)

    def compute_asymmetry(ds):
        """Return the difference between the halves of the map in units of its error."""
        first = ds.isel(wavelength=0).sel(side="reflected")
        sign = np.sign(first.x)
        value = float((first.profile_map * sign).sum())
        # Mirrored pixels hold the same estimate.
        return value / float(np.sqrt(2.0 * (first.profile_map_stderr**2).sum()))

    judge_z([compute_asymmetry(normal)], "a normal beam")
    assert compute_asymmetry(oblique) > 10.0
    for ds in (normal, oblique):
        assert np.allclose(ds.profile_map, ds.profile_map.values[..., ::-1])


@NEEDS_JIT
@pytest.mark.long
def test_radii_scale_with_density_and_depth():
    # At half the density and twice the depth all paths are twice as long, without absorption and
    # with sparse grains.
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
def test_stated_errors_agree_with_scatter():
    runs = [
        splits.beam_spread(SNOW, [900.0], 45.0, 10_000, seed=s, half_width_m=0.01)
        for s in range(200)
    ]
    for name in ("mean_radius", "quantile_radius", "fraction"):
        values, stated = ([run[f"{name}{end}"].values for run in runs] for end in ("", "_stderr"))
        judge_scatter(values, stated, name)


@NEEDS_JIT
def test_radius_is_zero_without_exiting_light():
    ds = splits.beam_spread(splits.Snow(), [1450.0], 0.0, 8192)
    transmitted = ds.sel(side="transmitted")
    assert not transmitted.mean_radius.values.any() and not transmitted.quantile_radius.values.any()
    assert all(np.isfinite(ds[name]).all() for name in ds.data_vars)


@pytest.mark.filterwarnings("error")
def test_map_without_light_is_finite():
    ds = splits.beam_spread(splits.ParticleLayer(opaque=True), [550.0], rays=256)
    assert not ds.fraction.values.any()
    assert all(np.isfinite(ds[name]).all() for name in ds.data_vars)


@NEEDS_JIT
def test_results_are_independent_of_threads():
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
def test_invalid_values_are_rejected_by_name(key, value, message):
    with pytest.raises(ValueError, match=message) as error:
        splits.beam_spread(SNOW, [600.0], **{key: value})
    assert str(error.value).startswith(f"{key} = ")
