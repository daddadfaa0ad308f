"""Progress messages, whose errors never end a run, and signals to a job and its parent."""

import inspect
import io
import os
import subprocess
import sys

import numpy as np
import pytest
from chi2 import NEEDS_JIT

import splits
from splits.core.keywords import declare_function
from splits.core.progress import open_progress_log, write_line

WITH_PROGRESS = (
    "spectrophotometer", "goniophotometer", "beam_spread",
    "irradiance_profile", "albedo", "hdrf", "radiation_profile", "retrieve",
)  # fmt: skip
HALF = splits.Progress(rays=1000, stderr=0.004, target=0.002, seconds=3.0, seconds_left=1.0)


@declare_function
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


SMALL_EXPERIMENT = """
medium: {kind: snow, depth_m: 0.005}
instrument: {wavelength_nm: [800, 1300]}
figure: none
"""
FULL_DISK = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")


@declare_function
def measure_once(*, progress=None):
    """Report progress once."""
    progress(HALF)
    return "measured"


def test_characters_outside_the_encoding_are_escaped():
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="ascii")
    write_line("é \udce9 µ", stream)
    assert raw.getvalue().split() == [b"\\xe9", b"\\udce9", b"\\xb5"]


@FULL_DISK
def test_failing_streams_raise_no_error(tmp_path):
    write_line("a line", None)
    with open("/dev/full", "w", encoding="utf-8") as full:
        write_line("a line", full)
        write_line("a line", full)
    with open(tmp_path / "closed", "w", encoding="utf-8") as closed:
        pass
    write_line("a line", closed)


@FULL_DISK
def test_an_unwritable_log_does_not_affect_the_terminal(capsys):
    with open_progress_log("/dev/full") as log:
        log("a line")
        log("another")
    assert capsys.readouterr().err == "a line\nanother\n"


class BrokenStream(io.StringIO):
    def write(self, text=""):
        raise BrokenPipeError

    flush = write


@pytest.mark.parametrize("stream", [BrokenStream, lambda: None])
def test_an_unwritable_progress_bar_raises_no_error(monkeypatch, stream):
    monkeypatch.setattr(sys, "stderr", stream())
    assert measure_once(progress=True) == "measured"


@pytest.mark.parametrize("error", [BrokenPipeError(), UnicodeEncodeError("ascii", "é", 0, 1, "")])
def test_write_errors_of_callbacks_are_ignored(error):
    def callback(progress):
        raise error

    assert measure_once(progress=callback) == "measured"


def test_other_errors_of_callbacks_are_raised():
    def callback(progress):
        raise KeyError

    with pytest.raises(KeyError):
        measure_once(progress=callback)


def run_in_shell(tmp_path, before="", after="", **environment):
    """Run an experiment in a shell, and return its exit status and the dataset."""
    (tmp_path / "small.yaml").write_text(SMALL_EXPERIMENT, encoding="utf-8")
    command = f"{sys.executable} -m splits.cli run small.yaml --output é --accuracy tiny"
    shell = f"{before} {command} --threads 1 {after}"
    result = subprocess.run(
        ["bash", "-c", f"{shell}; exit ${{PIPESTATUS[0]}}"], cwd=tmp_path, capture_output=True,
        text=True, env={**os.environ, **environment},
    )  # fmt: skip
    return result, splits.load(tmp_path / "é" / "small.nc")


@pytest.mark.long
@NEEDS_JIT
@FULL_DISK
@pytest.mark.parametrize(
    "after", ["2>/dev/full", ">/dev/full", "2>&- >&-", "2>&1 >/dev/null | true", "| true"]
)
def test_a_run_succeeds_with_unwritable_output(tmp_path, after):
    result, dataset = run_in_shell(tmp_path, after=after)
    assert result.returncode == 0 and "Error" not in result.stderr
    assert dataset.reflectance.size == 2


@NEEDS_JIT
def test_a_run_succeeds_in_an_ascii_terminal(tmp_path):
    result, _ = run_in_shell(tmp_path, PYTHONIOENCODING="ascii")
    assert (result.returncode, result.stdout) == (0, "\\xe9/small.nc\n")


@NEEDS_JIT
@pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
def test_a_run_succeeds_after_its_terminal_is_closed(tmp_path):
    (tmp_path / "small.yaml").write_text(SMALL_EXPERIMENT, encoding="utf-8")
    parent_end, child_end = os.openpty()
    command = [sys.executable, "-m", "splits.cli", "run", "small.yaml", "--accuracy", "tiny"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=child_end, stderr=child_end, start_new_session=True
    ) as process:
        os.close(child_end)
        os.close(parent_end)
    assert process.returncode == 0
    assert splits.load(tmp_path / "small.nc").reflectance.size == 2


@FULL_DISK
def test_interrupts_end_a_run_with_unwritable_output():
    script = (
        "import os, signal, time\nfrom splits.core.process import exit_on_signals\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\nexit_on_signals('a job')\n"
        "os.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n"
    )
    with open("/dev/full", "wb") as full:
        result = subprocess.run([sys.executable, "-c", script], stderr=full, timeout=30)
    assert result.returncode == 130
