"""Configuration files: messages with file, key, value and allowed values."""

from pathlib import Path

import pytest
from shipped import CONFIG

from splits.core.validation import ConfigError
from splits.experiments import (
    SimulationConfig,
    load_experiment,
    load_experiments,
    load_settings,
)
from splits.experiments.config.load import read_yaml

ROOT = Path(__file__).parents[3]
MEDIA = CONFIG / "media"
SETTINGS = read_yaml(CONFIG / "config.yaml")
INVALID_FILES = [
    ("titel: x", "titel: unknown key.*did you mean title"),
    ("instrument: {wavelength: [500]}", r"instrument\.wavelength: unknown key.*wavelength_nm"),
    (
        "instrument: {estimator: spektral}",
        r"instrument\.estimator = 'spektral': must be one of.*did you mean spectral",
    ),
    ("instrument: {seed: -1}", r"instrument\.seed = -1"),
    ("instrument: {wavelength_nm: []}", r"wavelength_nm = \[\]"),
    ("instrument: {incidence_deg: 90}", r"incidence_deg = 90.*\[0, 89.9999\]"),
    ("medium: snow", "medium = 'snow': must be a mapping"),
    ("medium: {base: nowhere}", r"medium\.base = 'nowhere': must be one of .*splitsnow_table1"),
    (
        "medium: {interpretation: {entry_point: top}}",
        r"interpretation\.entry_point = 'top': must be one of",
    ),
    ("medium: {interpretation: 3}", "interpretation = 3"),
    ("medium: {refractive_index: {ice: glass}}", "refractive_index.ice. = 'glass'"),
    ("grid:", "grid = None"),
    ("- a list", "must be a mapping of keys to values"),
    ("", "must be a mapping of keys to values"),
    ("\ttab: 1", "line 1: not YAML"),
    ("a: [1\nb: 2", "line 2: not YAML"),
]


def write_file(folder, name, text=""):
    path = folder / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("text", "message"), INVALID_FILES)
def test_invalid_files_are_rejected_with_file_and_key(tmp_path, text, message):
    path = write_file(tmp_path, "wrong", text)
    with pytest.raises(ConfigError, match=message) as error:
        load_experiment(path, MEDIA)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_files_that_are_not_text_are_rejected(tmp_path):
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not YAML"):
        read_yaml(path)
    with pytest.raises(ConfigError, match=r"missing\.yaml: cannot be read"):
        read_yaml(tmp_path / "missing.yaml")


def test_name_defaults_to_the_file_name(tmp_path):
    assert load_experiment(write_file(tmp_path, "plain", "title: T")).name == "plain"
    assert load_experiment(write_file(tmp_path, "Any name!", "name: other")).name == "other"


def test_a_medium_inherits_from_its_base(tmp_path):
    path = write_file(tmp_path, "made", "medium: {base: splitsnow_table1, depth_m: 0.25}")
    experiment = load_experiment(path, MEDIA)
    assert experiment.medium["depth_m"] == 0.25
    assert experiment.medium["density_kg_m3"] == 275


def test_folders_are_searched_recursively(tmp_path):
    write_file(tmp_path, "one", "title: T")
    write_file(tmp_path / "deep" / "down", "two", "title: T")
    assert sorted(load_experiments(tmp_path)) == ["one", "two"]


def test_duplicate_names_are_rejected_with_both_files(tmp_path):
    first, second = write_file(tmp_path, "a", "name: same"), write_file(tmp_path, "b", "name: same")
    with pytest.raises(ConfigError, match="name = 'same': already taken") as error:
        load_experiments(tmp_path)
    assert str(first) in str(error.value)
    assert str(second) in str(error.value)


def test_an_empty_folder_is_rejected(tmp_path):
    with pytest.raises(ConfigError, match="no experiment file"):
        load_experiments(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"accuracy": "drafd"}, "accuracy = 'drafd'.*did you mean draft"),
        ({"experiment": "a"}, "experiment: unknown key.*did you mean experiments"),
        ({"seed": -1}, "seed = -1"),
        ({"accuracies": {"standard": {"max_stderr": 0}}}, r"accuracies\.standard\.max_stderr = 0"),
        ({"accuracies": {"standard": {"max_error": 0.1}}}, "max_stderr"),
        ({"studies": {"a": {"inputs": {}}}}, r"studies\.a\.function = None: must be given"),
        ({"results": None}, "results = None"),
    ],
)
def test_invalid_settings_are_rejected(change, message):
    with pytest.raises(ConfigError, match=f"^config/config.yaml: .*{message}"):
        load_settings({**SETTINGS, **change})


def test_a_grid_may_contain_media(tmp_path):
    write_file(tmp_path / "media", "mine", "kind: sand\niron_oxide: 0.02")
    path = write_file(
        tmp_path,
        "several",
        "medium: {kind: sand, refractive_index: {water: segelstein_1981}}\n"
        "instrument: {wavelength_nm: [500]}\n"
        "grid:\n"
        "  medium:\n"
        "    file: mine\n"
        "    inline: {magnetite: 0.1}\n"
        "    both: {base: mine, magnetite: 0.2}\n"
        "  refractive_index: {half: {goethite: {k_factor: 0.5}}}\n",
    )
    experiment = load_experiment(path, tmp_path / "media")
    media = {labels["medium"]: medium for labels, medium, _ in experiment.iter_points()}
    assert media["file"].iron_oxide == media["both"].iron_oxide == 0.02
    assert media["inline"].magnetite == 0.1 and media["both"].magnetite == 0.2
    for medium in media.values():
        assert medium.refractive_index["water"].name == "segelstein_1981"
        assert "k x 0.5" in medium.refractive_index["goethite"].name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid: {medium: [nowhere]}", r"grid\.medium\.nowhere\.base = 'nowhere'"),
        ("grid: {medium: {a: {saturatio: 1}}}", r"grid\.medium\.a\.saturatio.*saturation"),
        ("grid: {medium: {a: {kind: sand}}}", r"grid\.medium\.a\.kind = 'sand'"),
        ("grid: {medium: {a: 3}}", r"grid\.medium\.a = 3.*mapping"),
        ("medium: {kind: sand, density_kg_m3: 3}", r"medium\.density_kg_m3: unknown key"),
        ("medium: {kind: sand, iron_oxide: 0.2}", r"iron_oxide = 0\.2.*at most 0\.05"),
    ],
)
def test_invalid_media_of_a_grid_are_rejected(tmp_path, text, message):
    path = write_file(tmp_path, "wrong", f"{text}\ninstrument: {{wavelength_nm: [500]}}")
    with pytest.raises(ConfigError, match=message):
        load_experiment(path, MEDIA)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("figure: {kind: season}\ninstrument: {wavelength_nm: [500]}", r"figure\.kind = 'season'"),
        ("figure: {kind: lobes}", r"figure\.kind = 'lobes': must be one of spectra, points"),
        ("figure: {quantity: brdf}", r"figure\.quantity = 'brdf': must be one of absorptance"),
        ("figure: {kind: lobes, quantity: btdf}\ninstrument: {kind: goniophotometer}",
         r"figure\.quantity = .*left out for kind lobes"),
        ("figure: {select: {depth_m: 1}}", r"figure\.select = 'depth_m': must be left out"),
    ],
)  # fmt: skip
def test_figures_that_cannot_be_drawn_are_rejected(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load_experiment(write_file(tmp_path, "wrong", text), MEDIA)


def test_mineral_tables_are_listed_for_the_workflow(tmp_path):
    table = tmp_path / "own.csv"
    table.write_text("wavelength_nm,n,k\n400,2.3,0.1\n1000,2.3,0.01\n", encoding="utf-8")
    path = write_file(
        tmp_path,
        "mine",
        f"medium: {{kind: sand, refractive_index: {{goethite: {table}}}}}\n"
        "instrument: {wavelength_nm: [500]}",
    )
    assert load_experiment(path).list_table_paths() == [str(table)]


def test_parts_of_a_whole_vary_on_a_grid():
    content = {
        "name": "parts",
        "medium": {"kind": "sand", "partition": [0, 0.5, 0.5]},
        "instrument": {"wavelength_nm": [500]},
        "grid": {"partition.coated": [0.2, 1], "texture.silt": [0.05]},
    }
    media = [medium for _, medium, _ in SimulationConfig.model_validate(content).iter_points()]
    assert [medium.partition for medium in media] == [(0.0, 0.8, 0.2), (0.0, 0.0, 1.0)]
    # The default texture has no clay.
    assert [medium.texture for medium in media] == [(0.0, 0.05, 0.95)] * 2
