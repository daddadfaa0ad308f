"""Every kind of figure, medium and instrument, with a grid: from file to figure.

One experiment per kind of medium runs as jobs of the workflow; the others call the same functions
in one process, because a job spends seconds on importing libraries.
"""

import json

import numpy as np
import pandas as pd
import pytest
import yaml
from compliance import collect_remarks

import splits
from splits.core.atomic import atomic_write
from splits.experiments import ExperimentConfig, SimulationConfig, load_experiment, load_settings
from splits.experiments.run import run
from splits.plotting import draw
from splits.plotting.figure import FIGURES, list_instrument_figures
from splits.plotting.grammar import FIGURE_SUFFIXES

pytestmark = [pytest.mark.slow, pytest.mark.long]

SNOW = "medium: {base: splitsnow_table1, depth_m: 0.01}\n"
SAND = "medium: {kind: sand, depth_m: 0.01}\n"
STACK = (
    "medium: {kind: stack, ground: 0.3, interpretation: splits_2007, layers:"
    " [{base: splitsnow_table1, depth_m: 0.005},"
    " {kind: sand, depth_m: 0.004}]}\n"
)
LAYER = "medium: {kind: particle_layer, optical_thickness: 2}\n"
DEFAULT_LAYER = "medium: {kind: particle_layer}\n"
WAVES = (
    "medium: {kind: particle_layer, optical_thickness: 2, depth_m: 10, surface: {rms_height_m: 0.1,"
    " wave_number_per_m: 1, waves: 8, correlation: gaussian}}\n"
)
DAYLIGHT = "instrument: {wavelength_nm: {start: 400, stop: 780, step: 10}}\n"
TWO_VALUES = "grid: {saturation: {start: 0, stop: 0.1, step: 0.1}}\n"
SELECT_WET = "figure: {select: {saturation: 0.1}}\n"
LABELLED = "grid: {saturation: {dry: 0, damp: 0.1}}\n"
CASES = {
    "trip_snow_spectra": SNOW + "instrument: {wavelength_nm: [500, 1030, 1500]}\n"
    "grid: {saturation: {'0.1': 1.0, '1': 0.1}, incidence_deg: {beam: 60, sky: diffuse}}\n"
    "figure: {kind: spectra, select: {saturation: '0.1'}, quantity: [reflectance, absorptance]}\n",
    "trip_snow_points": SNOW + "instrument: {wavelength_nm: [500], estimator: analog}\n" + LABELLED
    + "figure: {kind: points, quantity: [transmittance, mean_grain_distance]}\n",
    "trip_snow_swatches": SNOW + DAYLIGHT + LABELLED + "figure: {kind: swatches}\n",
    "trip_snow_indices": SNOW + "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n"
    "grid: {saturation: [0.2]}\n",
    "trip_snow_plane": SNOW + "instrument: {kind: goniophotometer, wavelength_nm: [600, 1300]}\n"
    + TWO_VALUES + "figure: {select: {saturation: 0}, quantity: [brdf, btdf]}\n",
    "trip_snow_lobes": SNOW + "instrument: {kind: goniophotometer, wavelength_nm: [600]}\n"
    "grid: {saturation: [0, 0.1], incidence_deg: [0, 60]}\n"
    "figure: {kind: lobes, select: {incidence_deg: 60}}\n",
    "trip_snow_bins": SNOW + "instrument: {kind: goniophotometer, wavelength_nm: [600],"
    " estimator: bins, n_bins: [9, 18], rays: 20000}\n" + LABELLED
    + "figure: {kind: bins, select: {saturation: damp}}\n",
    "trip_snow_spread": SNOW + "instrument: {kind: beam_spread, wavelength_nm: [600],"
    " half_width_m: 0.01}\n" + TWO_VALUES + SELECT_WET,
    "trip_snow_return": SNOW + "instrument: {kind: time_of_flight, wavelength_nm: [600, 1300],"
    " rays: 5000, pulse: 1.0e-10, delay_s: [0, 1.0e-11, 1.0e-10, 1.0e-9]}\n" + TWO_VALUES,
    "trip_snow_range_bias": "medium: {kind: natural_snow, depth_m: .inf}\n"
    "instrument: {kind: time_of_flight, wavelength_nm: [1064], rays: 5000, delay_s: [0, 1.0e-9]}\n"
    "grid: {specific_surface_area_m2_kg: [20, 60]}\nfigure: {kind: range_bias}\n",
    "trip_snow_return_table": "medium: {kind: natural_snow, depth_m: .inf}\n"
    "instrument: {kind: return_table, wavelength_nm: [532, 1064], rays: 5000,"
    " delay_s: {start: 0, stop: 1.0e-9, step: 1.0e-10}}\n"
    "grid: {specific_surface_area_m2_kg: [20, 60]}\n",
    "trip_snow_ground": SNOW + "instrument: {wavelength_nm: [500, 800]}\n"
    "grid: {ground: {open: open, black: black, soil: camborthid, white: 1}}\n"
    "figure: {select: {ground: soil}, quantity: [reflectance, transmittance]}\n",
    "trip_snow_table": "medium: {kind: natural_snow, depth_m: 0.3}\n"
    "instrument: {kind: table, wavelength_nm: [500, 1030], covariance: keep,"
    " quantities: [reflectance, transmittance]}\n"
    "grid: {optical_radius_um: {geomspace: [50, 400, 3]}, ground: [0.2, 0.8],"
    " impurities_ng_g.black_carbon: [0, 100]}\n"
    "figure: {select: {ground: 0.2}, quantity: [reflectance, transmittance]}\n",
    "trip_views": "medium: {kind: natural_snow}\n"
    "instrument: {kind: table, wavelength_nm: [500, 1030], polar_deg: [0, 30],"
    " azimuth_deg: [0, 180], quantities: [reflectance, reflectance_factor,"
    " diffuse_anisotropy_factor]}\n"
    "grid: {optical_radius_um: [50, 200], incidence_deg: [0, 60]}\n"
    "figure: {quantity: [reflectance, reflectance_factor]}\n",
    "trip_ground_plane": SNOW + "instrument: {kind: goniophotometer, wavelength_nm: [600]}\n"
    "grid: {ground: [0.2, 0.8]}\n",
    "trip_ground_spread": SNOW + "instrument: {kind: beam_spread, wavelength_nm: [600], rays: 5000,"
    " half_width_m: 0.01}\ngrid: {ground: [0.5]}\nfigure: {select: {ground: 0.5}}\n",
    "trip_stack_spectra": STACK + "instrument: {wavelength_nm: [500, 1030]}\n"
    "grid: {layers.0.depth_m: [0.002, 0.004], layers.1.saturation: {dry: 0, wet: 0.1}}\n"
    "figure: {select: {layers.1.saturation: wet}}\n",
    "trip_stack_points": STACK.replace(" ground: 0.3,", "")
    + "instrument: {wavelength_nm: [500], incidence_deg: diffuse}\n"
    "grid: {ground: [0.2, 0.8]}\nfigure: {kind: points}\n",
    "trip_stack_plane": STACK + "instrument: {kind: goniophotometer, wavelength_nm: [600]}\n"
    "grid: {layers.0.depth_m: [0.002, 0.004]}\n",
    "trip_stack_lobes": STACK + "instrument: {kind: goniophotometer, wavelength_nm: [600]}\n"
    "grid: {medium: {pale: {ground: 1}, dark: {ground: 0.1}}}\nfigure: {kind: lobes}\n",
    "trip_stack_spread": STACK + "instrument: {kind: beam_spread, wavelength_nm: [600], rays: 5000,"
    " half_width_m: 0.01}\n",
    "trip_stack_particle_layer": "medium: {kind: stack, layers: [{kind: particle_layer,"
    " optical_thickness: 1, refractive_index: 1.31, depth_m: 0.01},"
    " {base: splitsnow_table1, depth_m: 0.005}]}\n"
    "instrument: {wavelength_nm: [500, 1030]}\ngrid: {layers.0.optical_thickness: [0.5, 2]}\n",
    "trip_sand_spectra": SAND + "instrument: {wavelength_nm: [500, 800]}\n"
    "grid: {medium: {pale: {iron_oxide: 0.001}, red: {hematite_ratio: 1}}}\n"
    "figure: {select: {medium: red}}\n",
    "trip_sand_swatches": SAND + DAYLIGHT + "grid: {iron_oxide: [0.001, 0.02]}\n"
    "figure: {kind: swatches}\n",
    "trip_sand_retrieved": SAND
    + "instrument: {kind: table, wavelength_nm: [500, 600, 700, 800, 900], incidence_deg: 8}\n"
    "grid: {iron_oxide: [0.001, 0.01], partition.coated: [0.1, 0.5, 0.9]}\n"
    "retrieve: {measured: sand_reflectance_jhu.csv, samples: [quartzipsamment_87P706],"
    " free: [iron_oxide, partition.coated]}\n",
    "trip_sand_plane": SAND + "instrument: {kind: goniophotometer, wavelength_nm: [600]}\n"
    + TWO_VALUES + SELECT_WET,
    "trip_sand_spread": SAND + "instrument: {kind: beam_spread, wavelength_nm: [600], rays: 5000,"
    " half_width_m: 0.01}\n" + TWO_VALUES + SELECT_WET,
    "trip_layer_spectra": LAYER + "instrument: {wavelength_nm: [500, 550]}\n"
    "grid: {polarized: [true, false], ground: [0.5, null]}\n"
    "figure: {kind: spectra, select: {polarized: true}}\n",
    "trip_layer_points": LAYER + "instrument: {wavelength_nm: [550]}\n"
    "grid: {asymmetry: {start: 0, stop: 0.8, step: 0.4}}\nfigure: {kind: points}\n",
    "trip_layer_next_event": DEFAULT_LAYER + "instrument: {kind: goniophotometer,"
    " wavelength_nm: [550], estimator: next_event, azimuth_deg: [0, 180], polar_deg: [0, 30, 60]}\n"
    "grid: {optical_thickness: [1, 2]}\nfigure: {select: {optical_thickness: 2}}\n",
    "trip_layer_polarization":
    "medium: {kind: particle_layer, polarized: true, phase_function: rayleigh}\n"
    "instrument: {kind: goniophotometer, wavelength_nm: [550], estimator: next_event,"
    " azimuth_deg: [0, 180], polar_deg: [0, 30, 60]}\n"
    "grid: {optical_thickness: [1, 2]}\nfigure: {kind: polarization}\n",
    "trip_layer_spread": DEFAULT_LAYER + "instrument: {kind: beam_spread, wavelength_nm: [550],"
    " rays: 5000, half_width_m: 1}\ngrid: {optical_thickness: [1, 2]}\n"
    "figure: {select: {optical_thickness: 2}}\n",
    "trip_waves_plane": WAVES + "instrument: {kind: goniophotometer, wavelength_nm: [550],"
    " estimator: bins, n_bins: [9, 18], rays: 5000}\n"
    "grid: {refractive_index: [1.3, 1.5]}\nfigure: {kind: principal_plane}\n",
    "trip_waves_surface": WAVES + "instrument: {kind: surface_map, half_width_m: 1}\n"
    "grid: {refractive_index: [1.3, 1.5]}\nfigure: {select: {refractive_index: 1.5}}\n",
    "trip_waves_lens": WAVES + "instrument: {kind: lens, radius_m: 0.1, screen_depth_m: [1, 2],"
    " half_width_m: 1}\n"
    "grid: {refractive_index: {ice: 1.3, glass: 1.5}}\n"
    "figure: {select: {refractive_index: glass}}\n",
}  # fmt: skip


RUN_AS_JOBS = (
    "trip_snow_spectra",
    "trip_sand_retrieved",
    "trip_layer_polarization",
    "trip_waves_lens",
)
"""One of each kind of medium, and a retrieval; jobs do not depend on the kind of experiment."""


def read_experiment(project, name):
    path = project.folder / "config" / "experiments" / f"{name}.yaml"
    return load_experiment(path, project.folder / "config" / "media")


def run_in_process(project, name, results):
    """Run the functions of the jobs of an experiment with their inputs, in one figure format."""
    content = yaml.safe_load((project.folder / "config" / "config.yaml").read_text())
    settings = load_settings(content)
    experiment = read_experiment(project, name)
    simulation, figure = json.loads(
        json.dumps([experiment.dump_simulation(), experiment.resolve_figure()])
    )
    accuracy = settings.accuracies["tiny"]
    dataset = run(SimulationConfig.model_validate(simulation), accuracy, settings.seed)
    path = results / "data" / f"{name}.nc"
    splits.save(dataset, path)
    figure = draw(splits.load(path), **figure)
    with atomic_write(results / "figures" / f"{name}.png") as aside:
        figure.savefig(aside)


@pytest.fixture(scope="module")
def finished(make_project, tmp_path_factory):
    """Return a project in which all cases have run at tiny accuracy, and the run of Snakemake."""
    project = make_project(tmp_path_factory.mktemp("round_trip"))
    for name in RUN_AS_JOBS:
        project.put(name, CASES[name])
    jobs = project.snakemake("--cores", 2, "--keep-going")
    for name in set(CASES) - set(RUN_AS_JOBS):
        project.put(name, CASES[name])
        run_in_process(project, name, project.folder / "results" / "tiny")
    return project, jobs


def test_cases_cover_all_kinds(finished):
    project, _ = finished
    experiments = [read_experiment(project, name) for name in CASES]
    # Albedos of snowpacks of a file are in test_season.
    kinds = {name for one in FIGURES.values() for name in one.instruments} - {"albedo"}
    assert {experiment.instrument.kind for experiment in experiments} == kinds
    assert {experiment.resolve_figure()["kind"] for experiment in experiments} >= {
        list_instrument_figures(kind)[0] for kind in kinds
    }


@pytest.mark.parametrize("name", CASES)
def test_experiment_file_gives_dataset_and_figure(finished, name):
    project, jobs = finished
    results = project.folder / "results" / "tiny"
    assert (results / "data" / f"{name}.nc").is_file(), jobs.text[-3000:]
    for suffix in FIGURE_SUFFIXES if name in RUN_AS_JOBS else FIGURE_SUFFIXES[:1]:
        assert (results / "figures" / f"{name}{suffix}").is_file(), jobs.text[-3000:]
    dataset = splits.load(results / "data" / f"{name}.nc")
    assert dataset.attrs["experiment"] == name
    for variable in dataset.data_vars.values():
        # NaN has a flag, such as that of the delay of light that no ray brings.
        is_explained = np.isfinite(variable)
        for other in variable.attrs.get("ancillary_variables", "").split():
            if "flag_meanings" in dataset[other].attrs:
                is_explained = is_explained | (dataset[other] != 0)
        assert is_explained.all()


def test_retrieval_writes_its_parameters(finished):
    project, jobs = finished
    path = project.folder / "results" / "tiny" / "tables" / "trip_sand_retrieved_retrieved.csv"
    assert path.is_file(), jobs.text[-3000:]
    table = pd.read_csv(path)
    assert set(table["sample"]) == {"quartzipsamment_87P706"}
    assert set(table["parameter"]) == {"iron_oxide", "partition.coated"}


@pytest.mark.parametrize("name", CASES)
def test_dataset_follows_the_cf_conventions(finished, name):
    project, _ = finished
    path = project.folder / "results" / "tiny" / "data" / f"{name}.nc"
    assert collect_remarks([path]) == {path: []}


@pytest.mark.parametrize("name", CASES)
def test_job_input_is_the_same_simulation(finished, name):
    project, _ = finished
    experiment = read_experiment(project, name)
    from_job = SimulationConfig.model_validate(experiment.dump_simulation())
    assert from_job.dump_simulation() == experiment.dump_simulation()
    assert isinstance(experiment, ExperimentConfig)
