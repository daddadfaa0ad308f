"""Trends of sand and shifts between datasets, for synthetic spectra of known slope."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.experiments import load_experiment
from workflow.papers.splits2007 import (
    make_composition_table,
    make_sand_trend_table,
    make_shift_table,
)

WAVELENGTHS = np.arange(400.0, 1001.0, 10.0)
GRIDS = {
    "samples": ("medium", ["one", "two"], 0.0),
    "iron_oxide": ("iron_oxide", [0.01, 0.05], -0.1),
    "magnetite": ("magnetite", [0.0, 0.3], -0.1),
    "texture": ("texture", ["coarse", "fine"], 0.1),
    "fine_fraction": ("texture", ["no clay", "clay"], 0.1),
    "hematite_ratio": ("hematite_ratio", [0.0, 0.9], 0.0),
    "wet_colours": ("saturation", [0.0, 0.5, 1.0], -0.1),
}


def make_spectra(dimension, values, step, error=0.005, redder=0.0):
    """Return spectra that rise with wavelength and change by `step` per value."""
    number = np.arange(len(values))[:, np.newaxis]
    slope = 1e-4 * (1.0 + redder * number)
    r = 0.4 + step * number + slope * (WAVELENGTHS - 400.0)
    return xr.Dataset(
        {
            "reflectance": ((dimension, "wavelength"), r),
            "reflectance_stderr": ((dimension, "wavelength"), np.full(r.shape, error)),
        },
        {dimension: values, "wavelength": WAVELENGTHS},
    )


def make_datasets(error=0.0005):
    datasets = {name: make_spectra(*grid, error=error) for name, grid in GRIDS.items()}
    ratio = GRIDS["hematite_ratio"]
    datasets["hematite_ratio"] = make_spectra(*ratio, error=error, redder=2.0)
    wet = datasets["wet_colours"]
    datasets["wet_colours"] = xr.concat([wet, wet], pd.Index(["one", "two"], name="medium"))
    return datasets


def test_satisfied_trends_agree():
    table = make_sand_trend_table(**make_datasets())
    assert (table.verdict == "agrees").all(), table.to_string()
    assert len(table) == 8


def test_trends_that_fail_have_their_verdicts():
    datasets = make_datasets()
    datasets["iron_oxide"] = make_spectra("iron_oxide", [0.01, 0.05], 0.1, error=0.0005)
    datasets["magnetite"] = make_spectra("magnetite", [0.0, 0.3], -1e-4, error=0.005)
    table = make_sand_trend_table(**datasets).set_index("quantity")
    verdicts = {q: v for q, v in table.verdict.items() if v != "agrees"}
    assert sorted(verdicts.values()) == ["not resolved at this accuracy", "outside"]


def test_shifts_are_differences_to_the_reference_with_errors():
    dataset = xr.concat(
        [
            make_spectra("medium", ["one", "two"], 0.0, 0.003),
            make_spectra("medium", ["one", "two"], 0.1, 0.004),
        ],
        dim=xr.DataArray(["default", "other"], dims="interpretation", name="interpretation"),
    )
    table = make_shift_table("interpretation", dataset, "interpretation", "default").set_index(
        "medium"
    )
    assert table["value"].unique().tolist() == ["other"]
    assert table.mean_shift["one"] == pytest.approx(0.0)
    assert table.mean_shift["two"] == pytest.approx(0.1)
    assert table.mean_shift_stderr["two"] == pytest.approx(0.005)
    assert table.largest_shift["two"] == pytest.approx(0.1)


def test_compositions_are_listed_once_per_sand(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "medium: {kind: sand, partition: [0.5, 0, 0.5]}\n"
        "grid: {iron_oxide: [0.01, 0.02], saturation: [0, 1]}\n"
        "instrument: {wavelength_nm: [500]}\n",
        encoding="utf-8",
    )
    snow = tmp_path / "snow.yaml"
    snow.write_text("instrument: {wavelength_nm: [500]}\n", encoding="utf-8")
    table = make_composition_table({p.stem: load_experiment(p) for p in (path, snow)})
    assert set(table.experiment) == {"mine"}
    assert table.groupby("iron_oxide").size().tolist() == [3, 3]
    for _, rows in table.groupby("iron_oxide"):
        assert rows.volume_fraction.sum() == pytest.approx(1.0, abs=1e-14)
