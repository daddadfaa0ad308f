"""Points of a grid that need the same paths: one ensemble, and the answers of each alone."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_z_bound

import splits
from splits.experiments.config.settings import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run import run
from splits.experiments.run_points import simulate_points

pytestmark = NEEDS_JIT
ERROR = 0.01
WAVELENGTHS = [500.0, 1030.0, 1300.0]
SIZES = [5.0, 20.0]
SOOT = [0.0, 200.0]


def experiment(**changes):
    return SimulationConfig.model_validate(
        {
            "name": "deep",
            "medium": {"kind": "natural_snow", "density_kg_m3": 300},
            "instrument": {"wavelength_nm": WAVELENGTHS},
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
def together():
    lines = []
    found = run(experiment(), ACCURACY, seed=5, threads=2, log=lines.append)
    return found, lines


def test_paths_are_traced_once_for_each_incidence(together):
    found, lines = together
    assert lines[0] == "deep: 2 sets of paths for 8 points"
    served = found.rays.values
    assert (served == served[0, :, 0][np.newaxis, :, np.newaxis]).all()
    assert found.attrs["rays"] == served[0, :, 0].sum()
    assert found.attrs["max_stderr_reached"] <= ERROR


def test_each_point_is_what_it_is_alone(together):
    found, _ = together
    z = []
    for area in SIZES:
        for beam in (0.0, 60.0):
            for soot in SOOT:
                snow = splits.Snow.natural(
                    specific_surface_area_m2_kg=area,
                    density_kg_m3=300,
                    impurities_ng_g={"black_carbon": soot} if soot else {},
                )
                alone = splits.spectrophotometer(snow, WAVELENGTHS, beam, ERROR / 3, seed=77)
                here = found.sel(
                    {"specific_surface_area_m2_kg": area, "impurities_ng_g.black_carbon": soot}
                ).isel(incidence_deg=int(beam > 0))
                off = here.reflectance.values - alone.reflectance.values
                z += list(off / np.hypot(here.reflectance_stderr, alone.reflectance_stderr))
    z = np.array(z)
    # Points of one ensemble are off together.
    print(f"{z.size} values against runs of their own: rms z {np.sqrt((z**2).mean()):.2f}")
    assert np.abs(z).max() < compute_z_bound(z.size)


def test_a_point_by_itself_is_measured_as_the_instrument_does(together):
    snow = {"kind": "natural_snow", "density_kg_m3": 300, "specific_surface_area_m2_kg": 20}
    alone = experiment(medium=snow, grid={"depth_m": [0.02, 0.05]})
    found = simulate_points(alone, ACCURACY, 5, 2, lambda line: None)
    one = splits.Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=300, depth_m=0.05)
    ds = splits.spectrophotometer(one, WAVELENGTHS, 0.0, ERROR, seed=5)
    np.testing.assert_array_equal(found.datasets[1].reflectance, ds.reflectance)
    assert found.rays == sum(one.attrs["rays"] for one in found.datasets)


def test_datasets_look_alike_however_they_were_measured(together):
    shared = simulate_points(experiment(), ACCURACY, 5, 2, lambda line: None).datasets[0]
    alone = splits.spectrophotometer(
        splits.Snow.natural(specific_surface_area_m2_kg=5, density_kg_m3=300), WAVELENGTHS,
        max_stderr=ERROR,
    )  # fmt: skip
    assert set(shared.data_vars) == set(alone.data_vars)
    own = [{key for key in one.attrs if not key.startswith("snow_")} for one in (shared, alone)]
    assert own[0] == own[1]
    for name in alone.data_vars:
        assert (shared[name].dims, shared[name].attrs) == (alone[name].dims, alone[name].attrs)


def test_points_that_are_the_same_to_light_keep_what_is_theirs():
    """Below a pack without end the ground does not matter."""
    grounds = {"a": {"ground": 0.1}, "b": {"ground": 0.9}}
    snow = {"kind": "natural_snow", "specific_surface_area_m2_kg": 20}
    found = run(experiment(medium=snow, grid={"medium": grounds}), ACCURACY, seed=5, threads=2)
    assert "snow_ground" not in found.attrs
    assert found.attrs["snow_specific_surface_area_m2_kg"] == pytest.approx(20.0)
    np.testing.assert_array_equal(found.reflectance[0], found.reflectance[1])
