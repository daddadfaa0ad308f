"""What every start of the workflow and each of its jobs would wait for."""

from __future__ import annotations

import ast
from pathlib import Path

import splits

PACKAGE = Path(splits.__file__).parent


def imported(path):
    """Return the modules that a file imports as it is itself imported."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))


def test_scipy_stats_is_imported_by_what_needs_it_only():
    """It takes as long as all else that a start imports."""
    found = [path for path in PACKAGE.rglob("*.py") if "scipy.stats" in imported(path)]
    assert found == []
