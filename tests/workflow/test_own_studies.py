"""Studies of users over their own experiments, and studies with missing experiments."""

import pandas as pd
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.long]

EXPERIMENT = """\
instrument: {wavelength_nm: [400, 1000, 2500]}
grid: {depth_m: [0.12, 0.02], temperature_c: [-5, -1]}
"""
STUDY = """
  warming:
    function: workflow.papers.sensitivity.make_sensitivities
    inputs: {temperature: cold}
    options: {pairs: {temperature: {parameter: temperature_c, low: -5, high: -1}}}
    outputs: {warming.csv: {}, warming_chosen.csv: {}, warming_index.nc: {}, warming_index.png: {}}
"""


def test_user_study_makes_its_outputs(project):
    project.put("cold", EXPERIMENT)
    with open(project.folder / "config" / "config.yaml", "a", encoding="utf-8") as file:
        file.write(STUDY)
    run = project.snakemake("--cores", 1)
    assert run.code == 0, run.text
    assert project.results("results/tiny") == [
        "data/cold.nc", "data/warming_index.nc",
        "figures/cold.pdf", "figures/cold.png", "figures/cold.svg",
        "figures/warming_index.pdf", "figures/warming_index.png", "figures/warming_index.svg",
        "report.html", "tables/warming.csv", "tables/warming_chosen.csv",
    ]  # fmt: skip
    table = pd.read_csv(project.folder / "results" / "tiny" / "tables" / "warming_chosen.csv")
    assert set(table.parameter) == {"temperature"} and "published" not in table
    report = (project.folder / "results" / "tiny" / "report.html").read_text(encoding="utf-8")
    # The study has no key reproduces, so it is not listed under a paper.
    assert "Own experiments" in report and "Figure 23" not in report


def test_requested_study_with_missing_experiments_is_reported(project):
    project.put("cold", EXPERIMENT)
    run = project.snakemake("layer_trends", "--cores", 1)
    assert run.code != 0
    (line,) = [line for line in run.text.splitlines() if "is left out" in line]
    assert line.startswith("study layer_trends is left out: no such experiment: layer_fig02_lens")
    assert "Traceback" not in run.text


TABLE = """\
medium: {kind: natural_snow}
instrument: {kind: table, wavelength_nm: {start: 400, stop: 1300, step: 100}, parts: 1}
grid: {optical_radius_um: [50, 100, 200, 400], impurities_ng_g.black_carbon: [0, 100, 500]}
retrieve:
  measured: snow_albedo_letcher2022.csv
  samples: [albedo_340mm]
  free: [optical_radius_um, impurities_ng_g.black_carbon, scale]
  noise: {relative: 0.02}
"""


def test_user_retrieval_makes_its_outputs(project):
    project.put("grains", TABLE)
    run = project.snakemake("--cores", 1)
    assert run.code == 0, run.text
    outputs = [path for path in project.results("results/tiny") if not path.startswith("blocks")]
    assert outputs == [
        "data/grains.nc",
        "figures/grains.pdf", "figures/grains.png", "figures/grains.svg",
        "report.html", "tables/grains_retrieved.csv",
    ]  # fmt: skip
    tables = project.folder / "results" / "tiny" / "tables"
    retrieved = pd.read_csv(tables / "grains_retrieved.csv")
    assert list(retrieved["sample"].unique()) == ["albedo_340mm"]
    # Settings of the retrieval do not change the table.
    changed = TABLE.replace("relative: 0.02", "relative: 0.05")
    project.put("grains", changed)
    rerun = project.snakemake("--cores", 1, "--dry-run")
    assert "retrieve" in rerun.text and "table_part" not in rerun.text
