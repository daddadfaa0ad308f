"""Studies of sensitivity and tables of numbers: checks before a run, and order of values."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from shipped import CONFIG

from splits.core.yaml import ConfigError, dump_yaml, read_yaml
from splits.experiments import load_experiment, load_experiments, load_settings
from splits.experiments.papers.sensitivity_table import (
    make_sensitivity_table,
    select_chosen_sensitivities,
)

ROOT = Path(__file__).parents[3]
SETTINGS_CONTENT = read_yaml(CONFIG / "config.yaml")
SETTINGS_CONTENT |= {
    f"{name}_folder": str(CONFIG / name) for name in ("media", "measured", "published")
}
DENSITIES = {"medium": {"base": "splitsnow_table1"}}


def select_pair(tmp_path, grid, name="density", files=None, **ends):
    """Check a study of sensitivity to the densities of an experiment."""
    path = tmp_path / "dense.yaml"
    path.write_text(dump_yaml({**DENSITIES, "grid": {"depth_m": [0.12, 0.02], **grid}}), "utf-8")
    available = {"dense": load_experiment(path)}
    pair = {"parameter": next(iter(grid)), "experiment": "dense", **ends}
    study = {"kind": "sensitivity", "pairs": {name: pair}, "files": files or {}}
    settings = load_settings({**SETTINGS_CONTENT, "studies": {"mine": study}, "explorer": {},
                              "explorer_directions": {}})  # fmt: skip
    settings.select_experiments(available)
    return settings.studies["mine"]


VALUES = {"density_kg_m3": [100, 300, 500]}
NAMED_VALUES = {"density_kg_m3": {"light": 100, "dense": 500}}
SIZES = {"grain_size_um": [[100, 200], [900, 1000]]}


@pytest.mark.parametrize(
    ("grid", "ends", "message"),
    [
        (VALUES, {"low": 100, "high": 100}, r"pairs.density.high = 100.*: must be different from"),
        (VALUES, {"low": "100", "high": 500}, "must be an experiment with density_kg_m3 = 100 on"),
        (NAMED_VALUES, {"low": "light", "high": "dense"}, "with density_kg_m3 = light on its grid"),
        (SIZES, {"low": 150, "high": "900-1000"}, "with grain_size_um = 150.0 on its grid"),
    ],
)
def test_ends_of_a_pair_are_values_of_the_coordinate(tmp_path, grid, ends, message):
    with pytest.raises(ConfigError, match=message):
        select_pair(tmp_path, grid, **ends)


def test_published_numbers_of_all_pairs_are_required(tmp_path):
    files, ends = {"published": "splitsnow2021.csv"}, {"low": 100, "high": 500}
    select_pair(tmp_path, VALUES, files=files, **ends)
    with pytest.raises(ConfigError, match="a table with msi_r_roughness, msi_t_roughness"):
        select_pair(tmp_path, VALUES, "roughness", files, **ends)


def test_tables_of_studies_need_their_columns(tmp_path):
    shipped = load_experiments(CONFIG / "experiments", CONFIG / "media")
    shutil.copytree(CONFIG / "measured", tmp_path / "measured")
    file = tmp_path / "measured" / "aviris_ng_varsa2021.csv"
    file.write_text(file.read_text("utf-8").replace("reflectance_min", "smallest"), "utf-8")
    content = {**SETTINGS_CONTENT, "measured_folder": str(tmp_path / "measured")}
    with pytest.raises(
        ConfigError, match=r"files\.aviris = .*: must be a table with reflectance_min"
    ):
        load_settings(content).select_experiments(shipped)


@pytest.mark.parametrize("grid", [VALUES, {"density_kg_m3": [500, 300, 100]}])
@pytest.mark.parametrize("ends", [(100, 500), (500, 100)])
def test_the_order_of_the_ends_of_a_pair_has_no_effect(tmp_path, grid, ends):
    study = select_pair(tmp_path, grid, low=ends[0], high=ends[1])
    sizes = {"density_kg_m3": 3, "depth_m": 2, "wavelength": 2}
    rng = np.random.default_rng(1)
    dataset = xr.Dataset(
        {
            f"{quantity}{suffix}": (tuple(sizes), rng.random(tuple(sizes.values())))
            for quantity in ("reflectance", "transmittance")
            for suffix in ("", "_stderr")
        },
        {"density_kg_m3": np.array(grid["density_kg_m3"], float), "depth_m": [0.12, 0.02],
         "wavelength": [500.0, 900.0]},
    )  # fmt: skip
    pairs = {"density": study.pairs["density"].model_dump()}
    pairs["density"]["interpretation_experiment"] = "several"
    several = dataset.expand_dims(interpretation=["default", "other"])
    table = make_sensitivity_table({"dense": dataset, "several": several}, pairs)
    chosen = table[table.chosen]
    assert len(chosen) == 2
    assert {*chosen.low, *chosen.high} == {100.0, 500.0}
    other = table[table.interpretation == "other"]
    np.testing.assert_allclose(other.msi, chosen.msi)
    assert select_chosen_sensitivities(table).sizes == {"quantity": 2, "parameter": 1}
