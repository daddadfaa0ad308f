"""Tables in the workflow: their parts as jobs, and recomputation of lost blocks only."""

import json

import numpy as np
import pytest
import xarray as xr
from run_attributes import drop_run_specific_attributes

import splits
from splits.core.validation import ConfigError, InvalidValue
from splits.experiments import load_experiment

pytestmark = [pytest.mark.slow, pytest.mark.long]

TABLE = """\
title: Table
medium: {kind: natural_snow}
instrument: {kind: table, wavelength_nm: [500, 1030], parts: 2, solver: monte_carlo}
grid:
  optical_radius_um: {geomspace: [50, 800, 5]}
  incidence_deg: [0, 40, 60]
  impurities_ng_g.black_carbon: [0, 200]
"""
RESULTS = "results/tiny"


def test_table_is_built_in_parts_and_rebuilt_from_kept_blocks(project):
    project.put("snow", TABLE)
    run = project.snakemake("--cores", 2)
    assert run.code == 0, run.text
    assert run.jobs() == [
        "Assembling snow", "Drawing snow", "Simulating part 0 of snow", "Simulating part 1 of snow",
        "Writing the report",
    ]  # fmt: skip
    assert "2 of 3 axes share paths (optical_radius_um, impurities_ng_g.black_carbon)" in run.text
    results = project.folder / RESULTS
    table = splits.Table(results / "data" / "snow.nc")
    assert table.axes[:-1] == [
        "optical_radius_um", "incidence_deg", "impurities_ng_g.black_carbon",
    ]  # fmt: skip
    assert table.dataset.attrs["experiment"] == "snow"
    assert table.dataset.attrs["ensembles"] == 3
    assert np.isfinite(table.dataset.reflectance).all()
    expected = splits.build_table(
        lambda optical_radius_um, soot: splits.Snow.natural(
            optical_radius_um=optical_radius_um, impurities_ng_g={"black_carbon": soot}
        ),
        {
            "optical_radius_um": table.dataset.optical_radius_um.values,
            "incidence_deg": [0, 40, 60], "soot": [0, 200],
        },
        [500, 1030],
        max_stderr=0.05, solver="monte_carlo",
    ).dataset  # fmt: skip
    np.testing.assert_array_equal(table.dataset.reflectance, expected.reflectance)

    # Of a lost part, a lost table and a lost block, only the block is measured again.
    blocks = results / "blocks" / "snow"
    kept, lost = (blocks / name for name in json.loads((blocks / "part_0.json").read_text()))
    (blocks / "part_0.json").unlink()
    (results / "data" / "snow.nc").unlink()
    lost.unlink()
    target = f"{RESULTS}/data/snow.nc"
    before = kept.stat().st_mtime_ns
    run = project.snakemake(target, "--cores", 2)
    assert run.code == 0, run.text
    assert kept.stat().st_mtime_ns == before and lost.exists()
    rebuilt = splits.load(results / "data" / "snow.nc")
    xr.testing.assert_identical(
        drop_run_specific_attributes(rebuilt), drop_run_specific_attributes(table.dataset)
    )
    # Blocks that no part lists are removed.
    assert len(list(blocks.glob("block_*.nc"))) == 3
    assert "Nothing to be done" in project.snakemake(target, "--cores", 1).text


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("[0, 40, 60]", "[0, 60, 40]"), "increasing numbers"),
        (("[0, 200]", "[0, -200]"), "must be"),
        (("geomspace: [50, 800, 5]", "geomspace: [0, 800, 5]"), "geomspace.*0 < first < last"),
        (("black_carbon", "coal"), "impurities_ng_g"),
        (("parts: 2", "parts: 0"), "instrument.parts"),
        (("kind: table,", "kind: goniophotometer,"), "left out for goniophotometer"),
    ],
)
def test_invalid_tables_are_rejected(tmp_path, change, line):

    path = tmp_path / "snow.yaml"
    path.write_text(TABLE.replace(*change), encoding="utf-8")
    with pytest.raises((ConfigError, InvalidValue), match=line) as caught:
        load_experiment(path, tmp_path)
    assert "\n" not in str(caught.value)
