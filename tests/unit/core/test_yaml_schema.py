"""YAML 1.2: scalars of configuration files, parsed in bounded time."""

import math
import time
from pathlib import Path

import pytest
import yaml
from shipped import CONFIG

from splits.core.validation import ConfigError
from splits.core.yaml import MAX_NUMBER_CHARS, dump_yaml, read_yaml
from splits.experiments import load_experiment

ROOT = Path(__file__).parents[3]
SHIPPED_FILES = [*sorted(CONFIG.rglob("*.y*ml")), ROOT / "CITATION.cff"]
NUMBERS = {
    "045": 45, "0500": 500, "08": 8, "-012": -12, "+7": 7, "0o17": 15, "0x1F": 31, "0": 0,
    "1e5": 1e5, "1E-3": 1e-3, ".5": 0.5, "1.": 1.0, "-.5e1": -5.0, "012.5": 12.5,
    ".inf": math.inf, "-.INF": -math.inf, "+.Inf": math.inf,
}  # fmt: skip
OTHER_SCALARS = {"~": None, "null": None, "": None, "true": True, "False": False, "TRUE": True}
TEXTS = [
    "1:15", "190:20:30.5", "yes", "no", "on", "off", "y", "N", "2001-01-01", "2001-99-99",
    "1_000", "0b11", "1e", "tRue", "=", "0o8", "+0x1F", ".", "1.2.3", "inf", "nan", "٤٥",
]  # fmt: skip


def read_text(folder, text):
    path = folder / "made.yaml"
    path.write_text(text, encoding="utf-8")
    return read_yaml(path)


@pytest.mark.parametrize("text", [*NUMBERS, *OTHER_SCALARS, *TEXTS])
def test_scalars_follow_the_core_schema(tmp_path, text):
    expected = {**NUMBERS, **OTHER_SCALARS, **{scalar: scalar for scalar in TEXTS}}[text]
    actual = read_text(tmp_path, f"key: {text}\n")["key"]
    assert actual == expected and type(actual) is type(expected)


def test_angles_and_wavelengths_are_decimal(tmp_path):
    path = tmp_path / "made.yaml"
    path.write_text("instrument: {incidence_deg: 045, wavelength_nm: [0500, 0700]}\n", "utf-8")
    instrument = load_experiment(path).instrument
    assert instrument.get_incidence() == 45 and [*instrument.get_wavelengths()] == [500, 700]
    path.write_text("instrument: {incidence_deg: 1:15}\n", "utf-8")
    with pytest.raises(ConfigError, match="incidence_deg = '1:15': must be an angle in degrees"):
        load_experiment(path)


def test_yes_and_no_are_texts(tmp_path):
    path = tmp_path / "made.yaml"
    path.write_text("medium: {interpretation: {boundary_fresnel: no}}\n", "utf-8")
    assert load_experiment(path).medium["interpretation"] == {"boundary_fresnel": "no"}
    path.write_text(
        "medium: {kind: particle_layer, polarized: yes}\ninstrument: {wavelength_nm: [5e2]}\n",
        "utf-8",
    )
    with pytest.raises(ConfigError, match=r"medium\.polarized = 'yes': must be true or false"):
        load_experiment(path)


@pytest.mark.parametrize("path", SHIPPED_FILES, ids=[path.name for path in SHIPPED_FILES])
def test_shipped_files_are_equal_in_both_versions(path):
    assert read_yaml(path) == yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "value", [*TEXTS, *NUMBERS, *OTHER_SCALARS, 1e-7, 1e22, 45, math.inf, None, True]
)
def test_written_values_are_read_in_both_versions(tmp_path, value):
    content = {"key": value, "keys": {str(value): [value]}}
    text = dump_yaml(content)
    assert read_text(tmp_path, text) == content
    assert yaml.safe_load(text) == content


@pytest.mark.parametrize(
    "scalar",
    [40_000 * "1" + "x", 40_000 * "1" + "e", 40_000 * "1_" + "x", "1" + 20_000 * ":1",
     40_000 * ".", 40_000 * "1" + "." + 40_000 * "1" + "e", 40_000 * "+"],
    ids=range(7),
)  # fmt: skip
def test_long_scalars_are_parsed_quickly(tmp_path, scalar):
    start = time.perf_counter()
    assert read_text(tmp_path, f"key: {scalar}\n")["key"] == scalar
    assert time.perf_counter() - start < 2.0


@pytest.mark.parametrize("number", ["1", "0x1", "0o1", "1.", "-1"])
def test_long_numbers_are_rejected(tmp_path, number):
    text = number + 40_000 * "1"
    start = time.perf_counter()
    with pytest.raises(
        ConfigError, match=rf"line 1: .*number of more than {MAX_NUMBER_CHARS} digits"
    ):
        read_text(tmp_path, f"key: {text}\n")
    assert time.perf_counter() - start < 2.0


@pytest.mark.parametrize("number", ["1e400", "-1e999", "1" + 500 * "0" + ".0"])
def test_too_large_numbers_are_rejected(tmp_path, number):
    with pytest.raises(ConfigError, match="is too large a number"):
        read_text(tmp_path, f"depth_m: {number}\n")


@pytest.mark.parametrize("text", ["!!int 1:15", "!!float ''", "!!bool yes", "!!int 0b1"])
def test_tags_do_not_enable_other_schemas(tmp_path, text):
    with pytest.raises(ConfigError, match=r"not YAML .* is not of type "):
        read_text(tmp_path, f"key: {text}\n")
