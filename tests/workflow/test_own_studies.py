"""A study of one's own over one's own experiment, and one that lacks experiments."""

from __future__ import annotations

import pandas as pd
import pytest

pytestmark = pytest.mark.slow

EXPERIMENT = """\
instrument: {wavelength_nm: [400, 1000, 2500]}
grid: {depth_m: [0.12, 0.02], temperature_c: [-5, -1]}
"""
STUDY = """
  warming:
    kind: sensitivity
    pairs: {temperature: {parameter: temperature_c, experiment: cold, low: -5, high: -1}}
"""


def test_a_study_of_ones_own(project):
    project.put("cold", EXPERIMENT)
    with open(project.folder / "config" / "config.yaml", "a", encoding="utf-8") as file:
        file.write(STUDY)
    run = project.snakemake("--cores", 1)
    assert run.code == 0, run.text
    assert project.results("results/tiny") == [
        "data/cold.nc", "data/warming_index.nc",
        "figures/cold.pdf", "figures/cold.png", "figures/cold.svg",
        "figures/warming_index.pdf", "figures/warming_index.png", "figures/warming_index.svg",
        "tables/warming.csv", "tables/warming_chosen.csv",
    ]  # fmt: skip
    table = pd.read_csv(project.folder / "results" / "tiny" / "tables" / "warming_chosen.csv")
    assert set(table.parameter) == {"temperature"} and "published" not in table


def test_a_study_that_lacks_experiments_says_so_when_it_is_asked_for(project):
    project.put("cold", EXPERIMENT)
    run = project.snakemake("layer_trends", "--cores", 1)
    assert run.code != 0
    (line,) = [line for line in run.text.splitlines() if "is left out" in line]
    assert line.startswith("study layer_trends is left out: no such experiment: layer_fig02_lens")
    assert "Traceback" not in run.text
