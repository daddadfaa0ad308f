"""Notebooks of docs/: format, structure, use of documented names, and execution."""

import ast
import importlib
import itertools
import re
from pathlib import Path

import pytest
from chi2 import NEEDS_JIT

import splits

for package in ("nbformat", "nbclient", "ipykernel"):
    pytest.importorskip(package, reason="comes with the extra docs")
import nbformat  # noqa: E402
from nbclient import NotebookClient  # noqa: E402

DOCS = Path(__file__).parents[2] / "docs"
NAMES = ("rough_layer", "sand_colour_and_water", "snow_pack")
CODE_CELL_RANGE = range(6, 13)
MIN_FIGURES = 5
LAST_HEADINGS = ("## Limitations", "## Exercises")
EXTRA_PACKAGES = {
    "rough_layer": (),
    "sand_colour_and_water": ("colour", "scipy"),
    "snow_pack": ("pvlib", "pyrsr"),
}

every_notebook = pytest.mark.parametrize("name", NAMES)


def read_notebook(name):
    path = DOCS / "notebooks" / f"{name}.ipynb"
    return nbformat.reads(path.read_text(encoding="utf-8"), as_version=nbformat.NO_CONVERT)


def parse_code_cells(name):
    return [
        ast.parse(cell.source) for cell in read_notebook(name).cells if cell.cell_type == "code"
    ]


def test_all_notebooks_are_tested_and_listed():
    assert sorted(p.stem for p in (DOCS / "notebooks").glob("*.ipynb")) == list(NAMES)
    listed = (DOCS / "notebooks" / "index.md").read_text(encoding="utf-8").splitlines()
    assert set(NAMES) <= set(listed)


@every_notebook
def test_notebook_is_valid_and_without_outputs(name):
    notebook = read_notebook(name)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    for cell in notebook.cells:
        # Readable identifiers instead of the random ones that editors assign.
        assert re.fullmatch(r"[a-z]+(-[a-z]+)*", cell.id), cell.id
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None, cell.id


@every_notebook
def test_notebook_explains_every_cell_and_its_limitations(name):
    cells = read_notebook(name).cells
    kinds = [cell.cell_type for cell in cells]
    assert kinds.count("code") in CODE_CELL_RANGE
    assert kinds[0] == "markdown" and re.match(r"# .*\?\n", cells[0].source)
    for before, cell in itertools.pairwise(cells):
        assert cell.cell_type == "markdown" or before.cell_type == "markdown", cell.id
    assert tuple(cell.source.split("\n")[0] for cell in cells[-2:]) == LAST_HEADINGS


@every_notebook
def test_markdown_contains_no_numerical_results(name):
    for cell in read_notebook(name).cells:
        if cell.cell_type == "markdown":
            prose = re.sub(r"```.*?```|`[^`]*`", "", cell.source, flags=re.S)
            assert not re.search(r"\d\.\d|±|\d ?%", prose), cell.id


def list_imports(program):
    for node in ast.walk(program):
        if isinstance(node, ast.ImportFrom):
            yield from ((node.module, alias.name) for alias in node.names)


def find_attributes_of_splits(program):
    attributes = (node for node in ast.walk(program) if isinstance(node, ast.Attribute))
    return {n.attr for n in attributes if isinstance(n.value, ast.Name) and n.value.id == "splits"}


@every_notebook
def test_notebook_uses_public_or_documented_names(name):
    pages = [p.read_text(encoding="utf-8") for p in DOCS.rglob("*.md") if "_build" not in p.parts]
    used = 0
    for program in parse_code_cells(name):
        for module, member in list_imports(program):
            if module.partition(".")[0] != "splits":
                continue
            assert hasattr(importlib.import_module(module), member), (module, member)
            documented = rf"{re.escape(module)}(\.{member}\b| import .*\b{member}\b)"
            assert any(re.search(documented, page) for page in pages), (module, member)
        called = find_attributes_of_splits(program)
        assert called <= set(splits.__all__), called
        used += len(called)
    assert used


# The build of the documentation runs them, too, with errors and warnings as failures.
@pytest.mark.long
@NEEDS_JIT
@every_notebook
def test_notebook_runs_and_draws_figures(name, tmp_path):
    for package in ("matplotlib", *EXTRA_PACKAGES[name]):
        pytest.importorskip(package)
    notebook = read_notebook(name)
    resources = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    outputs = [
        (cell.id, output)
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    ]
    warnings = [(where, one.text) for where, one in outputs if one.get("name") == "stderr"]
    assert warnings == []
    figures = [where for where, one in outputs if "image/png" in one.get("data", {})]
    assert len(figures) >= MIN_FIGURES
    assert list(tmp_path.iterdir()) == []
