"""Snowpacks of a file in the workflow: blocks of snowpacks that are kept and simulated again."""

import json

import numpy as np
import pandas as pd
import pytest
from experiment_jobs import start_jobs

import splits
from splits.core.validation import ConfigError

SEASON = """\
title: Season
medium: {kind: snow_packs, file: season.csv, ground: 0.3}
instrument: {kind: albedo, wavelength_nm: [400, 800, 1200, 1800], bands: {near: [800, 1800]}}
"""
SPECTRA = "instrument: {incidence_deg: sun, wavelength_nm: [500, 1030]}\n"
N_PACKS = 120
NIGHT, GAP, CHANGED = 3, 7, 60


def make_rows():
    """Return snowpacks of two layers, of which one is at night and one has a missing value."""
    rows = pd.DataFrame({
        "time": np.repeat(pd.date_range("2024-03-01", periods=N_PACKS, freq="h"), 2),
        "layer": np.tile([0, 1], N_PACKS),
        "thickness_m": np.tile([0.05, 0.4], N_PACKS),
        "density_kg_m3": np.tile([150.0, 320.0], N_PACKS),
        "specific_surface_area_m2_kg": np.linspace(50.0, 10.0, 2 * N_PACKS),
        "sun_zenith_deg": np.repeat(np.linspace(20.0, 80.0, N_PACKS), 2),
    })  # fmt: skip
    rows.loc[[2 * NIGHT, 2 * NIGHT + 1], "sun_zenith_deg"] = 95.0
    rows.loc[2 * GAP, "density_kg_m3"] = np.nan
    return rows


def list_blocks(folder):
    """Return the blocks by name, with their times of modification."""
    return {path.name: path.stat().st_mtime_ns for path in sorted(folder.glob("block_*.nc"))}


@pytest.mark.slow
@pytest.mark.long
def test_season_is_resumed_and_only_changed_blocks_are_simulated(project):
    rows = make_rows()
    rows.to_csv(project.folder / "season.csv", index=False)
    project.put("season", SEASON)
    project.put("spectra", SEASON.split("instrument")[0] + SPECTRA)
    results = project.folder / "results/tiny"
    run = project.snakemake("season", "spectra", "--cores", 2)
    assert run.code == 0, run.text
    assert run.jobs() == [
        "Assembling season", "Assembling spectra", "Drawing season", "Drawing spectra",
        "Simulating part 0 of season", "Simulating part 0 of spectra",
    ]  # fmt: skip
    first = splits.load(results / "data/season.nc")
    packs = splits.SnowPacks(rows, ground=0.3)
    bands = {"near": (800, 1800)}
    expected = splits.albedo(packs, "clear", [400, 800, 1200, 1800], max_stderr=0.05, bands=bands)
    for name in ("albedo", "albedo_stderr", "band_albedo"):
        np.testing.assert_allclose(first[name], expected[name], rtol=1e-9)
    assert first.quality_flag.equals(expected.quality_flag)
    spectra = splits.spectrophotometer(packs, [500, 1030], "sun", max_stderr=0.05)
    found = splits.load(results / "data/spectra.nc")
    np.testing.assert_allclose(found.reflectance, spectra.reflectance, rtol=1e-9)
    assert np.isnan(first.albedo[[NIGHT, GAP]]).all() and first.attrs["snow_packs_good"] == 118

    # An interrupted run lacks a block, the list of the blocks, and the result.
    blocks = results / "blocks/season"
    before = list_blocks(blocks)
    kept, lost, last = json.loads((blocks / "part_0.json").read_text())
    for path in (blocks / lost, blocks / "part_0.json", results / "data/season.nc"):
        path.unlink()
    assert project.snakemake("season", "--cores", 1).code == 0
    after = list_blocks(blocks)
    assert [name for name in before if after[name] != before[name]] == [lost]
    assert splits.load(results / "data/season.nc").albedo.equals(first.albedo)

    rows.loc[2 * CHANGED, "density_kg_m3"] = 100.0
    rows.to_csv(project.folder / "season.csv", index=False)
    assert project.snakemake("season", "--cores", 1).code == 0
    changed = list_blocks(blocks)
    assert len(changed) == 3 and lost not in changed
    assert [changed[name] for name in (kept, last)] == [after[name] for name in (kept, last)]
    second = splits.load(results / "data/season.nc")
    different = (second.albedo != first.albedo).any("wavelength") & (first.quality_flag == 0)
    assert np.flatnonzero(different).tolist() == [CHANGED]
    assert "Nothing to be done" in project.snakemake("season", "--cores", 1).text


@pytest.mark.slow
@pytest.mark.long
def test_a_result_that_would_replace_its_input_is_rejected(project):
    path = project.folder / "results/tiny/data/season.nc"
    path.parent.mkdir(parents=True)
    splits.save(splits.SnowPacks(make_rows()).dataset, path)
    project.put("season", SEASON.replace("season.csv", "results/tiny/data/season.nc"))
    run = project.snakemake("season", "-n")
    assert run.code and "'season': must be another name: the result would replace" in run.text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SEASON.replace("season.csv", "none.csv"),
         r"medium\.file = '.*none\.csv': .*exists \(looked in"),
        (SEASON.replace("0.3", "camborthid"),
         r"line 3: instrument\.wavelength_nm = 1200.*\[400, 1000\] nm, the range of ground camb"),
        (SEASON.replace("season.csv", "season.txt"), r"medium\.file = '.*season\.txt': .*\.csv"),
        (SEASON.replace("file:", "path:"), r"medium\.file"),
        (SEASON.replace("0.3", "1.5"), r"medium\.ground = 1\.5"),
        (SEASON.replace("kind: albedo", "kind: albedo, sky: bright"), r"instrument\.sky"),
        (SEASON.replace("1800]", "3000]"), r"instrument\.wavelength_nm.*3000 nm"),
        (SEASON.replace("albedo", "goniophotometer"), r"instrument\.kind|instrument\.bands"),
        (SEASON + "grid: {ground: [0.1, 0.3]}\n", "grid"),
        (SEASON + "figure: {kind: spectra}\n", r"figure\.kind"),
        (SEASON.split("instrument")[0] + SPECTRA.replace("inc", "solver: monte_carlo, inc"),
         r"instrument\.solver = 'monte_carlo'"),
        ("medium: {kind: natural_snow, specific_surface_area_m2_kg: 20}\n" + SPECTRA,
         r"instrument\.incidence_deg = 'sun'"),
        ("instrument: {kind: albedo}\n", r"instrument\.sky = 'clear'.*only snowpacks of a file"),
    ],
)  # fmt: skip
def test_invalid_settings_are_named(tmp_path, text, message):
    make_rows().to_csv(tmp_path / "season.csv", index=False)
    (tmp_path / "season.txt").write_text("")
    for name in ("season.csv", "none.csv", "season.txt"):
        text = text.replace(f"{'file'}: {name}", f"file: {tmp_path / name}")
    path = tmp_path / "experiment.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message) as error:
        start_jobs(path, tmp_path)
    assert "\n" not in str(error.value)
