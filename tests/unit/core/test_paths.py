"""Paths of users: expansion of ~ in Python, YAML and the shell, and paths that no file can have."""

import inspect
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import yaml
from chi2 import NEEDS_JIT
from formula_tables import make_snowlike_table

import splits
from splits import cli
from splits.analysis.measured import read_measured
from splits.core.validation import ConfigError, InvalidValue, expand_path
from splits.experiments import load_experiment, load_experiments, load_settings
from splits.experiments.archive import make_configuration_members, pack_archive
from splits.experiments.config.media import identify_by_content
from splits.io.unarchive import unpack_archive, verify_archive
from splits.plotting import save_figure
from splits.plotting.explorer.page import ExplorerTable, write_explorer

NAMES = ["a\0b", "\ud800", "~/a\0b"]
CALLS = {
    "load": splits.load, "Table": splits.Table, "read_caaml": splits.read_caaml,
    "read_crocus": splits.read_crocus,
    "read_snow_packs": lambda path: splits.read_snow_packs(f"{path}.csv"),
    "save": lambda path: splits.save(xr.Dataset(), f"{path}.nc"),
    "ground": lambda path: splits.Snow(ground=f"{path}.csv"),
    "index": lambda path: splits.Snow(refractive_index={"ice": f"{path}.csv"}),
    "impurity": lambda path: splits.Snow(impurities_ng_g={"mine": {"ng_g": 1, "table": path}}),
    "sky": lambda path: splits.sky(f"{path}.csv", 50.0),
    "matrix": lambda path: splits.ParticleLayer(scattering_matrix=f"{path}.nc"),
    "figure": lambda path: save_figure(None, path),
    "load_medium": lambda path: splits.load_medium(f"{path}.yaml"),
}  # fmt: skip
OTHER_FUNCTIONS = {"build_table"}
"""Public functions with a path and other arguments, which are checked first."""


def test_all_functions_of_paths_are_called():
    found = {
        name
        for name in splits.__all__
        if callable(getattr(splits, name))
        and any("Path" in str(parameter.annotation) for parameter in
                inspect.signature(getattr(splits, name)).parameters.values())
    }  # fmt: skip
    assert found <= {*CALLS} | OTHER_FUNCTIONS


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("path", NAMES)
def test_impossible_paths_raise_one_line(name, path):
    with pytest.raises(InvalidValue, match=r"must be ") as error:
        CALLS[name](path)
    assert str(error.value).isprintable()


def test_names_that_are_no_text_are_possible():
    assert str(expand_path("a\udc80b")) == "a\udc80b"


TABLES = {
    "ice": "wavelength_nm,n,k\n200,1.3,0\n3000,1.3,1e-5\n",
    "ground": "wavelength_nm,albedo\n200,0.1\n3000,0.2\n",
    "soot": "wavelength_nm,absorption_m2_kg\n200,2\n3000,1\n",
    "sky": "wavelength_nm,direct,diffuse\n200,1,1\n3000,1,1\n",
    "band": "wavelength_nm,response\n500,1\n900,1\n",
    "measured": "# of others\nwavelength_nm,reflectance\n500,0.9\n",
}
SMALL_EXPERIMENT = (
    "medium: {kind: particle_layer}\ninstrument: {wavelength_nm: [800]}\nfigure: {kind: none}\n"
)
MAIN_SETTINGS = {"accuracies": {"standard": {"max_stderr": 0.1}}}
FOLDERS = {f"{kind}_folder": f"~/{kind}" for kind in ("experiments", "media", "measured")}


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Return a home folder with files, with another folder as working directory."""
    home, working_folder = tmp_path / "home", tmp_path / "here"
    for folder in (home / "media", home / "measured", home / "experiments", working_folder):
        folder.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(working_folder)
    for name, text in TABLES.items():
        (home / f"{name}.csv").write_text(text, encoding="utf-8")
    (home / "experiments" / "small.yaml").write_text(SMALL_EXPERIMENT, encoding="utf-8")
    splits.save(make_snowlike_table().dataset, home / "table.nc")
    yield home
    # No files are left in the working directory.
    assert list(working_folder.iterdir()) == []


def make_snow(**settings):
    return splits.Snow.natural(optical_radius_um=100, depth_m=0.02, **settings)


def make_figure():
    from matplotlib.figure import Figure

    return Figure()


def make_archive():
    pack_archive([], {"config/config.yaml": b"experiments: all\n"}, "~/archives/all.zip")
    return Path("~/archives/all.zip").expanduser()


WRITE_FUNCTIONS = {
    "save": (lambda path: splits.save(make_snowlike_table().dataset, path), "new/kept.nc"),
    "Table.to_csv": (lambda path: make_snowlike_table().to_csv(path), "new/table.csv"),
    "write_page": (
        lambda path: write_explorer({"a": ExplorerTable(make_snowlike_table(), "t.nc", "-")}, path),
        "a.html",
    ),
    "save_figure": (lambda path: save_figure(make_figure(), path), "figure.png"),
    "pack": (lambda path: pack_archive([], {"config/a.yaml": b""}, path), "archives/a.zip"),
}
RUN_WRITE_FUNCTIONS = {
    "table": (
        lambda path: (
            splits.build_table(
                make_snow, {"ground": ["black"]}, [500], max_stderr=0.2, folder=Path(path).parent
            ).dataset
        ),
        "blocks/block_*.nc",
    ),
}


@pytest.mark.parametrize(
    "name",
    [*WRITE_FUNCTIONS, *(pytest.param(name, marks=NEEDS_JIT) for name in RUN_WRITE_FUNCTIONS)],
)
def test_home_is_expanded_for_writing(name, home):
    write, path = {**WRITE_FUNCTIONS, **RUN_WRITE_FUNCTIONS}[name]
    write(f"~/{path.removesuffix('.png')}")
    assert [file for file in home.glob(path) if file.is_file()]


READ_FUNCTIONS = {
    "load": lambda: splits.load("~/table.nc"),
    "load, a Path": lambda: splits.load(Path("~/table.nc")),
    "Table": lambda: splits.Table("~/table.nc"),
    "refractive index": lambda: make_snow(refractive_index={"ice": "~/ice.csv"}),
    "ground": lambda: make_snow(ground="~/ground.csv"),
    "ground, a Path": lambda: make_snow(ground=Path("~/ground.csv")),
    "impurity": lambda: make_snow(impurities_ng_g={"mine": {"ng_g": 5, "table": "~/soot.csv"}}),
    "sky": lambda: splits.sky("~/sky.csv", 50.0),
    "band": lambda: splits.sky().make_bands({"mine": "~/band.csv"}),
    "measured": lambda: read_measured("~/measured.csv"),
    "experiment": lambda: load_experiment("~/experiments/small.yaml", "~/media", "~/measured"),
    "experiments": lambda: load_experiments("~/experiments", "~/media"),
    "verify": lambda: verify_archive(f"~/{make_archive().relative_to(Path.home())}"),
    "unpack": lambda: unpack_archive(f"~/{make_archive().relative_to(Path.home())}", "~/unpacked"),
}


@pytest.mark.parametrize("name", READ_FUNCTIONS)
def test_home_is_expanded_for_reading(name, home):
    assert READ_FUNCTIONS[name]() is not None


def test_home_is_expanded_in_configured_folders(home):
    settings = load_settings({**MAIN_SETTINGS, **FOLDERS, "results": "~/results"})
    assert settings.results_folder == str(home / "results")
    assert settings.table_folders["measured"] == home / "measured"
    assert list(load_experiments(settings.experiments_folder, settings.media_folder)) == ["small"]


def test_tables_at_home_are_packed_and_identified_by_content(home):
    (home / "media" / "own.yaml").write_text("ground: ~/ground.csv\n", encoding="utf-8")
    members = make_configuration_members(load_settings({**MAIN_SETTINGS, **FOLDERS}))
    packed_path = yaml.safe_load(members["config/media/own.yaml"])["ground"]
    assert members[packed_path] == TABLES["ground"].encode()
    assert identify_by_content("~/ground.csv") == identify_by_content(str(home / "ground.csv"))
    assert "unused" not in identify_by_content("~/ground.csv")


@NEEDS_JIT
def test_home_is_expanded_on_the_command_line(home, capsys):
    arguments = ["run", "~/experiments/small.yaml", "--output=~/made", "--media=~/media"]
    assert cli.main([*arguments, "--accuracy", "tiny", "--threads", "1"]) == 0
    assert capsys.readouterr().out.strip() == str(home / "made" / "small.nc")
    make_archive()
    assert cli.main(["unpack", "~/archives/all.zip", "~/all"]) == 0
    assert (home / "all" / "config" / "config.yaml").is_file()
    assert json.loads((home / "all" / "ro-crate-metadata.json").read_text("utf-8"))


def test_folders_named_by_a_tilde_are_accessible(home):
    working_folder = Path.cwd()
    for name in ("~", "~in"):
        splits.save(make_snowlike_table().dataset, f"./{name}/kept.nc")
        assert (working_folder / name / "kept.nc").is_file()
        assert splits.Table(f"./{name}/kept.nc") is not None
        shutil.rmtree(working_folder / name)


def test_an_unknown_home_is_rejected_in_one_line(home, capsys):
    with pytest.raises(InvalidValue, match=r"^path = '~unknown-user/a.nc': must be .* known"):
        splits.load("~unknown-user/a.nc")
    with pytest.raises(InvalidValue, match=r"^sky = '~unknown-user/a.csv': must be"):
        splits.sky("~unknown-user/a.csv")
    with pytest.raises(ConfigError, match="results = '~unknown-user/a': must be"):
        load_settings({**MAIN_SETTINGS, "results": "~unknown-user/a"})
    assert cli.main(["run", "a.yaml", "--output=~unknown-user"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    "value", [make_snowlike_table().dataset, make_snowlike_table(), None, 5, np.ones(3), b"a.nc"]
)
def test_invalid_path_types_are_rejected_in_one_line(value):
    kind = type(value).__name__
    with pytest.raises(InvalidValue, match=f"^path = '{kind}': must be the path of a file"):
        splits.load(value)
