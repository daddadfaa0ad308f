"""Imports at start-up, which delay every job of the workflow."""

from __future__ import annotations

import ast
from pathlib import Path

import splits

PACKAGE = Path(splits.__file__).parent


def list_imports(path):
    """Yield the packages that a module imports when it is imported."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


def test_scipy_is_imported_by_one_module_only():
    """scipy.stats doubles the import time and is needed by one study only."""
    importing = [path for path in PACKAGE.rglob("*.py") if "scipy" in list_imports(path)]
    assert importing == [PACKAGE / "analysis" / "surface_area.py"]
