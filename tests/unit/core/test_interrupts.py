"""Signals to a job and to what starts jobs."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from splits.core.interrupts import GRACE_PERIOD_S, INTERRUPTED_EXIT_STATUS, track_unfinished_file

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
BUSY_PROGRAM = "import hashlib; hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)"
"""Minutes of machine code that does not heed signals."""
IDLE_PROGRAM = "import time; time.sleep(300)"
JOB_PROGRAM = """
from pathlib import Path
from splits.core.interrupts import exit_on_signals, track_unfinished_file
exit_on_signals('a job')
with track_unfinished_file(Path({path!r})):
    Path({path!r}).touch()
    print('begun', flush=True)
    {work}
"""
PARENT_PROGRAM = """
import subprocess, sys
from splits.core.interrupts import forward_interrupts
forward_interrupts()
child = subprocess.Popen([sys.executable, '-c', sys.argv[1]])
child.wait()
"""
MAX_DELAY_S = GRACE_PERIOD_S + 6.0
"""What a loaded machine may take."""


def restore_interrupts():
    """Let a process heed SIGINT even if the tests run in the background of a shell."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def ignore_interrupts():
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def start_process(*arguments, prepare=restore_interrupts):
    """Return a process that says when it has begun."""
    process = subprocess.Popen(
        [sys.executable, "-c", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=prepare,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    return process


@pytest.mark.parametrize("work", [BUSY_PROGRAM, IDLE_PROGRAM], ids=["busy", "idle"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_job_ends_soon_with_one_line_and_no_half_file(work, number, tmp_path):
    path = tmp_path / "half.nc"
    process = start_process(JOB_PROGRAM.format(path=str(path), work=work))
    assert path.exists()
    since = time.perf_counter()
    process.send_signal(number)
    # Two of them: from the terminal, and passed on.
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert time.perf_counter() - since < MAX_DELAY_S
    assert (process.returncode, err) == (INTERRUPTED_EXIT_STATUS, "a job: interrupted\n")
    assert not path.exists()


def test_errors_of_a_job_are_shown_as_ever(tmp_path):
    process = start_process(
        JOB_PROGRAM.format(path=str(tmp_path / "half.nc"), work="raise ValueError('bad')")
    )
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" in err and err.endswith("ValueError: bad\n")


def test_an_interrupt_is_passed_on(tmp_path):
    job = JOB_PROGRAM.format(path=str(tmp_path / "half.nc"), work=BUSY_PROGRAM)
    process = start_process(PARENT_PROGRAM, job)
    since = time.perf_counter()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert time.perf_counter() - since < MAX_DELAY_S
    assert "a job: interrupted\n" in err
    assert process.returncode == -signal.SIGINT


def test_what_ignores_interrupts_goes_on_to_do_so(tmp_path):
    work = "import time; time.sleep(0.5); print('ended')"
    job = JOB_PROGRAM.format(path=str(tmp_path / "half.nc"), work=work)
    for program in ([job], [PARENT_PROGRAM, job]):
        process = start_process(*program, prepare=ignore_interrupts)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
        assert (process.returncode, out, err) == (0, "ended\n", "")


def test_a_file_that_is_done_under_another_name_stays(tmp_path):
    aside, path = tmp_path / "aside", tmp_path / "whole"
    with track_unfinished_file(aside):
        aside.touch()
        aside.rename(path)
    assert path.exists() and not aside.exists()
    with pytest.raises(KeyboardInterrupt), track_unfinished_file(aside):
        aside.touch()
        raise KeyboardInterrupt
    assert not aside.exists()
