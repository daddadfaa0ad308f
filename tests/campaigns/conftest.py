"""What campaigns share: projects of the workflow, counts, and how to repeat a case that failed."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections import Counter, defaultdict
from pathlib import Path

import pytest

SIZES = ("CALIBRATION", "CAMPAIGN", "DAMAGES", "KILLS")
"""Environment variables that say how large campaigns are."""

_place = Path(__file__).parents[1] / "workflow" / "conftest.py"
_spec = importlib.util.spec_from_file_location("projects", _place)
_projects = importlib.util.module_from_spec(_spec)
sys.modules[_spec.name] = _projects
_spec.loader.exec_module(_projects)
environment, make_project = _projects.environment, _projects.make_project


@pytest.fixture(scope="session")
def counted():
    """Return a function that counts outcomes of numbered cases by campaign, and print them."""
    outcomes, numbers = defaultdict(Counter), defaultdict(list)

    def count(campaign, number, outcome):
        outcomes[campaign][outcome] += 1
        numbers[campaign].append(number)

    yield count
    for campaign, found in outcomes.items():
        told = ", ".join(f"{many} {outcome}" for outcome, many in found.items())
        first, last = min(numbers[campaign]), max(numbers[campaign])
        print(f"\n{campaign}: {len(numbers[campaign])}, seeds {first} to {last}: {told}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.failed:
        sizes = [f"{name}={os.environ[name]}" for name in SIZES if name in os.environ]
        command = " ".join([*sizes, "python -m pytest -s", f"'{item.nodeid}'"])
        report.sections.append(("to repeat this alone", command))
    return report
