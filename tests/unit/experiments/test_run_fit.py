"""Fits as experiments: the dataset, its table and its figure, and invalid input."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from experiment_jobs import start_jobs
from stated_errors import list_variables_with_errors

from splits import load, save
from splits.core.validation import ConfigError
from splits.experiments import load_experiment
from splits.experiments import run_fit as module
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.sections import Accuracy
from splits.experiments.run_fit import UNDETERMINED_VERDICT, make_fit_table
from splits.plotting import draw
from splits.retrieval.sand_fit import Effort

WAVELENGTHS = np.arange(400.0, 1001.0, 50.0)
TINY_EFFORT = Effort(points=2, starts=(1,), evaluations=(2,), rays=(32, 32), max_stderr=0.05)
EXPERIMENT_TEXT = """
medium: {kind: sand}
instrument: {incidence_deg: 10}
fit: {measured: mine.csv}
grid: {refractive_index: {as modelled: {}, goethite k / 2: {goethite: {k_factor: 0.5}}}}
figure: {kind: fit}
"""


@pytest.fixture
def experiment(tmp_path):
    measured = tmp_path / "measured" / "mine.csv"
    measured.parent.mkdir()
    table = pd.DataFrame({"wavelength_nm": WAVELENGTHS})
    for name, reflectance in (("dark", 0.1), ("bright", 0.5)):
        table[name] = reflectance + 2e-4 * (WAVELENGTHS - 400.0)
    table.to_csv(measured, index=False)
    path = tmp_path / "found.yaml"
    path.write_text(EXPERIMENT_TEXT, encoding="utf-8")
    return load_experiment(path, tmp_path / "media"), table


@NEEDS_JIT
def test_every_sample_is_fitted_at_every_point(experiment, monkeypatch, tmp_path):
    monkeypatch.setattr(module, "choose_effort", lambda _: TINY_EFFORT)
    settings, table = experiment
    lines = []
    ds = module.run_fit(settings, Accuracy(max_stderr=0.05), table, threads=1, log=lines.append)
    assert dict(ds.rmse.sizes) == {"refractive_index": 2, "sample": 2}
    np.testing.assert_array_equal(ds.measured.sel(sample="dark")[0], table.dark)
    deviation = ds.reflectance - ds.measured
    np.testing.assert_allclose(ds.rmse, np.sqrt((deviation**2).mean("wavelength")), rtol=1e-12)
    assert (ds.value_stderr >= 0.0).all()
    assert list_variables_with_errors(ds) == {"reflectance", "value", "rmse"}
    fractions = ["partition_pure", "partition_mixed", "partition_coated"]
    np.testing.assert_allclose(ds.value.sel(parameter=fractions).sum("parameter"), 1.0)
    np.testing.assert_allclose(ds.value.sel(parameter=["clay", "silt", "sand"]).sum("parameter"), 1)
    assert any("4/4 refractive_index=goethite k / 2 bright" in line for line in lines)
    save(ds, tmp_path / "found.nc")
    loaded = load(tmp_path / "found.nc")
    rows = make_fit_table(loaded)
    assert len(rows) == ds.value.size
    assert set(rows.verdict) <= {"constrained", UNDETERMINED_VERDICT}
    assert loaded.reflectance_batches.dims == ("refractive_index", "sample", "batch", "wavelength")
    square = (loaded.reflectance_batches.astype(float) ** 2).sum("batch")
    assert (square <= loaded.reflectance_stderr**2 * (1.0 + 1e-6)).all()
    figure = draw(loaded, settings.resolve_figure())
    assert len(figure.axes) == 4


def test_parameter_and_spectrum_verdicts_are_independent():
    fits = xr.Dataset(
        {
            "value": (("sample", "parameter"), np.full((2, 2), 0.01)),
            "value_stderr": (("sample", "parameter"), np.full((2, 2), 0.01)),
            "constrained": (("sample", "parameter"), [[0.0, 1.0], [1.0, 0.0]]),
            "rmse": ("sample", [0.01, 0.2]),
            "rmse_stderr": ("sample", [0.001, 0.001]),
        },
        {"sample": ["near", "far"], "parameter": ["iron_oxide", "clay"]},
    )
    rows = make_fit_table(fits).set_index(["sample", "parameter"])
    assert rows.verdict.to_dict() == {
        ("near", "iron_oxide"): UNDETERMINED_VERDICT,
        ("near", "clay"): "constrained",
        ("far", "iron_oxide"): "constrained",
        ("far", "clay"): UNDETERMINED_VERDICT,
    }
    assert (rows.spectrum["near"] == "reproduced").all()
    assert (rows.spectrum["far"] == "not reproduced").all()
    assert not rows.apply(lambda column: column.astype(str).str.contains("good")).to_numpy().any()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("fit: {measured: mine.csv, samples: [brigt]}", r"fit\.samples = 'brigt'.*mean bright"),
        ("fit: {measured: mine.csv}\nmedium: {kind: sand, iron_oxide: 0.01}", "iron_oxide"),
        ("fit: {measured: other.csv}", r"fit\.measured = 'other\.csv': must be one of mine\.csv"),
        ("fit: {measured: mine.csv, ranges: {iron: [0, 1]}}", "iron"),
        ("fit: {measured: mine.csv, ranges: {clay: [0.5, 0.1]}}", "clay"),
    ],
)
def test_invalid_fits_are_rejected(experiment, tmp_path, line, message):
    path = tmp_path / "wrong.yaml"
    text = (
        EXPERIMENT_TEXT.replace("medium: {kind: sand}\n", "")
        if "medium:" in line
        else EXPERIMENT_TEXT
    )
    path.write_text(text.replace("fit: {measured: mine.csv}", line), encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        start_jobs(path, tmp_path / "media")


def test_only_sand_is_fitted(experiment, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("fit: {measured: mine.csv}\nfigure: {kind: fit}\n", "utf-8")
    with pytest.raises(ConfigError, match=r"medium\.kind = 'snow'.*sand"):
        load_experiment(path, tmp_path / "media")


def test_an_unknown_sample_is_rejected(experiment):
    settings, table = experiment
    fit_section = settings.fit.model_copy(update={"samples": ("brigt",)})
    invalid = settings.model_copy(update={"fit": fit_section})
    with pytest.raises(ValueError, match=r"fit\.samples = 'brigt'.*did you mean bright"):
        module.run_fit(invalid, Accuracy(max_stderr=0.05), table)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ([8.0] * 13, r"dark at 400 nm\) = 8\.0.*not per cent"),
        ([np.nan] * 13, r"dark at 400 nm\) = nan"),
        (["x"] * 13, r"fit\.measured = '.*mine\.csv': must be .*line 2: dark is x"),
    ],
)
def test_invalid_measurements_are_rejected_before_the_run(experiment, tmp_path, column, message):
    table = experiment[1].assign(dark=column)
    table.to_csv(tmp_path / "measured" / "mine.csv", index=False)
    with pytest.raises(ConfigError, match=message):
        start_jobs(tmp_path / "found.yaml", tmp_path / "media")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r": fit\.measured = '.*mine\.csv': must be a CSV file .*it has no rows"),
        (
            "wavelength_nm,a\n1,2,3\n4,5,6,7\n",
            r": fit\.measured = '.*mine\.csv': must be a CSV file .*fields in line 2: 3",
        ),
        ("wavelength_nm,a\nblue,0.3\n", r"must be a CSV file .*line 2: wavelength_nm is blue"),
        ("wavelength_nm,a\n100,0.3\n", r": fit\.measured\.wavelength_nm = 100\.0: must be in"),
        ("wavelength_nm,a\n2600,0.3\n", r": fit\.measured\.wavelength_nm = 2600\.0: must be in"),
        ("wavelength_nm,a\n600,0.3\n", r": fit\.measured = '1 wavelengths': must be 9 at least"),
    ],
)
def test_tables_that_cannot_be_fitted_are_rejected(experiment, tmp_path, text, message):
    (tmp_path / "measured" / "mine.csv").write_text(text, "utf-8")
    with pytest.raises(ConfigError, match=message) as error:
        start_jobs(tmp_path / "found.yaml", tmp_path / "media")
    assert "\n" not in str(error.value)


def test_a_fit_is_the_same_after_a_round_trip(experiment):
    reloaded = ExperimentConfig.model_validate(experiment[0].dump_simulation())
    assert reloaded.dump_simulation() == experiment[0].dump_simulation()
    assert module.check_fit(reloaded, experiment[1]) == ["dark", "bright"]
