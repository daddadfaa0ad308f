"""Signals to a job and to its parent process."""

import signal
import subprocess
import sys
import time

import pytest

from splits.core.process import INTERRUPTED_EXIT_STATUS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
BUSY_PROGRAM = "import hashlib; hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)"
"""Minutes of compiled code that does not check signals."""
IDLE_PROGRAM = "import time; time.sleep(300)"
JOB_PROGRAM = """
from splits.core.atomic import atomic_write
from splits.core.process import exit_on_signals
exit_on_signals('a job')
with atomic_write({path!r}) as aside:
    aside.touch()
    print('begun', flush=True)
    {work}
"""
PARENT_PROGRAM = """
import subprocess, sys
from splits.core.process import forward_interrupts
forward_interrupts()
child = subprocess.Popen([sys.executable, '-c', sys.argv[1]])
child.wait()
"""
MAX_DELAY_S = 6.0
"""Largest delay on a loaded machine (s)."""


def restore_interrupts():
    """Restore the default action of SIGINT, which background shells ignore."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def ignore_interrupts():
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def start_process(*arguments, prepare=restore_interrupts):
    """Start a process and return it after its first line of output."""
    process = subprocess.Popen(
        [sys.executable, "-c", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=prepare,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    return process


@pytest.mark.parametrize("work", [BUSY_PROGRAM, IDLE_PROGRAM], ids=["busy", "idle"])
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_job_without_a_partial_file(work, signal_number, tmp_path):
    path = tmp_path / "half.nc"
    process = start_process(JOB_PROGRAM.format(path=str(path), work=work))
    start = time.perf_counter()
    process.send_signal(signal_number)
    # Two signals: from the terminal, and forwarded by the parent.
    process.send_signal(signal_number)
    _, stderr = process.communicate(timeout=60)
    assert time.perf_counter() - start < MAX_DELAY_S
    assert (process.returncode, stderr) == (INTERRUPTED_EXIT_STATUS, "a job: interrupted\n")
    assert not path.exists()


def test_errors_of_a_job_show_a_traceback(tmp_path):
    process = start_process(
        JOB_PROGRAM.format(path=str(tmp_path / "half.nc"), work="raise ValueError('bad')")
    )
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" in stderr and stderr.endswith("ValueError: bad\n")


def test_an_interrupt_is_forwarded(tmp_path):
    job = JOB_PROGRAM.format(path=str(tmp_path / "half.nc"), work=BUSY_PROGRAM)
    process = start_process(PARENT_PROGRAM, job)
    start = time.perf_counter()
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert time.perf_counter() - start < MAX_DELAY_S
    assert "a job: interrupted\n" in stderr
    assert process.returncode == -signal.SIGINT


def test_ignored_interrupts_stay_ignored(tmp_path):
    work = "import time; time.sleep(0.5); print('ended')"
    job = JOB_PROGRAM.format(path=str(tmp_path / "half.nc"), work=work)
    for program in ([job], [PARENT_PROGRAM, job]):
        process = start_process(*program, prepare=ignore_interrupts)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
        assert (process.returncode, stdout, stderr) == (0, "ended\n", "")
