"""Requested errors that experiments do not reach: one line in the log, and no other warning."""

import warnings

import pytest

from splits.experiments.config.load import load_experiment
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run import run

EXPERIMENTS = {
    "points that share paths": "medium: {kind: particle_layer, optical_thickness: 1}\n"
    "instrument: {wavelength_nm: [500], solver: monte_carlo}\n"
    "grid: {ground: [0.1, 0.2]}\n",
    "points": "medium: {kind: particle_layer}\n"
    "instrument: {wavelength_nm: [500], solver: monte_carlo}\n"
    "grid: {optical_thickness: [1, 2]}\n",
    "table": "medium: {kind: particle_layer}\n"
    "instrument: {kind: table, wavelength_nm: [500], solver: monte_carlo}\n"
    "grid: {optical_thickness: [1, 2]}\nfigure: {kind: none}\n",
    "ordinates": "medium: {kind: natural_snow, optical_radius_um: 100, depth_m: 0.1}\n"
    "instrument: {wavelength_nm: [500], solver: discrete_ordinates}\n",
}


@pytest.mark.parametrize("text", EXPERIMENTS.values(), ids=EXPERIMENTS)
def test_a_missed_error_is_logged_once(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    loaded = load_experiment(path, tmp_path)
    experiment = SimulationConfig.model_validate(loaded.dump_simulation())
    for max_stderr, n_warnings in ((1e-6, 1), (0.5, 0)):
        lines = []
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            accuracy = Accuracy(max_stderr=max_stderr, max_rays=1)
            dataset = run(experiment, accuracy, threads=1, log=lines.append)
        found = [line for line in lines if "note:" in line]
        assert len(found) == n_warnings
        for line in found:
            reached = dataset.attrs["max_stderr_reached"]
            assert line.startswith(f"mine: note: the largest standard error is {reached:.3g}, ")
            assert f"max_stderr = {max_stderr:g}; " in line
