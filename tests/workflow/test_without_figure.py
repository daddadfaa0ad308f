"""Experiments without a figure: plan, archive and report contain only their data."""

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.long]

INDICES = "figure: none\ninstrument: {kind: refractive_index, wavelength_nm: [500]}\n"


def test_experiment_without_figure_makes_data_only(project):
    project.put("bare", INDICES)
    run = project.snakemake("--cores", 1)
    assert run.code == 0, run.text
    assert run.jobs() == ["Simulating bare", "Writing the report"]
    assert project.results("results/tiny") == ["data/bare.nc", "report.html"]
    run = project.snakemake("--dry-run", "archive")
    assert run.jobs() == ["Packing results for deposit"]
    run = project.snakemake("--dry-run", "results/tiny/figures/bare.png")
    assert run.code != 0 and "MissingRuleException" in run.text
