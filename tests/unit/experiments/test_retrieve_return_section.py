"""The section `retrieve_return`: validation, synthetic and measured returns, table and figure."""

import numpy as np
import pandas as pd
import pytest
import yaml

import splits
from splits import cli
from splits.core.validation import ConfigError, InvalidValue
from splits.experiments import SimulationConfig, load_experiment
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.experiments.run_retrieve import (
    retrieve_samples,
    select_returns,
    simulate_returns,
    write_return_retrieval,
)

AREA, DENSITY = "specific_surface_area_m2_kg", "density_kg_m3"
STEP_S = 1e-10
SECTION = {
    "free": [AREA, "scale"],
    "fixed": {DENSITY: 350.0},
    "pulse": 3e-10,
    "photons": 20_000,
    "synthetic": {
        "delay_s": {"start": -2e-10, "stop": 1e-9, "step": STEP_S},
        "rays": 20_000,
        "truth": {"fine": {AREA: 30.0, "scale": 1.5}, "coarse": {AREA: 12.0}},
    },
}
EXPERIMENT = {
    "medium": {"kind": "natural_snow", "depth_m": float("inf")},
    "instrument": {
        "kind": "return_table", "wavelength_nm": [532, 1064], "rays": 5000,
        "delay_s": {"start": 0.0, "stop": 2e-9, "step": 5e-11},
    },
    "grid": {AREA: [8, 16, 32, 64], DENSITY: [250, 350]},
    "retrieve_return": SECTION,
}  # fmt: skip
FROM_FILE = {key: value for key, value in SECTION.items() if key != "synthetic"}
FROM_FILE |= {"measured": "returns.csv"}


def write_experiment(folder, content, name="returned"):
    """Return the path of an experiment file."""
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def write_measured(folder, samples, edges, wavelengths=(532.0, 1064.0)):
    """Write a file of measured returns, values by column over wavelengths and bins."""
    bins = {
        "wavelength_nm": np.repeat(wavelengths, len(edges) - 1),
        "delay_start_s": np.tile(edges[:-1], len(wavelengths)),
        "delay_end_s": np.tile(edges[1:], len(wavelengths)),
    }
    columns = {name: np.ravel(values) for name, values in samples.items()}
    (folder / "measured").mkdir(exist_ok=True)
    pd.DataFrame(bins | columns).to_csv(folder / "measured" / "returns.csv", index=False)


def load(folder, content):
    """Return the experiment of some content, with the measured files of the folder."""
    return load_experiment(write_experiment(folder, content), folder / "media")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("returns")


@pytest.fixture(scope="module")
def experiment(folder):
    return load(folder, EXPERIMENT)


@pytest.fixture(scope="module")
def table(experiment):
    """Return the dataset of the experiment."""
    simulation = SimulationConfig.model_validate(experiment.dump_simulation())
    return run(simulation, Accuracy(max_stderr=0.05, relative_stderr=0.3))


@pytest.fixture(scope="module")
def returns(experiment):
    return simulate_returns(experiment, experiment.retrieve_return, seed=1)


def test_datasets_are_tables_of_returns(experiment, table):
    """An experiment has the values of the function, which accepts its dataset."""
    expected = splits.build_table(
        splits.Snow.natural, {AREA: [16.0], DENSITY: [250.0]}, [532, 1064], rays=5000,
        delay_s=experiment.instrument.get("delay_s"),
    ).dataset  # fmt: skip
    point = table.sel({AREA: [16.0], DENSITY: [250.0]})
    for name in ("return_rate", "return_rate_stderr", "delay_bounds"):
        np.testing.assert_allclose(point[name], expected[name], rtol=1e-12)
    assert table.attrs["title"] == expected.attrs["title"]


def test_known_media_are_retrieved_within_errors(experiment, table, returns):
    lines = []
    found = retrieve_samples(experiment.retrieve_return, table, returns, log=lines.append)
    assert [one.sample for one in found] == ["fine", "coarse"]
    truth = experiment.retrieve_return.list_references()
    assert truth == {AREA: {"fine": 30.0, "coarse": 12.0}, "scale": {"fine": 1.5, "coarse": 1.0}}
    for one in found:
        for name, value in one.result.values.items():
            assert abs(value - truth[name][one.sample]) < 4.0 * one.result.stderr[name]
    assert any(line.startswith(f"fine: {AREA} ") and "reference 30" in line for line in lines)


@pytest.mark.parametrize("counts", [True, False])
def test_measured_returns_have_the_same_results(folder, experiment, table, returns, counts):
    """A file of counted photons, or of light per time with its errors."""
    section = dict(FROM_FILE, samples=["coarse"])
    one_photon = 1.0 / (SECTION["photons"] * STEP_S)
    samples = {name: one[0][1] / (one_photon if counts else 1.0) for name, one in returns.items()}
    if not counts:
        del section["photons"]
        samples["coarse_stderr"] = np.sqrt(np.maximum(returns["coarse"][0][1] * one_photon, 1e15))
    write_measured(folder, samples, returns["fine"][0][0])
    measured = load(folder, {**EXPERIMENT, "retrieve_return": section}).retrieve_return
    frame = pd.read_csv(folder / "measured" / "returns.csv")
    selected = select_returns(measured, frame, table.wavelength.values)
    (found,) = retrieve_samples(measured, table, selected)
    expected = retrieve_samples(experiment.retrieve_return, table, {"coarse": returns["coarse"]})
    difference = found.result.values[AREA] - expected[0].result.values[AREA]
    limit = 1e-6 if counts else found.result.stderr[AREA]
    assert abs(difference) < limit


def test_table_and_figure_are_written(tmp_path, experiment, table):
    path, outputs = tmp_path / "returned.nc", (tmp_path / "table.csv", tmp_path / "figure.png")
    splits.save(table, path)
    section = experiment.retrieve_return
    write_return_retrieval(experiment, section, (path, None), 1, outputs)
    rows = pd.read_csv(outputs[0])
    assert rows["reference value"].tolist() == [30.0, 1.5, 12.0, 1.0]
    assert set(rows.parameter) == {AREA, "scale"}
    for suffix in (".png", ".svg", ".pdf"):
        assert outputs[1].with_suffix(suffix).stat().st_size > 10_000


def test_the_command_retrieves_from_a_file(tmp_path, monkeypatch, capsys, returns):
    monkeypatch.chdir(tmp_path)
    counts = {"field": returns["coarse"][0][1] * SECTION["photons"] * STEP_S}
    write_measured(tmp_path, counts, returns["coarse"][0][0])
    path = write_experiment(tmp_path, {**EXPERIMENT, "retrieve_return": FROM_FILE})
    assert cli.main(["run", str(path), "--media", str(tmp_path / "media")]) == 0
    assert "returned_retrieved.csv" in capsys.readouterr().out
    assert (tmp_path / "returned.png").is_file()


def change_truth(**values):
    """Return a section with other known values of a sample."""
    synthetic = {**SECTION["synthetic"], "truth": {"fine": {AREA: 30.0, **values}}}
    return {"retrieve_return": {**SECTION, "synthetic": synthetic}}


def change_section(**values):
    return {"retrieve_return": {**SECTION, **values}}


MISTAKES = {
    "spectra": ({"instrument": {"kind": "spectrophotometer", "wavelength_nm": [532]}},
                "instrument.kind = 'spectrophotometer': must be return_table with a section"),
    "figure": ({"figure": {"kind": "return"}}, "figure = .* with a section retrieve_return"),
    "both": (change_section(measured="returns.csv"),
             "retrieve_return.measured = 'given': must be given, or synthetic instead, not both"),
    "photons": (change_section(photons=None), "retrieve_return.photons = None: must be given"),
    "no photons": (change_section(photons=0), "retrieve_return.photons = 0: must be above 0"),
    "pulse": (change_section(pulse=-1), "retrieve_return.pulse = -1: must be"),
    "free": (change_section(free=["depth_m"]), "retrieve_return.free = 'depth_m': must be one of"),
    "samples": (change_section(samples=["fine"]), "retrieve_return.samples = .*truth has"),
    "key": (change_section(photon=3), r"photon: unknown key.*did you mean photons"),
    "step": ({"instrument": {**EXPERIMENT["instrument"], "delay_s": {"start": 0, "stop": 1e-9}}},
             "instrument.delay_s.step = None: must be given"),
    "pulse of the table": ({"instrument": {**EXPERIMENT["instrument"], "pulse": 1e-9}},
                           r"instrument.pulse = 1e-09: must be left out for return_table"),
    "axis": ({"grid": {AREA: [16, 8], DENSITY: [250, 350]}}, "increasing"),
    "no file": ({"retrieve_return": {**FROM_FILE, "measured": "other.csv"}}, "measured = 'other"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_have_one_message(tmp_path, name):
    changes, message = MISTAKES[name]
    with pytest.raises(ConfigError, match=message) as caught:
        load(tmp_path, EXPERIMENT | changes)
    assert "\n" not in str(caught.value)


TRUTH_MISTAKES = {
    "outside": ({AREA: 100}, {}, r"truth\.fine\..* = 100.0: must be 8 to 64, the range"),
    "scale": ({"scale": 0}, {}, r"truth\.fine\.scale = 0.0: must be above 0"),
    "unknown": ({"densty": 3}, {}, r"truth\.fine\.densty: unknown key"),
    "not given": ({}, {"free": [DENSITY], "fixed": {AREA: 16}}, rf"truth\.fine\.{DENSITY} = None"),
}  # fmt: skip


@pytest.mark.parametrize("name", TRUTH_MISTAKES)
def test_known_media_outside_the_table_are_rejected(tmp_path, name):
    values, section, message = TRUTH_MISTAKES[name]
    changes = change_truth(**values)
    changes["retrieve_return"] |= section
    experiment = load(tmp_path, EXPERIMENT | changes)
    with pytest.raises(InvalidValue, match=message):
        simulate_returns(experiment, experiment.retrieve_return, seed=1)


RETRIEVAL_MISTAKES = {
    "scale only": ({"free": ["scale"], "fixed": {AREA: 10, DENSITY: 250}}, "at least one axis"),
    "not fixed": ({"fixed": {}}, rf"fixed\.{DENSITY} = None: must be given"),
    "fixed outside": ({"fixed": {DENSITY: 100}}, "100.*250"),
    "long pulse": ({"pulse": 1e-9}, "pulse|delays"),
}  # fmt: skip


@pytest.mark.parametrize("name", RETRIEVAL_MISTAKES)
def test_retrievals_reject_what_the_table_does_not_allow(tmp_path, table, returns, name):
    section, message = RETRIEVAL_MISTAKES[name]
    content = EXPERIMENT | {"retrieve_return": {**SECTION, **section}}
    experiment = load(tmp_path, content)
    with pytest.raises(InvalidValue, match=message) as caught:
        retrieve_samples(experiment.retrieve_return, table, {"fine": returns["fine"]})
    assert "retrieve_return (fine)" in str(caught.value)


EDGES = np.linspace(0.0, 1e-9, 5)
COUNTS = np.full((2, 4), 100.0)
FILE_MISTAKES = {
    "wavelengths": ({"wavelengths": (532.0, 1550.0)}, {}, "as many bins at each wavelength"),
    "one wavelength": ({"wavelengths": (532.0,), "samples": {"one": COUNTS[0]}}, {},
                       "as many bins at each wavelength"),
    "delays in ns": ({"edges": 1e9 * EDGES}, {}, "must be up to 1.49e-09 s"),
    "order": ({"edges": EDGES[::-1]}, {}, "delay_end_s.*above its start"),
    "gap": ({"samples": {"one": [np.nan, *COUNTS.ravel()[1:]]}}, {}, "without gaps"),
    "no sample": ({"samples": {}}, {}, "a table with a column per sample"),
    "sample": ({}, {"samples": ["two"]}, "samples = 'two': must be one of one"),
    "reference": ({}, {"reference_values": {AREA: {"two": 20}}}, "= 'two': must be one of one"),
    "no errors": ({}, {"photons": None}, "with a column one_stderr .or give photons"),
    "errors of 0": ({"samples": {"one": COUNTS, "one_stderr": 0.0 * COUNTS}}, {"photons": None},
                    "standard errors above 0"),
}  # fmt: skip


def retrieve_from_file(folder, table, **section):
    content = {**EXPERIMENT, "retrieve_return": {**FROM_FILE, **section}}
    section = load(folder, content).retrieve_return
    frame = pd.read_csv(folder / "measured" / "returns.csv")
    return retrieve_samples(section, table, select_returns(section, frame, table.wavelength.values))


@pytest.mark.parametrize("name", FILE_MISTAKES)
def test_mistakes_in_files_have_one_message(tmp_path, table, name):
    file, section, message = FILE_MISTAKES[name]
    write_measured(tmp_path, **{"samples": {"one": COUNTS}, "edges": EDGES, **file})
    with pytest.raises(InvalidValue, match=message) as caught:
        retrieve_from_file(tmp_path, table, **section)
    assert "\n" not in str(caught.value)
    assert "retrieve_return" in str(caught.value)


def test_bins_of_a_file_follow_each_other(tmp_path, table):
    write_measured(tmp_path, {"one": COUNTS}, EDGES)
    path = tmp_path / "measured" / "returns.csv"
    frame = pd.read_csv(path)
    frame.loc[5, "delay_start_s"] += 1e-11
    frame.to_csv(path, index=False)
    with pytest.raises(InvalidValue, match="bins that follow each other, the same at all"):
        retrieve_from_file(tmp_path, table)
