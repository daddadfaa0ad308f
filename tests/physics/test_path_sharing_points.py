"""Grid points that share paths: one ensemble, and agreement with single runs."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_z_bound

import splits
from splits.experiments.config.accuracy import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run import run
from splits.experiments.run_points import simulate_points

pytestmark = NEEDS_JIT
ERROR = 0.01
WAVELENGTHS = [500.0, 1030.0, 1300.0]
SIZES = [5.0, 20.0]
SOOT = [0.0, 200.0]


def make_config(**changes):
    return SimulationConfig.model_validate(
        {
            "name": "deep",
            "medium": {"kind": "natural_snow", "density_kg_m3": 300},
            "instrument": {"wavelength_nm": WAVELENGTHS, "solver": "monte_carlo"},
            "grid": {
                "specific_surface_area_m2_kg": SIZES,
                "incidence_deg": [0, 60],
                "impurities_ng_g.black_carbon": SOOT,
            },
            **changes,
        }
    )


ACCURACY = Accuracy(max_stderr=ERROR, relative_stderr=0.2)


@pytest.fixture(scope="module")
def shared_run():
    lines = []
    dataset = run(make_config(), ACCURACY, seed=5, threads=2, log=lines.append)
    return dataset, lines


def test_paths_are_traced_once_per_incidence(shared_run):
    dataset, lines = shared_run
    assert lines[0] == "deep: 2 sets of paths for 8 points"
    rays = dataset.rays.values
    assert (rays == rays[0, :, 0][np.newaxis, :, np.newaxis]).all()
    assert dataset.attrs["rays"] == rays[0, :, 0].sum()
    assert dataset.attrs["max_stderr_reached"] <= ERROR


def test_points_agree_with_single_runs(shared_run):
    dataset, _ = shared_run
    z = []
    for area in SIZES:
        for incidence in (0.0, 60.0):
            for soot in SOOT:
                snow = splits.Snow.natural(
                    specific_surface_area_m2_kg=area,
                    density_kg_m3=300,
                    impurities_ng_g={"black_carbon": soot} if soot else {},
                )
                single = splits.spectrophotometer(
                    snow, WAVELENGTHS, incidence, ERROR / 3, seed=77, solver="monte_carlo"
                )
                shared = dataset.sel(
                    {"specific_surface_area_m2_kg": area, "impurities_ng_g.black_carbon": soot}
                ).isel(incidence_deg=int(incidence > 0))
                difference = shared.reflectance.values - single.reflectance.values
                z += list(
                    difference / np.hypot(shared.reflectance_stderr, single.reflectance_stderr)
                )
    z = np.array(z)
    # Points of one ensemble are correlated.
    print(f"{z.size} values against single runs: rms z {np.sqrt((z**2).mean()):.2f}")
    assert np.abs(z).max() < compute_z_bound(z.size)


def test_single_point_equals_the_instrument(shared_run):
    snow = {"kind": "natural_snow", "density_kg_m3": 300, "specific_surface_area_m2_kg": 20}
    config = make_config(medium=snow, grid={"depth_m": [0.02, 0.05]})
    points = simulate_points(config, ACCURACY, 5, 2, lambda line: None)
    medium = splits.Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=300, depth_m=0.05)
    reference = splits.spectrophotometer(
        medium, WAVELENGTHS, 0.0, ERROR, seed=5, solver="monte_carlo"
    )
    np.testing.assert_array_equal(points.datasets[1].reflectance, reference.reflectance)
    assert points.rays == sum(ds.attrs["rays"] for ds in points.datasets)


def test_datasets_have_equal_structure_with_and_without_sharing(shared_run):
    shared = simulate_points(make_config(), ACCURACY, 5, 2, lambda line: None).datasets[0]
    single = splits.spectrophotometer(
        splits.Snow.natural(specific_surface_area_m2_kg=5, density_kg_m3=300), WAVELENGTHS,
        max_stderr=ERROR, solver="monte_carlo",
    )  # fmt: skip
    assert set(shared.data_vars) == set(single.data_vars)
    attributes = [
        {key for key in dataset.attrs if not key.startswith("snow_")}
        for dataset in (shared, single)
    ]
    assert attributes[0] == attributes[1]
    for name in single.data_vars:
        assert (shared[name].dims, shared[name].attrs) == (single[name].dims, single[name].attrs)


def test_optically_equal_points_keep_their_attributes():
    """An impurity of which there is none has no effect."""
    equal = {"a": {}, "b": {"impurities_ng_g": {"black_carbon": 0}}}
    snow = {"kind": "natural_snow", "specific_surface_area_m2_kg": 20}
    dataset = run(make_config(medium=snow, grid={"medium": equal}), ACCURACY, seed=5, threads=2)
    assert dataset.attrs["snow_specific_surface_area_m2_kg"] == pytest.approx(20.0)
    np.testing.assert_array_equal(dataset.reflectance[0], dataset.reflectance[1])


def test_polarization_is_traced_along_shared_paths():
    """It changes the path of light, and the incident light of each point has a Stokes vector."""
    snow = {"kind": "natural_snow", "density_kg_m3": 300}
    spectra = []
    for stokes in (False, True):
        instrument = {"wavelength_nm": [1310], "solver": "monte_carlo", "stokes": stokes}
        grid = {"specific_surface_area_m2_kg": [10, 20]}
        config = make_config(medium=snow, grid=grid, instrument=instrument)
        points, rays = simulate_points(config, ACCURACY, 5, 2, lambda line: None)
        assert rays == points[0].attrs["rays"] == points[1].attrs["rays"]
        assert all(("incident_stokes" in point.attrs) == stokes for point in points)
        spectra.append([float(point.reflectance[0]) for point in points])
    assert (np.diff(spectra, axis=0) != 0.0).all()
