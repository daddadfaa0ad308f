"""Imports at start-up, which delay every job of the workflow."""

import ast
from importlib import import_module
from pathlib import Path

import pytest

import splits

PACKAGE = Path(splits.__file__).parent
ROOT = Path(__file__).parents[2]
SCRIPTS = [path for folder in ("benchmarks", "workflow", "tests/campaigns")
           for path in sorted((ROOT / folder).rglob("*.py"))]  # fmt: skip


def list_imports(path):
    """Yield the packages that a module imports when it is imported."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


def test_scipy_is_imported_by_no_module():
    """scipy.stats doubles the import time."""
    importing = [path for path in PACKAGE.rglob("*.py") if "scipy" in list_imports(path)]
    assert importing == []


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_names_that_scripts_import_exist(path):
    """No other test imports most of these scripts."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "splits":
            module = import_module(node.module)
            for alias in node.names:
                submodule = PACKAGE.parent.joinpath(*node.module.split("."), f"{alias.name}.py")
                assert hasattr(module, alias.name) or submodule.is_file(), alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "splits":
                    import_module(alias.name)
