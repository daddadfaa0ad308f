"""Key `instrument.solver` of experiment files."""

import re

import pytest
from chi2 import NEEDS_JIT
from experiment_jobs import start_jobs

from splits.core.validation import ConfigError
from splits.experiments import load_experiment
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.experiments.run_table import prepare_table

SNOW = "medium: {kind: natural_snow, specific_surface_area_m2_kg: 20, depth_m: 0.1}\n"
DEEP = "medium: {kind: natural_snow, specific_surface_area_m2_kg: 20}\n"
SPECTRUM = "instrument: {solver: SOLVER, wavelength_nm: [600, 1030]}\n"
DIRECTIONS = (
    "instrument: {kind: goniophotometer, solver: SOLVER, wavelength_nm: [600], "
    "polar_deg: [0, 50], azimuth_deg: [0, 180]}\n"
)
TABLE = "instrument: {kind: table, solver: SOLVER, parts: 2, wavelength_nm: [600, 1030]}\n"
WATER = "grid: {saturation: [0, 0.1]}\n"


def load_text(folder, text, solver="discrete_ordinates"):
    path = folder / "solver.yaml"
    path.write_text(text.replace("SOLVER", solver))
    return load_experiment(path, folder)


def start_text(folder, text, solver="discrete_ordinates"):
    path = folder / "solver.yaml"
    path.write_text(text.replace("SOLVER", solver))
    return start_jobs(path, folder)


def test_default_is_auto(tmp_path):
    for text in (SPECTRUM, DIRECTIONS, TABLE + WATER):
        experiment = load_text(tmp_path, SNOW + text.replace("solver: SOLVER, ", ""))
        assert experiment.instrument.get("solver") == "auto"


@pytest.mark.parametrize("medium", [SNOW, DEEP])
@pytest.mark.parametrize("instrument", [SPECTRUM, DIRECTIONS, TABLE])
@pytest.mark.parametrize("solver", ["discrete_ordinates", "auto"])
def test_experiments_run_by_discrete_ordinates(tmp_path, medium, instrument, solver):
    grid = "grid: {density_kg_m3: [100, 300]}\n"
    experiment = load_text(tmp_path, medium + instrument + grid, solver)
    dataset = run(experiment, Accuracy(max_stderr=0.01, relative_stderr=0.05, max_rays=None))
    name = "brdf" if instrument is DIRECTIONS else "reflectance"
    assert dataset[name].sizes["density_kg_m3"] == 2
    assert (dataset[name] > 0.0).all()
    assert ("btdf" in dataset) == (instrument is DIRECTIONS)
    assert dataset.attrs["rays"] == 0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("medium: {kind: sand}\n" + SPECTRUM, "no equation of radiative transfer"),
        (SNOW + SPECTRUM + "grid: {saturation: [0, 0.6]}\n", "has a saturation of 0.6"),
        (SNOW + SPECTRUM.replace("1030]", "3000]"), "at 3000 nm"),
        (
            SNOW + SPECTRUM.replace("wave", "estimator: analog, wave"),
            "the estimator analog needs paths",
        ),
        ("medium: {kind: sand}\n" + TABLE + WATER, "has overlap_with_boundary"),
        (SNOW + TABLE + "grid: {saturation: [0, 0.6]}\n", "has a saturation of 0.6"),
        (
            SNOW + TABLE.replace("parts", "covariance: keep, parts") + WATER,
            "a covariance needs batches",
        ),
        (SNOW + DIRECTIONS + "grid: {saturation: [0, 0.6]}\n", "has a saturation of 0.6"),
        (SNOW + DIRECTIONS.replace("polar", "rays: 1000, polar"), "a number of rays needs paths"),
    ],
)
def test_refusals_name_the_line_and_the_key(tmp_path, text, reason):
    with pytest.raises(ConfigError) as error:
        start_text(tmp_path, text)
    pattern = r".*solver\.yaml, line 2: instrument\.solver = 'discrete_ordinates': .*"
    assert re.fullmatch(pattern + re.escape(reason) + ".*", str(error.value)), str(error.value)


def test_transmitted_directions_of_dry_and_wet_snow_run(tmp_path):
    text = SNOW + DIRECTIONS.replace("polar", "target: btdf, polar") + WATER
    experiment = load_text(tmp_path, text + "figure: {select: {saturation: 0}, quantity: btdf}\n")
    lines: list[str] = []
    accuracy = Accuracy(max_stderr=0.01, relative_stderr=0.05, max_rays=None)
    dataset = run(experiment, accuracy, log=lines.append)
    assert all(": done, discrete ordinates, error 0.0" in line for line in lines)
    assert dataset.attrs["rays"] == 0
    assert (dataset.btdf > 0.0).all() and dataset.btdf.sizes["saturation"] == 2


@NEEDS_JIT
@pytest.mark.slow
def test_directions_of_one_grid_have_the_solver_of_each_point(tmp_path):
    text = SNOW.replace("0.1", "0.002") + DIRECTIONS + "grid: {saturation: [0, 0.6]}\n"
    experiment = load_text(tmp_path, text, "auto")
    dataset = run(experiment, Accuracy(max_stderr=0.01, relative_stderr=0.2, max_rays=None))
    assert dataset.attrs["rays"] > 0
    assert (dataset.btdf > 0.0).all()


def test_semi_infinite_snow_has_no_brdf_by_paths(tmp_path):
    with pytest.raises(ConfigError, match=r"medium\.depth_m.*solver discrete_ordinates"):
        start_text(tmp_path, DEEP + DIRECTIONS, "monte_carlo")


def test_parts_of_a_table_hold_all_angles_of_a_medium(tmp_path):
    grid = "grid: {incidence_deg: [0, 30, 60], density_kg_m3: [100, 200, 300]}\n"
    accuracy = Accuracy(max_stderr=0.01, relative_stderr=0.05, max_rays=None)
    for solver, n_media in (("discrete_ordinates", [2, 1]), ("monte_carlo", [3, 3])):
        experiment = load_text(tmp_path, SNOW + TABLE + grid, solver)
        plan = prepare_table(experiment, accuracy, 1)
        parts = [plan.select_part(part, 2) for part in range(2)]
        assert [len({id(one.path_sharing) for one in groups}) for groups in parts] == n_media
        found = [id(one) for groups in parts for one in groups]
        assert sorted(found) == sorted(map(id, plan.path_groups)) and len(found) == 9
