"""A ~ in a path is the user's home, wherever a path is given: in Python, YAML and the shell."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from chi2 import NEEDS_JIT
from formula_tables import snowlike

import splits
from splits import command
from splits.analysis.measured import read_measured
from splits.archive import configuration_members, pack
from splits.checks import Refusal
from splits.experiments import ConfigError, load_experiment, load_experiments, load_settings
from splits.experiments.user_tables import by_content
from splits.explorer.page import Shown, write_page
from splits.figures import save_figure
from splits.phase_functions import write_libradtran
from splits.unpacking import unpack, verify

TABLES = {
    "ice": "wavelength_nm,n,k\n200,1.3,0\n3000,1.3,1e-5\n",
    "ground": "wavelength_nm,albedo\n200,0.1\n3000,0.2\n",
    "soot": "wavelength_nm,absorption_m2_kg\n200,2\n3000,1\n",
    "sky": "wavelength_nm,direct,diffuse\n200,1,1\n3000,1,1\n",
    "band": "wavelength_nm,response\n500,1\n900,1\n",
    "measured": "# of others\nwavelength_nm,reflectance\n500,0.9\n",
}
SMALL = "medium: {kind: layer}\ninstrument: {wavelength_nm: [800]}\nfigure: {kind: none}\n"
MAIN = {"accuracies": {"standard": {"max_stderr": 0.1}}}
FOLDERS = {f"{kind}_folder": f"~/{kind}" for kind in ("experiments", "media", "measured")}
SOMEWHERE = dict.fromkeys(["country", "city", "street", "building_nr", "postal_code"], "-")
PEOPLE = {"organization": "-", "location": SOMEWHERE, "email": "-", "contact_person": "-"}


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Return a home with files in it, and stand in a folder beside it."""
    home, here = tmp_path / "home", tmp_path / "here"
    for folder in (home / "media", home / "measured", home / "experiments", here):
        folder.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(here)
    for name, text in TABLES.items():
        (home / f"{name}.csv").write_text(text, encoding="utf-8")
    (home / "experiments" / "small.yaml").write_text(SMALL, encoding="utf-8")
    splits.save(snowlike().dataset, home / "table.nc")
    yield home
    # Nothing lies where nobody looks for it.
    assert list(here.iterdir()) == []


def snow(**settings):
    return splits.Snow.natural(optical_radius_um=100, depth_m=0.02, **settings)


def layer(**settings):
    return splits.Layer(optical_thickness=0.5, **settings)


def grains():
    return splits.single_scattering(snow(), [500.0], moments=8, rays=100)


def brdf():
    return splits.goniophotometer(layer(), [500.0], 30.0, relative_stderr=0.5)


def figure():
    from matplotlib.figure import Figure

    return Figure()


def packed():
    pack([], {"config/config.yaml": b"experiments: all\n"}, "~/archives/all.zip")
    return Path("~/archives/all.zip").expanduser()


WRITES = {
    "save": (lambda path: splits.save(snowlike().dataset, path), "new/kept.nc"),
    "Table.to_csv": (lambda path: snowlike().to_csv(path), "new/table.csv"),
    "write_page": (lambda path: write_page({"a": Shown(snowlike(), "t.nc", "-")}, path), "a.html"),
    "save_figure": (lambda path: save_figure(figure(), path), "figure.png"),
    "pack": (lambda path: pack([], {"config/a.yaml": b""}, path), "archives/a.zip"),
}
WRITES_OF_RUNS = {
    "save_brdf": (lambda path: splits.save_brdf(brdf(), path, PEOPLE), "one.brdf"),
    "write_libradtran": (lambda path: write_libradtran(grains(), path), "grains.dat"),
    "table": (
        lambda path: splits.table(
            snow, {"ground": ["black"]}, [500], max_stderr=0.2, folder=Path(path).parent
        ),
        "blocks/block_000000_*.nc",
    ),
}


@pytest.mark.parametrize(
    "name", [*WRITES, *(pytest.param(name, marks=NEEDS_JIT) for name in WRITES_OF_RUNS)]
)
def test_what_is_written_lies_at_home(name, home):
    write, path = {**WRITES, **WRITES_OF_RUNS}[name]
    write(f"~/{path.removesuffix('.png')}")
    assert [one for one in home.glob(path) if one.is_file()]


READS = {
    "load": lambda: splits.load("~/table.nc"),
    "load, a Path": lambda: splits.load(Path("~/table.nc")),
    "open_table": lambda: splits.open_table("~/table.nc"),
    "refractive index": lambda: snow(refractive_index={"ice": "~/ice.csv"}),
    "ground": lambda: snow(ground="~/ground.csv"),
    "ground, a Path": lambda: snow(ground=Path("~/ground.csv")),
    "impurity": lambda: snow(impurities_ng_g={"mine": {"ng_g": 5, "table": "~/soot.csv"}}),
    "sky": lambda: splits.sky("~/sky.csv", 50.0),
    "band": lambda: splits.sky().make_bands({"mine": "~/band.csv"}),
    "measured": lambda: read_measured("~/measured.csv"),
    "experiment": lambda: load_experiment("~/experiments/small.yaml", "~/media", "~/measured"),
    "experiments": lambda: load_experiments("~/experiments", "~/media"),
    "verify": lambda: verify(f"~/{packed().relative_to(Path.home())}"),
    "unpack": lambda: unpack(f"~/{packed().relative_to(Path.home())}", "~/unpacked"),
}


@pytest.mark.parametrize("name", READS)
def test_what_lies_at_home_is_read(name, home):
    assert READS[name]() is not None


def test_folders_of_the_configuration(home):
    settings = load_settings({**MAIN, **FOLDERS, "results": "~/results"})
    assert settings.results_folder == str(home / "results")
    assert settings.table_folders["measured"] == home / "measured"
    assert list(load_experiments(settings.experiments_folder, settings.media_folder)) == ["small"]


def test_a_table_at_home_is_packed_and_counts_by_its_content(home):
    (home / "media" / "own.yaml").write_text("ground: ~/ground.csv\n", encoding="utf-8")
    members = configuration_members(load_settings({**MAIN, **FOLDERS}))
    moved = yaml.safe_load(members["config/media/own.yaml"])["ground"]
    assert members[moved] == TABLES["ground"].encode()
    assert by_content("~/ground.csv") == by_content(str(home / "ground.csv"))
    assert "unused" not in by_content("~/ground.csv")


@NEEDS_JIT
def test_the_command_line(home, capsys):
    said = ["run", "~/experiments/small.yaml", "--output=~/made", "--media=~/media"]
    assert command.main([*said, "--accuracy", "tiny", "--threads", "1"]) == 0
    assert capsys.readouterr().out.strip() == str(home / "made" / "small.nc")
    packed()
    assert command.main(["unpack", "~/archives/all.zip", "~/all"]) == 0
    assert (home / "all" / "config" / "config.yaml").is_file()
    assert json.loads((home / "all" / "ro-crate-metadata.json").read_text("utf-8"))


def test_what_has_that_name_itself_is_reached(home):
    here = Path.cwd()
    for name in ("~", "~in"):
        splits.save(snowlike().dataset, f"./{name}/kept.nc")
        assert (here / name / "kept.nc").is_file()
        assert splits.open_table(f"./{name}/kept.nc") is not None
        shutil.rmtree(here / name)


def test_a_home_that_is_not_known_is_refused_in_a_line(home, capsys):
    with pytest.raises(Refusal, match=r"^path = '~nobody-here/a.nc': must be .* known"):
        splits.load("~nobody-here/a.nc")
    with pytest.raises(Refusal, match=r"^sky = '~nobody-here/a.csv': must be"):
        splits.sky("~nobody-here/a.csv")
    with pytest.raises(ConfigError, match="results = '~nobody-here/a': must be"):
        load_settings({**MAIN, "results": "~nobody-here/a"})
    assert command.main(["run", "a.yaml", "--output=~nobody-here"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("call", [splits.load, splits.open_table])
@pytest.mark.parametrize("given", [snowlike().dataset, snowlike(), None, 5, np.ones(3), b"a.nc"])
def test_what_is_no_path_is_refused_in_a_line(call, given):
    kind = type(given).__name__
    with pytest.raises(Refusal, match=f"^path = '{kind}': must be the path of a file") as refused:
        call(given)
    told = kind == "Dataset" and call is splits.open_table
    assert ("splits.Table(…) takes a dataset" in str(refused.value)) == told
