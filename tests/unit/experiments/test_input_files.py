"""Files that media read are inputs of the workflow, whatever their names; names are none."""

import hashlib
import json

import numpy as np
import pandas as pd
import pytest
import xarray as xr
import yaml
from experiment_jobs import start_jobs

import splits
from splits.core.validation import ConfigError
from splits.experiments import load_experiment
from splits.experiments.archive import list_table_files, make_configuration_members
from splits.experiments.config.instruments import SKIES, Instrument
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.settings import Settings
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run import list_point_keys
from splits.experiments.run_table import run_packs
from splits.instruments.sky_mixing import choose_wavelengths
from splits.io.cache import compute_digest

LAYER = "kind: particle_layer, optical_thickness: 4, single_scattering_albedo: 0.9"
ANGLES = np.linspace(0.0, 180.0, 5)


def write_matrix(path, scale):
    columns = {"angle_deg": ANGLES, "P11": scale * (1.5 + np.cos(np.radians(ANGLES)))}
    columns |= {name: 0.0 * ANGLES for name in ("P12", "P33", "P34")}
    if path.suffix.lower() in (".nc", ".cdf", ".netcdf"):
        dataset = xr.Dataset({name: ("angle", values) for name, values in columns.items()})
        dataset.to_netcdf(path)
    else:
        pd.DataFrame(columns).to_csv(path, index=False)


def write_spectrum(name, value):
    """Return a function that writes a table of a quantity over wavelength."""

    def write(path, scale):
        columns = {"wavelength_nm": [400.0, 1000.0], name: scale * value, "k": 1e-6}
        pd.DataFrame(columns).to_csv(path, index=False)

    return write


def write_packs(path, scale):
    columns = {"thickness_m": scale * 0.1, "density_kg_m3": 200.0}
    columns["specific_surface_area_m2_kg"] = 20.0
    if path.suffix.lower() == ".nc":
        dims = ("time", "layer")
        times = {"time": pd.date_range("2024-03-01", periods=1)}
        xr.Dataset({n: (dims, [[v]]) for n, v in columns.items()}, times).to_netcdf(path)
    else:
        row = {"time": "2024-03-01", "layer": 0, **columns}
        pd.DataFrame([row]).to_csv(path, index=False)


write_index, write_ground = write_spectrum("n", 1.3), write_spectrum("albedo", 0.3)
write_absorption = write_spectrum("absorption_m2_kg", 100.0)
SNOW, STACK = "medium: {depth_m: 0.1}\n", "kind: stack, layers: [{depth_m: 0.1}]"
CASES = {
    "matrix in netCDF": (f"medium: {{{LAYER}, scattering_matrix: %s}}", "a.cdf", write_matrix),
    "netCDF in capitals": (f"medium: {{{LAYER}, scattering_matrix: %s}}", "a.NC", write_matrix),
    "long suffix": (f"medium: {{{LAYER}, scattering_matrix: %s}}", "a.netcdf", write_matrix),
    "matrix in text": (f"medium: {{{LAYER}, scattering_matrix: %s}}", "a.txt", write_matrix),
    "no suffix": (f"medium: {{{LAYER}, scattering_matrix: %s}}", "mie", write_matrix),
    "matrices of a grid": (
        f"medium: {{{LAYER}}}\ngrid: {{scattering_matrix: [%s]}}", "a.dat", write_matrix),
    "matrix of a label": (
        f"medium: {{{LAYER}}}\ngrid: {{scattering_matrix: {{one: %s}}}}", "a.dat", write_matrix),
    "matrix of a layer": (
        f"medium: {{kind: stack, layers: [{{{LAYER}, scattering_matrix: %s}}]}}",
        "a.dat", write_matrix),
    "parameter of a layer": (
        f"medium: {{kind: stack, layers: [{{{LAYER}}}]}}\n"
        "grid: {layers.0.scattering_matrix: {one: %s}}", "a.dat", write_matrix),
    "layers of a grid": (
        f"medium: {{{STACK}}}\n"
        f"grid: {{layers: {{one: [{{{LAYER}, scattering_matrix: %s}}]}}}}", "a.dat", write_matrix),
    "impurity": (
        "medium: {depth_m: 0.1, impurities_ng_g: {ash: {ng_g: 9, table: %s}}}",
        "ash.txt", write_absorption),
    "impurity named like a key": (
        "medium: {depth_m: 0.1, impurities_ng_g: {table: {ng_g: 9, table: %s}}}",
        "ash", write_absorption),
    "impurity of a grid": (
        SNOW + "grid: {impurities_ng_g.ash: {much: {ng_g: 9, table: %s}}}",
        "ash.txt", write_absorption),
    "medium of a grid": (
        SNOW + "grid: {medium: {dirty: {impurities_ng_g: {ash: {ng_g: 9, table: %s}}}}}",
        "ash.txt", write_absorption),
    "ground": ("medium: {depth_m: 0.1, ground: %s}", "soil.CSV", write_ground),
    "ground of a label": (SNOW + "grid: {ground: {file: %s}}", "soil.csv", write_ground),
    "refractive index": (
        "medium: {depth_m: 0.1, refractive_index: {ice: %s}}", "ice.CSV", write_index),
    "snowpacks": ("medium: {kind: snow_packs, file: %s}", "season.CSV", write_packs),
    "snowpacks in netCDF": ("medium: {kind: snow_packs, file: %s}", "season.NC", write_packs),
}  # fmt: skip
"""Text of an experiment with the place of a path, name of the file, and function that writes it."""


@pytest.fixture(params=CASES)
def experiment_file(request, tmp_path, monkeypatch):
    """Return the file of an experiment, the file that its medium reads, and what writes that."""
    text, name, write = CASES[request.param]
    monkeypatch.chdir(tmp_path)
    write(tmp_path / name, 1.0)
    path = tmp_path / "mine.yaml"
    path.write_text(f"{text % name}\ninstrument: {{wavelength_nm: [550]}}\n", encoding="utf-8")
    return path, name, write


def test_a_file_that_is_read_is_an_input(experiment_file):
    path, name, write = experiment_file
    experiment = load_experiment(path)
    assert experiment.list_table_paths() == [name]
    table = path.with_name(name)
    digest = hashlib.sha256(table.read_bytes()).hexdigest()
    assert f"{name} sha256:{digest}" in experiment.dump_configuration()
    before = experiment.dump_configuration()
    write(table, 0.5)
    assert experiment.dump_configuration() != before
    table.unlink()
    with pytest.raises(ConfigError, match=r"must be (an existing|a file that|a netCDF)"):
        load_experiment(path)


def test_an_archive_has_the_files_that_are_read(experiment_file, tmp_path, monkeypatch):
    path, name, _ = experiment_file
    (tmp_path / "own").mkdir()
    path.rename(tmp_path / "own" / "mine.yaml")
    settings = Settings(
        experiments=("mine",), experiments_folder="own",
        accuracies={"standard": {"max_stderr": 0.1}},
    )  # fmt: skip
    assert [str(table) for table in list_table_files(settings)] == [name]
    unpacked = tmp_path / "unpacked"
    for member, content in make_configuration_members(settings).items():
        (unpacked / member).parent.mkdir(parents=True, exist_ok=True)
        (unpacked / member).write_bytes(content)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).unlink()
    monkeypatch.chdir(unpacked)
    (table,) = load_experiment("config/experiments/mine.yaml").list_table_paths()
    assert table.startswith("config/tables/") and name in table
    assert (unpacked / table).read_bytes() == content


@pytest.mark.parametrize(
    "text",
    [
        "medium: {depth_m: 0.1, ground: black, refractive_index: {ice: '1.31+1e-7j'}}",
        "medium: {depth_m: 0.1}\ngrid: {ground: {file: black, table: open}}",
        f"medium: {{{LAYER}}}\ngrid: {{phase_function: {{file: rayleigh}}}}",
        "medium: {depth_m: 0.1}\ngrid: {refractive_index: {scattering_matrix: {ice: '1.31'}}}",
        "medium: {depth_m: 0.1}\ngrid: {interpretation: {ground: {entry_point: uniform}}}",
    ],
)
def test_names_are_no_files_even_if_files_have_them(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    for name in ("black", "open", "rayleigh", "1.31", "uniform"):
        (tmp_path / name).write_text("no table", encoding="utf-8")
    path = tmp_path / "mine.yaml"
    path.write_text(f"{text}\ninstrument: {{wavelength_nm: [550]}}\n", encoding="utf-8")
    assert load_experiment(path).list_table_paths() == []


def test_stored_points_depend_on_the_content_of_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = f"medium: {{{LAYER}, scattering_matrix: mie}}\ninstrument: {{wavelength_nm: [550]}}\n"
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    keys = []
    for scale in (1.0, 1.0, 2.0):
        write_matrix(tmp_path / "mie", scale)
        experiment = load_experiment("mine.yaml")
        keys.append(compute_digest(*list_point_keys(experiment, Accuracy(max_stderr=0.1), 1)))
    assert keys[0] == keys[1] != keys[2]


def test_paths_of_inputs_are_those_that_snakemake_finds(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    write_matrix(tmp_path / "mie.txt", 1.0)
    (tmp_path / "link.txt").symlink_to("mie.txt")
    grid = "{a: ./mie.txt, b: ~/mie.txt, c: link.txt}"
    text = f"medium: {{{LAYER}}}\ngrid: {{scattering_matrix: {grid}}}\n"
    (tmp_path / "mine.yaml").write_text(text + "instrument: {wavelength_nm: [550]}\n")
    paths = load_experiment("mine.yaml").list_table_paths()
    assert paths == sorted([str(tmp_path / "mie.txt"), "link.txt", "mie.txt"])


def test_files_of_a_grid_are_labelled_by_their_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mie").mkdir()
    for name in ("fine.txt", "coarse.cdf"):
        write_matrix(tmp_path / "mie" / name, 1.0)
    text = f"medium: {{{LAYER}}}\ngrid: {{scattering_matrix: [mie/fine.txt, mie/coarse.cdf]}}\n"
    (tmp_path / "mine.yaml").write_text(text + "instrument: {wavelength_nm: [550]}\n")
    grid = load_experiment("mine.yaml").grid
    assert list(grid["scattering_matrix"]) == ["fine.txt", "coarse.cdf"]


def test_an_archive_has_media_of_both_suffixes_and_selected_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("own", "media"):
        (tmp_path / folder).mkdir()
    for name in ("soil.csv", "rock.csv"):
        write_ground(tmp_path / name, 1.0)
    (tmp_path / "media" / "first.yml").write_text("ground: soil.csv\n")
    (tmp_path / "media" / "unused.yaml").write_text("ground: rock.csv\n")
    text = "medium: {depth_m: 0.1}\ngrid: {ground: [soil.csv, 0.2]}\n"
    text += "figure: {select: {ground: soil.csv}}\ninstrument: {wavelength_nm: [550, 600]}\n"
    (tmp_path / "own" / "mine.yaml").write_text(text)
    settings = Settings(
        experiments=("mine",), experiments_folder="own", media_folder="media",
        accuracies={"standard": {"max_stderr": 0.1}},
    )  # fmt: skip
    assert [str(path) for path in list_table_files(settings)] == ["rock.csv", "soil.csv"]
    members = make_configuration_members(settings)
    assert {"config/media/first.yml", "config/media/unused.yaml"} <= set(members)
    content = yaml.safe_load(members["config/experiments/mine.yaml"])
    place = content["grid"]["ground"][0]
    assert content["figure"]["select"]["ground"] == place and place in members


def test_place_of_a_season_gives_the_sun(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    times = pd.date_range("2024-03-20", periods=24, freq="h")
    columns = {"thickness_m": 0.5, "density_kg_m3": 200.0, "specific_surface_area_m2_kg": 20.0}
    table = pd.DataFrame({"time": times, "layer": 0, **columns})
    table.to_csv("season.csv", index=False)

    def load(**changes):
        medium = {"kind": "snow_packs", "file": "season.csv", **changes}
        content = {"medium": medium, "instrument": {"kind": "albedo"}}
        (tmp_path / "mine.yaml").write_text(json.dumps(content), encoding="utf-8")
        return load_experiment("mine.yaml").load_packs()

    zenith = load(latitude_deg=0.0, longitude_deg=0.0).dataset.sun_zenith_deg.values
    # At an equinox, the sun is at the zenith of the equator; the equation of time is 7.5 minutes.
    expected = np.abs(np.mod(15.0 * np.arange(24) - 7.5 / 4.0, 360.0) - 180.0)
    np.testing.assert_allclose(zenith, expected, atol=0.6)
    east = load(latitude_deg=0.0, longitude_deg=90.0).dataset.sun_zenith_deg.values
    np.testing.assert_allclose(np.roll(east, 6), zenith, atol=0.5)
    with pytest.raises(ConfigError, match=r"medium\.longitude_deg = None: must be given \(a pl"):
        load(latitude_deg=45.0)
    with pytest.raises(ConfigError, match=r"medium\.latitude_deg = 95: must be in \[-90, 90] deg"):
        load(latitude_deg=95, longitude_deg=0)
    load()
    with pytest.raises(ConfigError, match=r"sun_zenith_deg"):
        start_jobs(tmp_path / "mine.yaml", tmp_path / "media")
    table.assign(time=[f"pit {number}" for number in range(24)]).rename(
        columns={"time": "pit"}
    ).set_index(["pit", "layer"]).to_xarray().to_netcdf("pits.nc")
    with pytest.raises(ConfigError, match=r"medium\.latitude_deg.*left out for snowpacks without"):
        load(file="pits.nc", latitude_deg=45.0, longitude_deg=7.0)


def test_albedo_under_overcast_skies_needs_no_sun(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_packs(tmp_path / "season.csv", 1.0)
    medium, sky = "{kind: snow_packs, file: season.csv}", "midlatitude_winter_cloudy"
    text = f"medium: {medium}\ninstrument: {{kind: albedo, sky: {sky}}}\n"
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    experiment = load_experiment("mine.yaml")
    found = splits.albedo(experiment.load_packs(), sky, max_stderr=0.05, threads=1)
    assert np.isfinite(found.albedo).all()
    # The wavelengths are those of the sky in Python, also after the settings are stored.
    wavelengths = experiment.instrument.get_wavelengths()
    np.testing.assert_array_equal(wavelengths, found.wavelength)
    stored = SimulationConfig.model_validate(experiment.dump_simulation()).instrument
    np.testing.assert_array_equal(stored.get_wavelengths(), found.wavelength)


def test_default_wavelengths_of_an_experiment_are_those_of_albedos():
    for name in SKIES:
        zenith = None if name == "astm_g173" else 50.0
        wavelengths = choose_wavelengths(None, splits.sky(name, zenith), 2)
        found = Instrument.from_content({"kind": "albedo", "sky": name}).get_wavelengths()
        np.testing.assert_array_equal(found, wavelengths)
    given = {"kind": "albedo", "sky": SKIES[1], "wavelength_nm": [400, 500]}
    assert Instrument.from_content(given).get_wavelengths().tolist() == [400, 500]


def test_runs_name_the_first_value_out_of_range(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    columns = {"thickness_m": 0.1, "density_kg_m3": 200.0, "specific_surface_area_m2_kg": 20.0}
    table = pd.DataFrame({"time": pd.date_range("2024", periods=60), "layer": 0, **columns})
    # The second block of snowpacks has it.
    table.loc[55, "density_kg_m3"] = 0.2
    table.to_csv("season.csv", index=False)
    instrument = "{incidence_deg: diffuse, wavelength_nm: [500]}"
    text = f"medium: {{kind: snow_packs, file: season.csv}}\ninstrument: {instrument}\n"
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    lines = []
    accuracy = Accuracy(max_stderr=0.05)
    found = run_packs(load_experiment("mine.yaml"), accuracy, None, 1, lines.append)
    comment = "time 2024-02-25 00:00:00: layers.0.density_kg_m3 = 0.2: must be in [10, 916.9) kg/m3"
    assert comment in found.quality_flag.attrs["comment"] and comment in lines[-1]
    assert "1 out of range" in lines[-1] and "unsupported" in found.quality_flag.flag_meanings
