"""The study that the documentation adds works in the workflow."""

import re
import shutil
from pathlib import Path

import pandas as pd
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.long]

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "own-study.md"
BLOCK = re.compile(r"```(?:python|yaml)\n(?:# (\S+)\n)?(.*?)```", re.DOTALL)


def test_study_of_the_documentation_makes_its_table(make_project, tmp_path, environment):
    project = make_project(tmp_path)
    for name in ("splits", "workflow", "benchmarks"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored)
    for name in ("Snakefile", "environment.yml"):
        shutil.copy(ROOT / name, tmp_path)
    for path, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if path:
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text, encoding="utf-8")
        elif "visible:" in text:
            with open(tmp_path / "config" / "config.yaml", "a", encoding="utf-8") as file:
                file.write(text.removeprefix("studies:\n"))
    project.environment = environment | {"PYTHONPATH": str(tmp_path)}
    project.snakefile = tmp_path / "Snakefile"
    run = project.snakemake("visible", "--cores", 2)
    assert run.code == 0, run.text
    table = pd.read_csv(tmp_path / "results" / "tiny" / "tables" / "visible.csv")
    assert list(table.experiment) == ["fresh", "old"]
    assert table.reflectance.between(0.9, 1.0).all() and table.stderr.between(1e-5, 0.1).all()
    config = tmp_path / "config" / "config.yaml"
    text = config.read_text(encoding="utf-8")
    config.write_text(f"{text}    options: {{band: [450, 650]}}\n", "utf-8")
    invalid = project.snakemake("visible")
    assert "studies.visible.options.band: unknown key, must be one of band_nm" in invalid.text
    config.write_text(f"{text}    options: {{band_nm: [450, 650]}}\n", "utf-8")
    assert project.snakemake("visible", "--dry-run").jobs() == ["Making visible"]
    config.write_text(text.replace("tabulate_reflectance", "tabulate"), "utf-8")
    invalid = project.snakemake("visible", "--dry-run")
    assert "did you mean tabulate_reflectance?" in invalid.text and invalid.code != 0
    # The function returns no table.
    config.write_text(text, "utf-8")
    function = tmp_path / "workflow" / "studies" / "visible.py"
    code = function.read_text(encoding="utf-8")
    function.write_text(code.replace("return pd.concat(tables)", "return tables"), "utf-8")
    invalid = project.snakemake("visible", "--cores", 1)
    assert "studies.visible.function = ['list']: must be one that returns DataFrame" in invalid.text
