"""Key `instrument.solver` of experiment files."""

from __future__ import annotations

import re

import pytest

from splits.core.yaml import ConfigError
from splits.experiments import load_experiment
from splits.experiments.config.accuracy import Accuracy
from splits.experiments.run import run

SNOW = "medium: {kind: natural_snow, specific_surface_area_m2_kg: 20, depth_m: 0.1}\n"
DEEP = "medium: {kind: natural_snow, specific_surface_area_m2_kg: 20}\n"
SPECTRUM = "instrument: {solver: SOLVER, wavelength_nm: [600, 1030]}\n"
DIRECTIONS = (
    "instrument: {kind: goniophotometer, solver: SOLVER, wavelength_nm: [600], "
    "polar_deg: [0, 50], azimuth_deg: [0, 180]}\n"
)
WATER = "grid: {saturation: [0, 0.1]}\n"


def load_text(folder, text, solver="discrete_ordinates"):
    path = folder / "solver.yaml"
    path.write_text(text.replace("SOLVER", solver))
    return load_experiment(path, folder)


def test_paths_are_the_default(tmp_path):
    for text in (SPECTRUM, DIRECTIONS):
        experiment = load_text(tmp_path, SNOW + text.replace("solver: SOLVER, ", ""))
        assert experiment.instrument.solver == "monte_carlo"


@pytest.mark.parametrize("medium", [SNOW, DEEP])
@pytest.mark.parametrize("instrument", [SPECTRUM, DIRECTIONS])
@pytest.mark.parametrize("solver", ["discrete_ordinates", "auto"])
def test_experiments_run_by_discrete_ordinates(tmp_path, medium, instrument, solver):
    grid = "grid: {density_kg_m3: [100, 300]}\n"
    experiment = load_text(tmp_path, medium + instrument + grid, solver)
    dataset = run(experiment, Accuracy(max_stderr=0.01, relative_stderr=0.05, max_rays=None))
    name = "brdf" if instrument is DIRECTIONS else "reflectance"
    assert dataset[name].sizes["density_kg_m3"] == 2
    assert (dataset[name] > 0.0).all() and "btdf" not in dataset
    assert dataset.attrs["rays"] == 0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("medium: {kind: sand}\n" + SPECTRUM, "no equation of radiative transfer"),
        (SNOW + SPECTRUM + "grid: {saturation: [0, 0.6]}\n", "has a saturation of 0.6"),
        (SNOW + SPECTRUM.replace("1030]", "3000]"), "at 3000 nm"),
        (SNOW + SPECTRUM.replace("wave", "estimator: analog, wave"), "the estimator needs paths"),
        (SNOW + DIRECTIONS + WATER, "the BRDF of wet snow needs paths"),
        (SNOW + DIRECTIONS.replace("polar", "target: btdf, polar"), "the BTDF needs paths"),
        (SNOW + DIRECTIONS.replace("polar", "rays: 1000, polar"), "a number of rays needs paths"),
    ],
)
def test_refusals_name_the_line_and_the_key(tmp_path, text, reason):
    with pytest.raises(ConfigError) as error:
        load_text(tmp_path, text)
    pattern = r".*solver\.yaml, line 2: instrument\.solver = 'discrete_ordinates': .*"
    assert re.fullmatch(pattern + re.escape(reason) + ".*", str(error.value)), str(error.value)


def test_directions_of_one_grid_have_one_solver(tmp_path):
    with pytest.raises(ConfigError, match=r"instrument\.solver = 'auto'.*only paths give a BTDF"):
        load_text(tmp_path, SNOW + DIRECTIONS + WATER, "auto")
    figure = "figure: {quantity: btdf}\n"
    with pytest.raises(ConfigError, match=r"figure\.quantity"):
        load_text(tmp_path, SNOW + DIRECTIONS + figure)


def test_semi_infinite_snow_has_no_brdf_by_paths(tmp_path):
    with pytest.raises(ConfigError, match=r"medium\.depth_m"):
        load_text(tmp_path, DEEP + DIRECTIONS, "monte_carlo")
