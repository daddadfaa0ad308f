"""Signals to a job and to what starts jobs."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from splits.interrupts import GRACE_S, INTERRUPTED, half_written

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
BUSY = "import hashlib; hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)"
"""Minutes of machine code that does not heed signals."""
IDLE = "import time; time.sleep(300)"
JOB = """
from pathlib import Path
from splits.interrupts import end_on_signals, half_written
end_on_signals('a job')
with half_written(Path({path!r})):
    Path({path!r}).touch()
    print('begun', flush=True)
    {work}
"""
PARENT = """
import subprocess, sys
from splits.interrupts import pass_on_interrupts
pass_on_interrupts()
child = subprocess.Popen([sys.executable, '-c', sys.argv[1]])
child.wait()
"""
PROMPT_S = GRACE_S + 6.0
"""What a loaded machine may take."""


def heeding():
    """Let a process heed SIGINT even if the tests run in the background of a shell."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def ignoring():
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def started(*arguments, prepare=heeding):
    """Return a process that says when it has begun."""
    process = subprocess.Popen(
        [sys.executable, "-c", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=prepare,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    return process


@pytest.mark.parametrize("work", [BUSY, IDLE], ids=["busy", "idle"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_job_ends_soon_with_one_line_and_no_half_file(work, number, tmp_path):
    path = tmp_path / "half.nc"
    process = started(JOB.format(path=str(path), work=work))
    assert path.exists()
    since = time.perf_counter()
    process.send_signal(number)
    # Two of them: from the terminal, and passed on.
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert time.perf_counter() - since < PROMPT_S
    assert (process.returncode, err) == (INTERRUPTED, "a job: interrupted\n")
    assert not path.exists()


def test_errors_of_a_job_are_shown_as_ever(tmp_path):
    process = started(JOB.format(path=str(tmp_path / "half.nc"), work="raise ValueError('bad')"))
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" in err and err.endswith("ValueError: bad\n")


def test_an_interrupt_is_passed_on(tmp_path):
    job = JOB.format(path=str(tmp_path / "half.nc"), work=BUSY)
    process = started(PARENT, job)
    since = time.perf_counter()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert time.perf_counter() - since < PROMPT_S
    assert "a job: interrupted\n" in err
    assert process.returncode == -signal.SIGINT


def test_what_ignores_interrupts_goes_on_to_do_so(tmp_path):
    work = "import time; time.sleep(0.5); print('ended')"
    job = JOB.format(path=str(tmp_path / "half.nc"), work=work)
    for program in ([job], [PARENT, job]):
        process = started(*program, prepare=ignoring)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
        assert (process.returncode, out, err) == (0, "ended\n", "")


def test_a_file_that_is_done_under_another_name_stays(tmp_path):
    aside, path = tmp_path / "aside", tmp_path / "whole"
    with half_written(aside):
        aside.touch()
        aside.rename(path)
    assert path.exists() and not aside.exists()
    with pytest.raises(KeyboardInterrupt), half_written(aside):
        aside.touch()
        raise KeyboardInterrupt
    assert not aside.exists()
