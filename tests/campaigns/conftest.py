"""Fixtures of campaigns: workflow projects, counts, and the command that repeats a failed case."""

import importlib.util
import os
import sys
from collections import Counter, defaultdict
from pathlib import Path

import pytest

SIZES = ("CALIBRATION", "CAMPAIGN", "DAMAGES", "KILLS", "RETRIEVALS", "SNOWPACKS")
"""Environment variables that set the size of campaigns."""

_path = Path(__file__).parents[1] / "workflow" / "conftest.py"
_spec = importlib.util.spec_from_file_location("projects", _path)
_projects = importlib.util.module_from_spec(_spec)
sys.modules[_spec.name] = _projects
_spec.loader.exec_module(_projects)
environment, make_project = _projects.environment, _projects.make_project


@pytest.fixture(scope="session")
def counter():
    """Return a function that counts outcomes of numbered cases; print the counts at the end."""
    outcomes, numbers = defaultdict(Counter), defaultdict(list)

    def count(campaign, number, outcome):
        outcomes[campaign][outcome] += 1
        numbers[campaign].append(number)

    yield count
    for campaign, counts in outcomes.items():
        summary = ", ".join(f"{n} {outcome}" for outcome, n in counts.items())
        first, last = min(numbers[campaign]), max(numbers[campaign])
        print(f"\n{campaign}: {len(numbers[campaign])}, seeds {first} to {last}: {summary}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.failed:
        sizes = [f"{name}={os.environ[name]}" for name in SIZES if name in os.environ]
        command = " ".join([*sizes, "python -m pytest -s", f"'{item.nodeid}'"])
        report.sections.append(("to repeat this case alone", command))
    return report
