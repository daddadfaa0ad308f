"""Named media of the package, and media in files of users."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys

import pytest

import splits
from splits.core.validation import ConfigError, InvalidValue
from splits.core.yaml import dump_yaml
from splits.experiments import load_experiment
from splits.io.netcdf import to_netcdf_attributes
from splits.media.kinds import NAMED_MEDIA, NAMED_MEDIA_FOLDER, read_named_medium

SETTINGS_DIGESTS = {
    "splits_base": "b179755d90d5fcce",
    "splitsnow_table1": "45a550017c20abe1",
    "tec_10019201": "2d035e2b36fe3f5f",
    "tec_10039240": "e0d22a0a7d8ac201",
    "tec_13j9823": "97837251785c7f7b",
    "tec_19au9815": "746bb669accda8bf",
}
"""Digests of the samples of the papers, which published results depend on."""
CORE_PROGRAM = """
import sys
sys.modules |= dict.fromkeys(["yaml", "pydantic", "colour", "matplotlib", "scipy"])
import splits
for name in splits.list_media():
    print(name, splits.load_medium(name))
try:
    splits.load_medium("mine.yaml")
except ModuleNotFoundError as error:
    print(error)
"""


@pytest.mark.parametrize("name", NAMED_MEDIA)
def test_named_media_are_described_and_equal_their_representation(name):
    medium = splits.load_medium(name)
    same = eval(repr(medium), {"Snow": splits.Snow, "Sand": splits.Sand})
    assert repr(same) == repr(medium)
    assert to_netcdf_attributes(medium.describe())
    assert medium.kind == read_named_medium(name)["kind"]
    assert splits.list_media()[name]


@pytest.mark.parametrize("name", NAMED_MEDIA)
def test_named_media_state_their_source(name):
    text = (NAMED_MEDIA_FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    is_sample = name in SETTINGS_DIGESTS
    assert ('source = "illustrative: ' in text) != is_sample
    assert "(2007)" in text or "(2021)" in text


@pytest.mark.parametrize("name", SETTINGS_DIGESTS)
def test_samples_of_the_papers_are_unchanged(name):
    content = json.dumps(read_named_medium(name), sort_keys=True)
    assert hashlib.sha256(content.encode()).hexdigest()[:16] == SETTINGS_DIGESTS[name]


def test_named_media_need_no_extra():
    done = subprocess.run([sys.executable, "-c", CORE_PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    *lines, missing = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(NAMED_MEDIA)
    assert "pip install '.[experiments]' in a copy of the repository" in missing


def test_keywords_replace_values():
    beach = splits.load_medium("wet_beach", saturation=0.25, depth_m=0.2)
    assert (beach.saturation, beach.depth_m, beach.magnetite) == (0.25, 0.2, 0.01)
    snow = splits.load_medium("splitsnow_table1", optical_radius_um=100)
    assert snow.optical_radius_um == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("name", "keywords", "message"),
    [
        ("red_dunes", {}, r"name = 'red_dunes': must be one of .*did you mean red_dune\?"),
        (3, {}, "name = 3: must be one of black_magnetite"),
        ("red_dune", {"saturation": 2}, r"saturation = 2: must be in \[0, 1\]"),
        ("red_dune", {"saturatoin": 0}, r"saturatoin: unknown key.*did you mean saturation\?"),
        ("red_dune", {"kind": "snow"}, "kind: unknown key"),
    ],
)
def test_invalid_names_and_keywords_are_rejected(name, keywords, message):
    with pytest.raises((InvalidValue, TypeError), match=message) as error:
        splits.load_medium(name, **keywords)
    assert "\n" not in str(error.value)


# --- files of users -------------------------------------------------------------------------------

STACK = "kind: stack\nground: 0.2\nlayers: [{depth_m: 0.1}, {kind: particle_layer, depth_m: 1}]\n"


@pytest.mark.parametrize("name", NAMED_MEDIA)
def test_media_in_yaml_files_equal_named_media(name, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(dump_yaml(read_named_medium(name)), encoding="utf-8")
    assert splits.load_medium(path) == splits.load_medium(name)


def test_yaml_files_may_hold_any_kind_of_medium(tmp_path):
    path = tmp_path / "mine.yml"
    path.write_text(STACK, encoding="utf-8")
    stack = splits.load_medium(str(path), ground="black")
    assert [layer.kind for layer in stack.layers] == ["snow", "particle_layer"]
    path.write_text("kind: natural_snow\noptical_radius_um: 100\n", encoding="utf-8")
    assert splits.load_medium(path) == splits.Snow.natural(optical_radius_um=100)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind: ice\n", r"kind = 'ice': must be one of natural_snow, .*stack"),
        ("kind: stack\n", "layers = None: must be a list of layers, top first"),
        (STACK.replace("particle_layer", "ice"), r"layers\.1\.kind = 'ice': must be one of"),
        (STACK.replace("0.1", "-1"), r"layers\.0\.depth_m = -1: must be"),
        (f"{STACK}cover: 1\n", "cover: unknown key, must be one of layers, ground"),
        ("iron_oxide: 0.1\n", "iron_oxide: unknown key"),
        ("- 1\n", r"mine\.yaml: must be a mapping"),
    ],
)
def test_invalid_files_are_rejected(text, message, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises((ValueError, TypeError), match=message):
        splits.load_medium(path)


# --- experiments ----------------------------------------------------------------------------------


def test_experiments_use_named_media_and_own_files(tmp_path):
    media = tmp_path / "media"
    path = tmp_path / "both.yaml"
    path.write_text(
        "medium: {kind: sand}\ninstrument: {wavelength_nm: [500]}\n"
        "grid: {medium: {a: red_dune, b: {base: red_dune, saturation: 0.5}}}\n", encoding="utf-8"
    )  # fmt: skip
    points = [medium for _, medium, _ in load_experiment(path, media).iter_points()]
    assert points == [splits.load_medium("red_dune", saturation=s) for s in (0, 0.5)]
    media.mkdir()
    (media / "mine.yaml").write_text("kind: sand\niron_oxide: 0.02\n", encoding="utf-8")
    path.write_text(path.read_text("utf-8").replace("a: red_dune", "a: mine"), encoding="utf-8")
    points = [medium for _, medium, _ in load_experiment(path, media).iter_points()]
    assert points[0] == splits.load_medium(media / "mine.yaml")


def test_own_files_with_the_name_of_a_named_medium_are_rejected(tmp_path):
    (tmp_path / "red_dune.yaml").write_text("kind: sand\n", encoding="utf-8")
    path = tmp_path / "experiment.yaml"
    path.write_text("medium: {base: red_dune}\n", encoding="utf-8")
    message = (
        r"medium\.base = 'red_dune': must be the name of one medium only \(.*rename .*red_dune"
    )
    with pytest.raises(ConfigError, match=message) as error:
        load_experiment(path, tmp_path)
    assert "\n" not in str(error.value)
