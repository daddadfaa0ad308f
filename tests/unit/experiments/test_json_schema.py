"""JSON schemas of configuration files: those of config/ are current and accept its files."""

from inspect import Parameter
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from shipped import CONFIG

from splits import cli
from splits.core.yaml import read_yaml
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.instruments import (
    KINDS,
    list_section_inputs,
    make_instrument_schemas,
)
from splits.experiments.config.schema import make_schema
from splits.experiments.config.settings import Settings

EXPERIMENTS = Draft202012Validator(make_schema(ExperimentConfig))
SETTINGS = Draft202012Validator(make_schema(Settings))


def test_shipped_schemas_are_current(tmp_path, capsys):
    assert cli.main(["schema", str(tmp_path)]) == 0
    written = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert {path.name for path in written} == {path.name for path in CONFIG.glob("*.json")}
    for path in written:
        shipped = (CONFIG / path.name).read_text(encoding="utf-8")
        assert path.read_text(encoding="utf-8") == shipped, "run: splits schema config"


@pytest.mark.parametrize("schema", [EXPERIMENTS, SETTINGS])
def test_schemas_are_valid(schema):
    schema.check_schema(schema.schema)


@pytest.mark.parametrize("kind", KINDS)
def test_schemas_of_instruments_have_meanings_and_defaults_that_they_accept(kind):
    schema = make_instrument_schemas()[kind]
    for key, one in list_section_inputs(kind).items():
        described = schema["properties"][key]
        assert described["description"] == one.quantity.describe()
        assert (key in schema["required"]) == (one.default is Parameter.empty)
        if "default" in described:
            Draft202012Validator(described).validate(described["default"])
            one.check(key, described["default"])


@pytest.mark.parametrize("path", sorted(CONFIG.rglob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_files_match_their_schema(path):
    if path.parent == CONFIG:
        SETTINGS.validate(read_yaml(path))
    elif (CONFIG / "experiments") in path.parents:
        EXPERIMENTS.validate(read_yaml(path))
    else:
        EXPERIMENTS.validate({"medium": read_yaml(path)})


@pytest.mark.parametrize(
    "content",
    [
        {"figure": "none"},
        {"grid": {"density_kg_m3": {"start": 300, "stop": 400, "step": 50}}},
        {"grid": {"depth_m": {"geomspace": [0.1, 1, 3]}, "medium": {"start": "a", "stop": "b"}}},
        {"medium": {"base": "splits_base", "iron_oxide": 0.1}},
        {"medium": {"kind": "stack", "layers": [{"depth_m": 0.1}, {"kind": "sand"}]}},
        {"grid": {"layers.0.depth_m": [1], "impurities_ng_g.black_carbon": [0, 1]}},
        {"grid": {"partition.coated": [0, 1], "texture.silt": [0.01]}, "medium": {"kind": "sand"}},
        {"instrument": {"incidence_deg": "diffuse"}, "figure": {"quantity": "reflectance"}},
        {"instrument": {"wavelength_nm": {"start": 400, "stop": 900, "step": 50, "also": [532]}}},
        {"instrument": {"kind": "time_of_flight", "delay_s": {"geomspace": [1e-9, 1e-8, 5]}}},
        {"instrument": {"kind": "albedo", "bands": {"red": [620, 670]}}},
        {"instrument": {"kind": "hdrf", "sky": "clear", "polar_deg": [0, 30], "seed": 2}},
        {"instrument": {"kind": "irradiance_profile", "depth_m": [0.01], "target": "absorptance"}},
        {"instrument": {"kind": "radiation_profile", "depth_m": 0.01, "total_w_m2": 700}},
        {"instrument": {"kind": "single_scattering", "moments": 8, "stokes": True}},
    ],
)
def test_valid_contents_match_the_schema(content):
    EXPERIMENTS.validate(content)


@pytest.mark.parametrize(
    "content",
    [
        {"medium": {"iron_oxide": 0.1}},
        {"medium": {"kind": "stack", "layers": [{"kind": "sand", "facetness": [0, 1, 0.5, 0.1]}]}},
        {"medium": {"density_kg_m3": "300"}},
        {"grid": {"layers.depth_m": [1]}},
        {"grid": {"density_kg_m3": {"start": 300, "stop": 400, "stepp": 50}}},
        {"grid": {"density_kg_m3": {"geomspace": [300, 400]}}},
        {"instrument": {"kind": "lens", "radius_m": 1}},
        {"instrument": {"kind": "irradiance_profile"}},
        {"instrument": {"kind": "hdrf", "polar_deg": [95]}},
        {"instrument": {"kind": "goniophotometer", "n_bins": [18]}},
        {"instrument": {"kind": "goniophotometer", "n_bins": [18.5, 72]}},
        {"instrument": {"kind": "spectrofotometer"}},
        {"instrument": {"seed": 2**63}},
        {"instrument": {"wavelength_nm": {"start": 400, "stop": 900, "step": 0}}},
        {"instrument": {"wavelength_nm": {"start": 400, "stop": 900, "step": 50, "plus": [532]}}},
        {"instrument": {"kind": "time_of_flight", "delay_s": {"start": 0, "stop": 1, "also": []}}},
        {"instrument": {"wavelength_nm": [0.5, 0.6]}},
        {"instrument": {"incidence_deg": "sunny"}},
        {"instrument": {"rays": 10}},
        {"figure": "nothing"},
        {"group": "all"},
        {"name": "simulate"},
        {"title": "x" * 201},
        {"reproduces": {"paper": "splitsnow_2021", "place": "figure 8"}},
    ],
)
def test_invalid_contents_do_not_match_the_schema(content):
    assert not EXPERIMENTS.is_valid(content)


def make_study(**keys):
    return {"studies": {"mine": keys}}


@pytest.mark.parametrize(
    ("content", "is_valid"),
    [
        (make_study(function="a.b"), True),
        (make_study(function="a.b", inputs={"my table": "a"}, options={"n": [1, {"b": True}]},
                    outputs={"a.csv": {"title": "A", "place": "Fig 2"}, "b.nc": {}}), True),
        (make_study(inputs={"lens": "a"}), False),
        (make_study(function="a.b", outputs={"a.txt": {}}), False),
        (make_study(function="a.b", outputs={"A.png": {}}), False),
        (make_study(function="a.b", outputs={"a.csv": {"titel": "A"}}), False),
        ({"studies": {"Mine": {"function": "a.b"}}}, False),
        ({"archive_authors": [{"name": "A", "orcid": "0000-0002-1825-0097"}]}, True),
        ({"archive_authors": [{"name": "A", "orcid": 1825}]}, False),
    ],
)  # fmt: skip
def test_schema_of_partial_settings(content, is_valid):
    assert SETTINGS.is_valid(content) == is_valid
