"""Names and paths of users that are keywords of Snakemake or Python, or contain patterns."""

import re

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.long]

INDICES = "instrument: {kind: refractive_index, wavelength_nm: [500, 600]}\nfigure: none\n"
TABLE = """\
medium: {kind: natural_snow}
instrument: {kind: table, wavelength_nm: [500, 600]}
grid: {optical_radius_um: [50, 100], saturation: [0, 0.1]}
"""
RESERVED_NAMES = (
    "class", "config", "data", "get", "import", "index", "input", "items", "keys", "lambda", "log",
    "none", "null", "open", "output", "params", "results", "rules", "snakemake", "sort",
    "wildcards", "workflow",
)  # fmt: skip


def change_settings(project, change):
    """Apply a change to the text of the main configuration."""
    path = project.folder / "config" / "config.yaml"
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")


def replace_explorer_tables(text):
    text = re.sub(r"^explorer_directions: .*$", "", text, flags=re.MULTILINE)
    return re.sub(r"^explorer: .*$", "explorer: {items: items, keys: keys}", text,
                  flags=re.MULTILINE)  # fmt: skip


def test_experiments_may_have_names_of_the_workflow(project):
    for name in RESERVED_NAMES:
        project.put(name, INDICES)
    plan = project.snakemake("--cores", 1, "--dry-run")
    assert plan.code == 0, plan.text
    simulated = sorted(f"Simulating {name}" for name in RESERVED_NAMES)
    assert plan.jobs() == [*simulated, "Writing the report"]
    run = project.snakemake("none", "items", "--cores", 1)
    assert run.code == 0, run.text
    assert project.results("results/tiny") == ["data/items.nc", "data/none.nc"]


def test_explorer_tables_may_have_names_of_the_workflow(project):
    project.put("items", TABLE)
    project.put("keys", TABLE)
    change_settings(project, replace_explorer_tables)
    plan = project.snakemake("explorer", "--cores", 1, "--dry-run")
    assert plan.code == 0, plan.text
    assert "Writing the explorer" in plan.jobs()


def test_explorer_without_tables_is_reported(project):
    project.put("items", TABLE)
    change_settings(project, replace_explorer_tables)
    run = project.snakemake("explorer", "--cores", 1, "--dry-run")
    assert run.code != 0
    assert "the explorer is left out: no such experiment: keys" in run.text


def test_paths_with_patterns_are_rejected(project):
    project.put("one", INDICES)
    (project.folder / "config" / "measured").rename(project.folder / "m{x}")
    for key, path in (("results", "out{x}"), ("measured_folder", "m{x}")):
        config = f"accuracy=tiny {key}={path}"
        run = project.snakemake("--cores", 1, "--dry-run", config=config)
        message = f"{key} = '{path}': must be a path without"
        assert run.code != 0 and message in run.text, run.text


def test_table_name_with_pattern_is_rejected(project):
    (project.folder / "my{soil}.csv").write_text("wavelength_nm,albedo\n400,0.1\n900,0.2\n")
    project.put("one", "medium: {depth_m: 0.01, ground: 'my{soil}.csv'}\n"
                "instrument: {wavelength_nm: [500]}\n")  # fmt: skip
    run = project.snakemake("--cores", 1, "--dry-run")
    assert "my{soil}.csv" in run.text and "must be a path without" in run.text, run.text


def test_main_configuration_is_yaml_1_2(project):
    project.put("one", INDICES)
    change_settings(project, lambda text: text.replace("accuracies:\n", "accuracies:\n  on: "
                                                "{max_stderr: 010}\n"))  # fmt: skip
    (project.folder / "more.yaml").write_text("results: 1:15\nseed: 1:15\n", encoding="utf-8")
    run = project.snakemake("--cores", 1, "--dry-run", "--configfile", "more.yaml")
    (line,) = [line for line in run.text.splitlines() if line.startswith("config/config.yaml")]
    assert "line" in line
    assert line.endswith(": accuracies.on.max_stderr = 10: must be in [1e-06, 0.5]")
    change_settings(project, lambda text: text.replace("010", "0.1"))
    run = project.snakemake("--cores", 1, "--dry-run", "--configfile", "more.yaml")
    assert "more.yaml, line 2: seed = '1:15': must be a whole number" in run.text, run.text
    (project.folder / "more.yaml").write_text("results: 1:15\n", encoding="utf-8")
    run = project.snakemake("--cores", 1, "--dry-run", "--configfile", "more.yaml")
    assert "1:15/tiny/data/one.nc" in run.text
