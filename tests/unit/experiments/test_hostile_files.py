"""Hostile files: one-line errors in bounded time and memory."""

import time

import pytest
from experiment_jobs import start_jobs

from splits.core.validation import ConfigError
from splits.core.yaml import MAX_BYTES, read_yaml
from splits.experiments import load_settings

HUGE_NUMBER = "1" + 400 * "0"
ALIAS_BOMB = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10)
)
SPEC = "medium: {{refractive_index: {{ice: {}}}}}"
LENS = (
    "medium: {kind: particle_layer, depth_m: 10, surface: {rms_height_m: 0.1, wave_number_per_m: 1,"
    " waves: 8, correlation: gaussian}}\ninstrument: {kind: lens, radius_m: 0.1, "
)
FILES = {
    f"medium: {{depth_m: {HUGE_NUMBER}}}": "medium.depth_m = 1000",
    f"grid: {{depth_m: [{HUGE_NUMBER}]}}": "grid.depth_m = 1000",
    f"grid: {{incidence_deg: [{HUGE_NUMBER}]}}": "grid.incidence_deg = 1000",
    SPEC.format(HUGE_NUMBER): "medium.refractive_index[ice] = 1000",
    SPEC.format(f"{{n: 1.3, k: {HUGE_NUMBER}}}"): "medium.refractive_index[ice].k = 1000",
    SPEC.format(f"{{wavelength_nm: [1, 2], n: [1, {HUGE_NUMBER}], k: 0}}"):
        "medium.refractive_index[ice]",
    SPEC.format(300 * "x" + ".csv"): "medium.refractive_index[ice] = 'xxxx",
    "medium: {kind: particle_layer, phase_function: "
    f"{{cosine: [-1, 1], density: [1, {HUGE_NUMBER}]}}}}":
        "medium.phase_function.density = 1000",
    "instrument: {wavelength_nm: {start: 400, stop: 500, step: 5e-324}}":
        "instrument.wavelength_nm.step = 5e-324",
    "instrument: {wavelength_nm: {start: 400, stop: 90000, step: 0.9}}":
        "instrument.wavelength_nm.step = 0.9: must be large enough for at most 20000 values",
    "medium: !!bool maybe": "not YAML ('maybe' is not of type bool)",
    "medium: !!int ''": "not YAML ('' is not of type int)",
    "title: !!timestamp 2001-01-01": "not YAML (the tag !!timestamp is not allowed here)",
    "medium: !!python/object:os.system x": "not YAML (the tag !!python/object:os.system is not",
    f"medium: {500 * '['}{500 * ']'}": "not YAML (more than 32 lists and mappings",
    ALIAS_BOMB: "not YAML (more than 50000 values)",
    "a: &a [*a]": "not YAML (no anchor &a ends before this alias)",
    "*\U00051134": "line 1: not YAML (did not find expected alphabetic or numeric character)",
    "? [a]\n: b": "not YAML (a key that is not text)",
    "".join(f"k{i}: 1\n" for i in range(20_000)): "unknown key",
    f"name: {300 * 'a'}": "name = 'aaaa",
    f"{300 * 'k'}: 1": "unknown key",
    f"medium: {{base: {300 * 'a'}}}": "medium.base = 'aaaa",
    f"figure: {{measured: {300 * 'a'}}}": "figure.measured = 'aaaa",
    "figure: {measured: ../published/splitsnow2021.csv}":
        "figure.measured = '../published/splitsnow2021.csv': must be the name of a file of",
    "retrieve: {measured: /etc/passwd, free: [depth_m]}":
        "retrieve.measured = '/etc/passwd': must be",
    'grid: {saturation: {"a\\nb": 0}}': "grid.saturation (label) = 'a\\nb': must be text without",
    'grid: {saturation: {"\\e[31m": 0}}': "grid.saturation (label) = '\\x1b[31m': must be text",
    'instrument: {"a\\nb": 1}': "unknown key",
    'title: "a\\x85b"': "title = 'a\\x85b': must be text without control",
    "figure: {legend: '$x^$'}": "figure.legend = '$x^$': must be text that matplotlib can typeset",
    f"title: {1000 * 't'}": "title = 'tttt",
    "figure: {ylim: [1, 1]}": "figure.ylim = [1.0, 1.0]: must be low < high",
    "figure: {ylim: [0, .nan]}": "figure.ylim[1] = nan: must be a finite number",
    "figure: {quantity: []}": "figure.quantity = []: must be at least one, without repetition",
    "instrument: {seed: 9223372036854775808}":
        "instrument.seed = 9223372036854775808: must be a whole number from 0 to 92233",
    "instrument: {kind: beam_spread, rays: 9223372036854775808}": "instrument.rays = 92233",
    "instrument: {kind: beam_spread, half_width_m: 1e7}":
        "instrument.half_width_m = 10000000: must be in [1e-09, 1e+06] m",
    LENS + "half_width_m: 1e7, screen_depth_m: [1]}": "instrument.half_width_m = 10000000: must",
    LENS + "centre_on: origin, rays: 100000000, screen_depth_m: [1]}":
        "instrument.rays = 100000000",
    "instrument: {kind: goniophotometer, wavelength_nm: {start: 300, stop: 10000, step: 1}}":
        "instrument.wavelength_nm = '9701 wavelengths': must be at most 3858",
    "grid: {saturation: {start: 0, stop: 1, step: 0.001}, depth_m: {start: 0.1, stop: 1, "
    "step: 0.01}}": "grid = '91091 points': must be at most 10000 points",
}  # fmt: skip


def read_message(path, text):
    """Return the error message of a file without its path."""
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        start_jobs(path, path.parent / "media")
    line = str(error.value)
    assert line.isprintable() and len(line) - len(str(path)) < 500
    return line.removeprefix(str(path))


@pytest.mark.parametrize("text", FILES, ids=range(len(FILES)))
def test_errors_are_prompt_and_in_one_line(tmp_path, text):
    # CPU time of this process, so that the load of the machine has no effect.
    start = time.process_time()
    assert FILES[text] in read_message(tmp_path / "wrong.yaml", text)
    assert time.process_time() - start < 60.0


def test_large_files_are_not_read(tmp_path):
    path = tmp_path / "large.yaml"
    path.write_text("# " + MAX_BYTES * "x", encoding="utf-8")
    with pytest.raises(ConfigError, match="must be at most 1024 KiB"):
        read_yaml(path)


def test_duplicate_keys_are_rejected_with_both_lines(tmp_path):
    text = "title: a\n\ngrid: {}\nfigure:\n  ylim: [0, 1]\n\ncaption: b\n\ngrid: {}\n"
    message = read_message(tmp_path / "wrong.yaml", text)
    assert message == ", line 9: not YAML ('grid' given twice, in lines 3 and 9)"


def test_aliases_and_merges_of_ordinary_size_are_read(tmp_path):
    path = tmp_path / "made.yaml"
    path.write_text("a: &a {x: 1e5, y: [1, 2]}\nb: {<<: *a, x: 3}\nc: *a\n", encoding="utf-8")
    assert read_yaml(path) == {
        "a": {"x": 1e5, "y": [1, 2]}, "b": {"x": 3, "y": [1, 2]}, "c": {"x": 1e5, "y": [1, 2]},
    }  # fmt: skip


@pytest.mark.parametrize("key", ["seed", "max_rays"])
def test_settings_above_63_bits_are_rejected(key):
    settings = {"accuracies": {"standard": {"max_stderr": 0.1}}}
    section = settings if key == "seed" else settings["accuracies"]["standard"]
    section[key] = 2**63
    with pytest.raises(ConfigError, match=rf"{key} = 9223372036854775808: must be a whole"):
        load_settings(settings)
