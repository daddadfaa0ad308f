"""Progress of a running simulation, and progress bars."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.core.keywords import reject_unknown_arguments

WITH_PROGRESS = (
    "spectrophotometer", "goniophotometer", "beam_spread",
    "irradiance_profile", "albedo", "hdrf", "radiation_profile", "retrieve",
)  # fmt: skip
HALF = splits.Progress(rays=1000, stderr=0.004, target=0.002, seconds=3.0, seconds_left=1.0)


@reject_unknown_arguments
def report_once(*, progress=None):
    """Report progress once."""
    if progress:
        progress(HALF)
    return progress


@pytest.mark.parametrize("name", WITH_PROGRESS)
def test_long_running_functions_accept_progress(name):
    assert "progress" in inspect.signature(getattr(splits, name)).parameters


def test_progress_text_states_fraction_and_error():
    assert HALF.fraction_done == 0.75
    assert str(HALF) == "error 0.004, wanted 0.002, 1 s left"
    assert str(splits.Progress(10, np.inf, 0.1, 0.0, 0.0)).startswith("first round")
    assert splits.Progress(10, np.inf, 0.1, 0.0, 0.0).fraction_done == 0.0


def test_progress_true_shows_a_complete_bar(capsys):
    assert isinstance(report_once(progress=True), splits.ProgressBar)
    output = capsys.readouterr().err
    assert "report_once:  75%" in output and "error 0.004, wanted 0.002" in output
    assert "100%" in output and "done" in output


def test_a_failure_leaves_the_bar_incomplete(capsys):
    with pytest.raises(KeyError), splits.ProgressBar("mine") as bar:
        bar(HALF)
        raise KeyError
    output = capsys.readouterr().err
    assert "mine:  75%" in output and "100%" not in output


def test_default_and_false_show_no_bar(capsys):
    assert report_once() is None
    assert report_once(progress=False) is None
    assert capsys.readouterr().err == ""


def test_non_callables_are_rejected():
    with pytest.raises(ValueError, match=r"progress = 'yes': must be True for a bar, or a func"):
        report_once(progress="yes")


@NEEDS_JIT
def test_instruments_report_to_a_callback():
    reports = []
    splits.spectrophotometer(
        splits.Snow(depth_m=0.01), [1300], max_stderr=0.01, progress=reports.append
    )
    assert reports and all(isinstance(report, splits.Progress) for report in reports)
    assert reports[0].target == 0.01
