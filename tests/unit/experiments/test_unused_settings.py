"""Settings without effect, and sections that a command would ignore."""

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from chi2 import NEEDS_JIT
from shipped import CONFIG

import splits
from splits import cli
from splits.core.validation import ConfigError, InvalidValue
from splits.experiments import load_experiment, load_settings
from splits.experiments.config.retrieval import RetrieveSection
from splits.experiments.run_retrieve import get_fixed_values

ROOT = Path(__file__).parents[3]
MEDIA = CONFIG / "media"
SPECTRUM = "instrument: {wavelength_nm: [500, 600]}\n"
GRID = "grid: {saturation: [0, 0.1]}\n"
MEASURED = "measured: aviris_ng_varsa2021.csv"
LENS = (
    "medium: {kind: particle_layer, depth_m: 10, surface: {rms_height_m: 0.1, wave_number_per_m: 1,"
)
LENS += " waves: 8, correlation: gaussian}}\ninstrument: {kind: lens, radius_m: 0.1, "
LENS += "screen_depth_m: [1], centre_on: origin, "
TABLE = "medium: {kind: natural_snow}\n"
TABLE += "instrument: {kind: table, wavelength_nm: {start: 400, stop: 1300, step: 100}}\n"
TABLE += "grid: {optical_radius_um: [50, 100, 200]}\n"
RETRIEVE = "retrieve: {measured: snow_albedo_letcher2022.csv, samples: [albedo_340mm], "
UNUSED_SETTINGS = {
    SPECTRUM + GRID + "figure: {kind: points, ylim: [0, 1]}": "figure.ylim",
    SPECTRUM + GRID + f"figure: {{kind: points, {MEASURED}}}": "figure.measured",
    "instrument: {kind: refractive_index}\nfigure: {wavelength_nm: [400, 500]}":
        "figure.wavelength_nm",
    "instrument: {kind: refractive_index}\nfigure: {legend: a}": "figure.legend",
    "instrument: {kind: goniophotometer}\nfigure: {kind: lobes, ylim: [0, 1]}": "figure.ylim",
    "instrument: {kind: refractive_index, seed: 3}": "instrument.seed",
    "medium: {saturation: 0.5}\n" + SPECTRUM + GRID: "medium.saturation",
    "medium: {specific_surface_area_m2_kg: 20}\n" + SPECTRUM + "grid: {grain_size_um: [[9, 99]]}":
        "medium.specific_surface_area_m2_kg",
    SPECTRUM + "grid: {medium: {a: {depth_m: 1}}, depth_m: [2]}": "grid.medium.a.depth_m",
    "instrument: {wavelength_nm: [500], incidence_deg: 30}\ngrid: {incidence_deg: [0, 60]}":
        "instrument.incidence_deg",
    TABLE + RETRIEVE + "free: [optical_radius_um], noise: {absolute: 0.1, correlation_nm: 50}}":
        "retrieve.noise.correlation_nm",
}  # fmt: skip


@pytest.mark.parametrize("text", UNUSED_SETTINGS, ids=range(len(UNUSED_SETTINGS)))
def test_settings_without_effect_are_rejected(tmp_path, text):
    path = tmp_path / "idle.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        load_experiment(path, MEDIA)
    line = str(error.value)
    start = rf"{re.escape(str(path))}, line \d+: {re.escape(UNUSED_SETTINGS[text])} = .*must be "
    assert re.match(start, line), line


@pytest.mark.parametrize(
    "text",
    [
        SPECTRUM + f"figure: {{legend: a, {MEASURED}}}",
        SPECTRUM + GRID + "figure: {legend: a, ylim: [0, 1]}",
        "instrument: {kind: goniophotometer, wavelength_nm: [5e2]}\nfigure: {legend: a}",
        "medium: {base: splitsnow_table1}\n" + SPECTRUM + "grid: {depth_m: [0.1, 0.2]}",
        "medium: {refractive_index: {ice: 1.3}}\n" + SPECTRUM
        + "grid: {refractive_index: {a: {water: 1.3}}}",
    ],
    ids=range(5),
)  # fmt: skip
def test_settings_with_effect_are_accepted(tmp_path, text):
    path = tmp_path / "made.yaml"
    path.write_text(text, encoding="utf-8")
    load_experiment(path, MEDIA)


@pytest.mark.parametrize(
    ("sample", "axis", "incidence", "fixed", "message"),
    [
        ("a@50", False, 0.0, {}, r"retrieve\.samples = 'a@50': must be of incidence 0\.0"),
        ("a@50", False, 50.0, {}, None),
        ("a@noon", False, 0.0, {}, None),
        ("a@50", True, 0.0, {"incidence_deg": 40}, r"retrieve\.fixed\.incidence_deg = 40\.0.*a@50"),
        ("a@50", True, 0.0, {"incidence_deg": 50}, None),
    ],
)
def test_angles_in_sample_names_are_used_or_rejected(sample, axis, incidence, fixed, message):
    section = RetrieveSection(measured="mine.csv", free=["optical_radius_um"], fixed=fixed)
    dataset = SimpleNamespace(attrs={} if axis else {"incidence_deg": incidence})
    table = SimpleNamespace(axes=["incidence_deg"] * axis, dataset=dataset)
    if message is None:
        assert get_fixed_values(section, sample, table) == ({"incidence_deg": 50} if axis else {})
        return
    with pytest.raises(InvalidValue, match=message):
        get_fixed_values(section, sample, table)


def test_a_seed_of_the_file_is_not_ignored(tmp_path, capsys):
    path = tmp_path / "made.yaml"
    path.write_text("instrument: {wavelength_nm: [500], seed: 3}\n", encoding="utf-8")
    assert cli.main(["run", str(path), "--seed", "4", "--output", str(tmp_path / "out")]) == 1
    assert "--seed = 4: must be left out (the file has instrument.seed = 3)" in (
        capsys.readouterr().err
    )


@pytest.mark.long
@NEEDS_JIT
def test_run_retrieves_measured_spectra(tmp_path):
    path = tmp_path / "grains.yaml"
    path.write_text(TABLE + RETRIEVE + "free: [optical_radius_um, scale]}\n", encoding="utf-8")
    folder = tmp_path / "made"
    result = subprocess.run(
        [sys.executable, "-m", "splits.cli", "run", path, "--output", folder,
         "--accuracy", "tiny", "--threads", "1", "--media", MEDIA],
        capture_output=True, text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    files = [folder / f"grains{end}" for end in (".nc", "_retrieved.csv", ".png")]
    assert result.stdout.splitlines() == list(map(str, files))
    assert all(file.is_file() for file in files)
    table = pd.read_csv(files[1])
    assert list(table.parameter) == ["optical_radius_um", "scale"]
    assert splits.load(files[0]).attrs["instrument"] == "table"


@pytest.mark.parametrize("name", ["data", "Figures", "../there", "a/b", "", "{x}"])
def test_accuracy_names_must_be_valid_folder_names(name):
    with pytest.raises(ConfigError, match=r"accuracies \(key\) = .*: must be letters"):
        load_settings({"accuracies": {name: {"max_stderr": 0.1}}, "accuracy": name})
