"""What every start of the workflow and each of its jobs would wait for."""

from __future__ import annotations

import ast
from pathlib import Path

import splits

PACKAGE = Path(splits.__file__).parent


def list_imports(path):
    """Return the packages that a file imports as it is itself imported."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


def test_scipy_is_imported_where_it_is_needed_only():
    """Its statistics take as long as all else that a start imports; that study asks for it."""
    found = [path for path in PACKAGE.rglob("*.py") if "scipy" in list_imports(path)]
    assert found == [PACKAGE / "analysis" / "surface_area.py"]
