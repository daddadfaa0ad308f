"""The archive: an RO-Crate of data, figures and configuration, with checksums that verify."""

import hashlib
import json
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
import xarray as xr
import yaml
from rocrate.rocrate import ROCrate
from run_attributes import drop_run_specific_attributes

import splits
from splits.core.validation import ConfigError
from splits.experiments import load_experiment, load_settings
from splits.experiments.archive import make_configuration_members, pack_archive
from splits.experiments.config.settings import Settings
from splits.io.netcdf import get_git_commit, get_package_version
from splits.io.ro_crate import METADATA_FILE, Author, make_software_info
from splits.io.unarchive import unpack_archive

pytestmark = pytest.mark.long

EXPERIMENT = "title: Alone\nmedium: {depth_m: 0.01}\ninstrument: {wavelength_nm: [500, 900]}\n"
TABLES = "refractive_index: {ice: %s, water: my_water.csv}"
ALWAYS = {"CITATION.cff", "LICENSE", "README.md", "SHA256SUMS", METADATA_FILE, "versions.json"}
ROOT = Path(__file__).parents[2]
ADA = {"name": "Ada Example", "orcid": "0000-0002-1825-0097", "affiliation": "A University"}


def stand_for(*names):
    """Return substitutes of experiments by name."""
    return {name: SimpleNamespace(group="own") for name in names}


def read_members(path):
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
        return {name: file.read(name) for name in file.namelist()}


def check_checksums(members):
    """Assert that SHA256SUMS lists the checksums of all other members except the metadata."""
    lines = members["SHA256SUMS"].decode().splitlines()
    sums = {name: digest for digest, name in (line.split("  ") for line in lines)}
    assert set(sums) == set(members) - {"SHA256SUMS", METADATA_FILE}
    for name, digest in sums.items():
        assert hashlib.sha256(members[name]).hexdigest() == digest


@pytest.mark.slow
def test_archive_reproduces_its_run(project, tmp_path, tmp_path_factory, environment):
    own = tmp_path_factory.mktemp("somewhere") / "my_ice.csv"
    own.write_text("wavelength_nm,n,k\n400,1.32,2e-9\n1000,1.30,2e-6\n")
    near = tmp_path / "my_water.csv"
    near.write_text("wavelength_nm,n,k\n400,1.34,2e-9\n1000,1.33,3e-6\n")
    project.put("other", EXPERIMENT)
    medium = f"{{base: mine, depth_m: 0.01, {TABLES % own}}}"
    text = EXPERIMENT.replace("{depth_m: 0.01}", medium)
    project.put("deep/alone", f"{text}name: single\n")
    media = tmp_path_factory.mktemp("far") / "media"
    media.mkdir()
    (media / "mine.yaml").write_text("density_kg_m3: 300\n")
    chosen = f"accuracy=tiny experiments=single seed=7 media_folder={media}"
    chosen += " archive_license=CC-BY-4.0"
    run = project.snakemake("archive", "--cores", 2, config=chosen)
    assert run.code == 0, run.text
    members = read_members(tmp_path / "results" / "tiny" / "archive" / "splits-results.zip")
    check_checksums(members)
    assert set(members) >= ALWAYS | {"requirements.txt", "config/config.yaml"}
    drawn = {f"figures/single.{kind}" for kind in ("png", "svg", "pdf")}
    assert {"data/single.nc", *drawn} <= set(members)
    assert {"config/experiments/deep/alone.yaml", "config/media/mine.yaml"} <= set(members)
    assert not any("other" in name or ".." in name or name.startswith("/") for name in members)
    tables = [name for name in members if name.endswith(("my_ice.csv", "my_water.csv"))]
    assert sorted(members[name] for name in tables) == sorted([own.read_bytes(), near.read_bytes()])
    versions = json.loads(members["versions.json"])
    assert {"numpy", "numba", "snakemake", "xarray"} <= {name.lower() for name in versions}

    empty = tmp_path_factory.mktemp("empty")
    report = unpack_archive(tmp_path / "results" / "tiny" / "archive" / "splits-results.zip", empty)
    assert report.license == "https://spdx.org/licenses/CC-BY-4.0"
    assert (empty / "CITATION.cff").read_bytes() == (ROOT / "CITATION.cff").read_bytes()
    own.unlink()
    near.unlink()
    run = type(project)(empty, environment).snakemake("--cores", 2, config="")
    assert run.code == 0, run.text
    packed = splits.load(empty / "data" / "single.nc")
    repeated = splits.load(empty / "results" / "tiny" / "data" / "single.nc")
    xr.testing.assert_identical(
        drop_run_specific_attributes(repeated), drop_run_specific_attributes(packed)
    )
    assert packed.attrs["seed"] == 7
    assert packed.attrs["snow_density_kg_m3"] == 300.0
    assert packed.attrs["snow_refractive_index_ice"] == "my_ice.csv"
    assert len(packed.attrs["snow_refractive_index_ice_sha256"]) == 64
    texts = [value for value in packed.attrs.values() if isinstance(value, str)]
    assert not any(str(own.parent) in text or str(tmp_path) in text for text in texts)


@pytest.mark.slow
def test_archive_of_chosen_experiments_reproduces_those(project, tmp_path_factory, environment):
    table = "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n"
    for name in ("one", "two", "three"):
        project.put(name, table)
    run = project.snakemake("archive", "--cores", 2, config="accuracy=tiny archive=one,two")
    assert run.code == 0, run.text
    archive = project.folder / "results" / "tiny" / "archive" / "splits-results.zip"
    again = tmp_path_factory.mktemp("again")
    unpack_archive(archive, again)
    run = type(project)(again, environment).snakemake("--cores", 2, "--dry-run", config="")
    assert run.code == 0, run.text
    jobs = [f"{what} {name}" for what in ("Drawing", "Simulating") for name in ("one", "two")]
    assert [job for job in run.jobs() if job.endswith(("one", "two", "three"))] == jobs
    assert not any("three" in member for member in read_members(archive))


@pytest.mark.parametrize(
    ("given", "names"),
    [("all", "all"), ("a", ("a",)), ("a, b", ("a", "b")), (["a", "b"], ("a", "b"))],
)
def test_archive_setting_accepts_the_forms_of_experiments(given, names):
    accuracies = {"accuracies": {"standard": {"max_stderr": 0.1}}}
    settings = load_settings(accuracies | {"archive": given, "experiments": ["a", "b", "c"]})
    assert settings.archive == names
    archived = settings.select_archived(stand_for("a", "b", "c"))
    assert archived.experiments == (("a", "b", "c") if names == "all" else names)


def test_invalid_source_date_epoch_is_rejected_before_any_job(project, monkeypatch):
    project.put("one", "instrument: {kind: refractive_index, wavelength_nm: [500, 900]}\n")
    monkeypatch.setitem(project.environment, "SOURCE_DATE_EPOCH", "yesterday")
    run = project.snakemake("archive", "--cores", 1)
    assert run.code != 0 and "SOURCE_DATE_EPOCH = 'yesterday': must be seconds" in run.text
    assert run.jobs() == []


def test_packing_keeps_relative_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("out/data/a.nc", "out/tables/b.csv"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    configuration = {"config/c.yaml": b"c", "config/deep/d.yaml": b"d"}
    pack_archive(["out/data/a.nc", "out/tables/b.csv"], configuration, "out/archive/made.zip")
    members = read_members("out/archive/made.zip")
    assert set(members) - ALWAYS == {"data/a.nc", "tables/b.csv", *configuration}
    assert members["config/deep/d.yaml"] == b"d"
    check_checksums(members)


@pytest.fixture
def make_archive(tmp_path, monkeypatch):
    """Return a function that packs two files with a fixed time, and returns the archive."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for name in ("data/a.nc", "tables/of all.csv"):
        path = tmp_path / "out" / name
        path.parent.mkdir(parents=True)
        path.write_text(name)
    results = [tmp_path / "out" / "tables" / "of all.csv", tmp_path / "out" / "data" / "a.nc"]

    def make(name="made", **more):
        target = tmp_path / "out" / "archive" / f"{name}.zip"
        pack_archive(results, {"config/config.yaml": b"seed: 1\n"}, target, **more)
        return target

    return make


def test_an_archive_is_an_ro_crate(make_archive, tmp_path):
    authors = Settings(
        accuracies={"standard": {"max_stderr": 0.1}}, archive_authors=[ADA]
    ).list_authors()
    path = make_archive(repository=ROOT, licence="https://example.org/licence", authors=authors)
    unpack_archive(path, tmp_path / "crate")
    crate = ROCrate(tmp_path / "crate")
    root, program, run = crate.root_dataset, crate.get("#splits"), crate.get("#run")
    assert root["datePublished"] == "2023-11-14"
    assert root["license"].id == "https://example.org/licence"
    assert [author.id for author in root["author"]] == ["https://orcid.org/0000-0002-1825-0097"]
    assert root["author"][0].type == "Person"
    assert root["author"][0]["affiliation"]["name"] == "A University"
    assert root["mentions"] == run and run.type == "CreateAction"
    assert run["instrument"] == program and program.type == "SoftwareApplication"
    assert program["version"] == get_package_version()
    assert program["identifier"]["value"] == get_git_commit()
    assert program["license"].id == "https://spdx.org/licenses/MIT"
    assert program["author"][0]["name"] == "The SPLITS developers"
    assert [entity.id for entity in run["result"]] == ["data/a.nc", "tables/of%20all.csv"]
    assert [entity.id for entity in run["object"]] == ["config/config.yaml", "requirements.txt"]
    members = read_members(path)
    files = {Path(entity.source).relative_to(tmp_path / "crate").as_posix(): entity
             for entity in crate.get_by_type("File")}  # fmt: skip
    assert set(files) == set(members) - {METADATA_FILE}
    for name, entity in files.items():
        assert entity["sha256"] == hashlib.sha256(members[name]).hexdigest()
        assert entity["contentSize"] == str(len(members[name]))
    kinds = {
        "data/a.nc": "application/netcdf",
        "LICENSE": "text/plain",
        "README.md": "text/markdown",
    }
    assert {name: files[name]["encodingFormat"] for name in kinds} == kinds
    readme = members["README.md"].decode()
    assert "Ada Example" in readme and "splits unpack made.zip" in readme


def test_the_same_results_give_the_same_archive(make_archive, monkeypatch):
    first = make_archive(repository=ROOT).read_bytes()
    assert make_archive(repository=ROOT).read_bytes() == first
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    assert make_archive(repository=ROOT).read_bytes() != first
    for wrong in ("yesterday", "", "-1", "0", "9" * 30):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", wrong)
        with pytest.raises(ValueError, match=r"^SOURCE_DATE_EPOCH = .*must be seconds from 1980"):
            make_archive("wrong")


def test_highly_compressible_results_are_packed(make_archive, tmp_path):
    (tmp_path / "out" / "data" / "a.nc").write_bytes(bytes(2**22))
    assert read_members(make_archive())["data/a.nc"] == bytes(2**22)


def test_archive_of_installed_package_has_licence_and_authors(make_archive, tmp_path):
    """An installed wheel has no repository."""
    members = read_members(make_archive(repository=tmp_path))
    assert members["LICENSE"] == (ROOT / "LICENSE").read_bytes()
    written = yaml.safe_load(members["CITATION.cff"])
    shipped = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    keys = ("cff-version", "message", "type", "authors", "version", "license")
    assert {key: written[key] for key in keys} == {key: shipped[key] for key in keys}
    assert "requirements.txt" not in members


def test_authors_of_the_citation_are_those_of_the_results(make_archive, tmp_path):
    ada = {"family-names": "Example", "given-names": "Ada", "affiliation": "A University"}
    ada["orcid"] = "https://orcid.org/0000-0002-1825-0097"
    citation = {"authors": [ada, {"name": "A group"}], "license": "MIT"}
    (tmp_path / "CITATION.cff").write_text(yaml.safe_dump(citation))
    authors = make_software_info(tmp_path).authors
    ada_author = Author(**ADA | {"orcid": "https://orcid.org/0000-0002-1825-0097"})
    assert authors == (ada_author, Author("A group", is_person=False))
    crate = json.loads(read_members(make_archive(repository=tmp_path))[METADATA_FILE])
    root = next(entity for entity in crate["@graph"] if entity["@id"] == "./")
    assert root["author"] == [{"@id": "https://orcid.org/0000-0002-1825-0097"}, {"@id": "#A-group"}]


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"archive_license": 4.0}, "archive_license = 4.0: must be"),
        ({"archive_license": "CC\nBY"}, "without control characters"),
        ({"archive_authors": [{"orcid": "x"}]}, "archive_authors"),
        ({"archive_authors": [ADA | {"orcid": 12}]}, r"archive_authors\[0\]\.orcid = 12: must be"),
        ({"archive_authors": [ADA | {"name": "A\nB"}]}, "without control characters"),
        ({"archive_authors": "Ada"}, "archive_authors = 'Ada': must be"),
    ],
)
def test_invalid_authors_and_licences_are_rejected(given, line):
    with pytest.raises(ConfigError, match=f"^config/config.yaml: .*{line}") as caught:
        load_settings({"accuracies": {"standard": {"max_stderr": 0.1}}} | given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("names", [("config/A.yaml", "config/a.yaml"), ("config/aux.yaml",)])
def test_members_not_portable_to_all_systems_are_rejected(tmp_path, names):
    with pytest.raises(ValueError, match=r"^archive = 'config/a.*\.yaml': must be of members that"):
        pack_archive([], dict.fromkeys(names, b"x"), tmp_path / "out" / "archive" / "made.zip")
    assert not list(tmp_path.rglob("*.zip"))


@pytest.mark.parametrize("name", ["/etc/config.yaml", "../config.yaml", "config/../../x.yaml"])
def test_members_outside_the_archive_are_rejected(tmp_path, name):
    with pytest.raises(ValueError, match=r"^archive = '.*x?\.yaml': must be of members"):
        pack_archive([], {name: b"x"}, tmp_path / "out" / "archive" / "made.zip")
    assert not list(tmp_path.rglob("*.zip"))


@pytest.mark.parametrize("result", ["elsewhere/a.nc", "out/../elsewhere/a.nc"])
def test_results_outside_the_results_folder_are_rejected(tmp_path, monkeypatch, result):
    monkeypatch.chdir(tmp_path)
    for folder in ("elsewhere", "out"):
        (tmp_path / folder).mkdir()
    (tmp_path / "elsewhere" / "a.nc").write_text("a")
    with pytest.raises(ValueError, match=r"^archive = '.*a\.nc': must be of "):
        pack_archive([result], {}, "out/archive/made.zip")
    assert not list(tmp_path.rglob("*.zip"))


def test_effective_configuration_is_packed_below_config(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiments" / "deep").mkdir(parents=True)
    (tmp_path / "media").mkdir()
    (tmp_path / "config" / "tables").mkdir(parents=True)
    kept = tmp_path / "config" / "tables" / "kept.csv"
    moved = tmp_path / "moved.csv"
    kept.write_text("kept")
    moved.write_text("moved")
    plain = "# A comment.\nmedium: {refractive_index: {ice: config/tables/kept.csv}}\n"
    (tmp_path / "experiments" / "plain.yaml").write_text(plain)
    (tmp_path / "experiments" / "deep" / "b.yml").write_text(
        f"name: second\ntitle: '1e-5'\ngrid: {{refractive_index: {{mine: {{ice: {moved}}}}}}}\n"
    )
    for name in ("not_chosen", "third"):
        (tmp_path / "experiments" / f"{name}.yaml").write_text("{}")
    (tmp_path / "media" / "base.yaml").write_text("refractive_index: {water: config/../moved.csv}")
    settings = Settings(
        experiments=("plain", "second", "third"), archive=("plain", "second"),
        accuracy="rough", seed=3,
        accuracies={"rough": {"max_stderr": 0.1}}, results="/somewhere/results",
        experiments_folder=str(tmp_path / "experiments"), media_folder="experiments/../media",
    )  # fmt: skip
    members = make_configuration_members(settings.select_archived(stand_for(*settings.experiments)))
    digest = hashlib.sha256(b"moved").hexdigest()[:16]
    place = f"config/tables/{digest}/moved.csv"
    assert set(members) == {
        "config/config.yaml", "config/experiments/plain.yaml", "config/experiments/deep/b.yml",
        "config/media/base.yaml", "config/tables/kept.csv", place,
    }  # fmt: skip
    assert members["config/experiments/plain.yaml"].decode() == plain
    assert members[place] == b"moved"
    content = yaml.safe_load(members["config/experiments/deep/b.yml"])
    assert content["grid"] == {"refractive_index": {"mine": {"ice": place}}}
    assert "'1e-5'" in members["config/experiments/deep/b.yml"].decode()
    assert yaml.safe_load(members["config/media/base.yaml"])["refractive_index"]["water"] == place
    packed_settings = load_settings(yaml.safe_load(members["config/config.yaml"]))
    folders = {
        "experiments_folder": "config/experiments", "media_folder": "config/media",
        "results": "results", "archive": "all", "experiments": ("plain", "second"),
    }  # fmt: skip
    assert packed_settings == settings.model_copy(update=folders)


def test_hidden_files_are_skipped_and_unknown_types_rejected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "config" / "measured" / "field"
    folder.mkdir(parents=True)
    for name in ("snow.csv", "notes.md", ".DS_Store"):
        (folder / name).write_text("x", encoding="utf-8")
    settings = Settings(accuracies={"standard": {"max_stderr": 0.1}})
    archived = settings.select_archived(stand_for(*settings.experiments))
    members = set(make_configuration_members(archived)) - {"config/config.yaml"}
    assert members == {f"config/measured/field/{name}" for name in ("snow.csv", "notes.md")}
    (folder / "snow.xlsx").write_text("x", encoding="utf-8")
    line = r"^archive = 'config/measured/field/snow\.xlsx': must be .*not a file type of config"
    with pytest.raises(ValueError, match=line):
        make_configuration_members(archived)


def test_author_names_are_escaped_in_markdown(make_archive):
    author = Author("[A](https://a.org) <b>*B*</b>")
    readme = read_members(make_archive(authors=[author], licence="https://a.org/x_y"))[
        "README.md"
    ].decode()
    assert r"Authors: \[A\](https://a.org) \<b\>\*B\*\</b\>." in readme
    assert "Licence of the results: <https://a.org/x_y>." in readme


def test_no_archive_is_left_when_a_result_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"a\.nc"):
        pack_archive(
            [tmp_path / "out" / "data" / "a.nc"], {}, tmp_path / "out" / "archive" / "made.zip"
        )
    assert not list(tmp_path.rglob("*.zip"))


@pytest.mark.parametrize("place", ["{}/mine.csv", "../measured/mine.csv"])
def test_measured_tables_outside_the_measured_folder_are_rejected(tmp_path, place):
    folder = tmp_path / "config" / "measured"
    folder.mkdir(parents=True)
    (folder / "mine.csv").write_text("wavelength_nm,mine\n500,0.5\n")
    path = tmp_path / "mine.yaml"
    path.write_text(f"figure: {{measured: {place.format(folder)}}}\n")
    with pytest.raises(ConfigError, match=r"figure\.measured = .*must be the name of a file of"):
        load_experiment(path, tmp_path / "config" / "media")
