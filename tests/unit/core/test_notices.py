"""Notices about kernel compilation, whose errors never end a run."""

import io
import os
import sys
import time
from contextlib import contextmanager, suppress

import pytest
from chi2 import NEEDS_JIT
from numba import njit

import splits
from splits.core import progress as notices
from splits.core.progress import COMPILING_MESSAGE, DONE_MESSAGE, WAITING_MESSAGE, announce
from splits.kernels.compiler import cache

openpty = getattr(os, "openpty", None)
NEEDS_TERMINAL = pytest.mark.skipif(openpty is None, reason="needs pseudoterminals")


def cube(x):
    return x**3


@pytest.fixture(autouse=True)
def fast_notices(monkeypatch):
    """Shorten the delays, and wait for the notices of a test before the next."""
    monkeypatch.setattr(notices, "NOTICE_DELAY_S", 0.05)
    monkeypatch.setattr(notices, "_NOTICE_INTERVAL_S", 0.01)
    monkeypatch.setattr(notices, "_session", None)
    yield
    wait_for_notices()


@contextmanager
def terminal(monkeypatch):
    """Redirect stderr to a pseudoterminal and return its reading end."""
    reader, writer = openpty()
    with open(writer, "w", encoding="ascii") as errors:
        monkeypatch.setattr(sys, "stderr", errors)
        yield reader
        wait_for_notices()
    monkeypatch.undo()
    with suppress(OSError):
        os.close(reader)


def wait_for_notices():
    while notices._session is not None and not notices._session.is_over:
        time.sleep(0.01)
    time.sleep(0.1)


@pytest.fixture
def received():
    """Return the notices that a callback receives."""
    messages = []
    notices.listeners.append(messages.append)
    yield messages
    notices.listeners.remove(messages.append)


@NEEDS_TERMINAL
def test_terminal_shows_start_and_end_of_compilation(monkeypatch):
    with terminal(monkeypatch) as reader:
        for _ in range(2):
            with announce(COMPILING_MESSAGE):
                time.sleep(0.2)
        wait_for_notices()
        output = os.read(reader, 10_000).decode()
    assert output.splitlines() == [f"splits: {COMPILING_MESSAGE}", f"splits: {DONE_MESSAGE}: 0 s"]


@NEEDS_TERMINAL
def test_fast_compilation_gives_no_notice(monkeypatch):
    with terminal(monkeypatch) as reader:
        with announce(COMPILING_MESSAGE):
            pass
        wait_for_notices()
        os.set_blocking(reader, False)
        with pytest.raises(BlockingIOError):
            os.read(reader, 1)


@NEEDS_TERMINAL
def test_a_closed_terminal_does_not_stop_the_run(monkeypatch):
    with terminal(monkeypatch) as reader:
        os.close(reader)
        with announce(COMPILING_MESSAGE):
            time.sleep(0.2)


class CellOutput(io.StringIO):
    """Standard error of a notebook."""

    __module__ = "ipykernel.iostream"


@pytest.mark.parametrize("seconds", [0.0, 0.2])
def test_a_notebook_shows_compilation_until_its_end(monkeypatch, seconds):
    display = pytest.importorskip("IPython.display", reason="comes with the extra docs")
    lines = []

    def show(content, raw, display_id, update):
        assert raw and display_id and update == bool(lines)
        lines.append(content["text/plain"])

    monkeypatch.setattr(display, "display", show)
    monkeypatch.setattr(sys, "stderr", CellOutput())
    for _ in range(2):
        with announce(COMPILING_MESSAGE):
            time.sleep(seconds)
    wait_for_notices()
    # Once for all that is compiled, and in the saved notebook only results stay.
    assert lines == ([f"splits: {COMPILING_MESSAGE}", ""] if seconds else [])
    assert sys.stderr.getvalue() == ""


def test_without_a_terminal_there_is_no_notice(capfd):
    with announce(COMPILING_MESSAGE):
        time.sleep(0.2)
    assert notices._session is None
    assert capfd.readouterr() == ("", "")


def test_progress_bars_show_the_compilation_time(capsys):
    with splits.ProgressBar("mine"), announce(COMPILING_MESSAGE):
        time.sleep(0.3)
    assert f"{COMPILING_MESSAGE}: 0 s" in capsys.readouterr().err
    assert notices.listeners == []


def test_a_failing_callback_does_not_stop_the_run(received):
    notices.listeners.insert(0, lambda text: 1 / 0)
    with announce(COMPILING_MESSAGE):
        time.sleep(0.2)
    del notices.listeners[0]
    assert received


@NEEDS_JIT
def test_waiting_for_another_process_is_reported(received, monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "find_cache_folder", lambda: tmp_path)
    first, second = cache.KernelCache(cube), cache.KernelCache(cube)
    with first.hold_lock():
        monkeypatch.setattr(cache, "MAX_WAIT_S", 0.3)
        with second.hold_lock():
            pass
    assert received[0] == f"{WAITING_MESSAGE}: 0 s"


@NEEDS_JIT
def test_compilation_of_a_kernel_is_reported(received, monkeypatch):
    monkeypatch.setattr(cache, "find_cache_folder", lambda: None)
    kernel = njit(cube)
    compile_kernel = kernel.compile
    kernel.compile = lambda signature: time.sleep(0.3) or compile_kernel(signature)
    assert cache.enable_caching(kernel)(2) == 8
    assert received[0].startswith(COMPILING_MESSAGE)
