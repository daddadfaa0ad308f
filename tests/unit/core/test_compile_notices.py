"""Notices about kernel compilation, whose errors never end a run."""

from __future__ import annotations

import os
import sys
import time
from contextlib import contextmanager, suppress

import pytest

import splits
from splits.core import compile_notice as notices
from splits.core.compile_notice import COMPILING_MESSAGE, DONE_MESSAGE, WAITING_MESSAGE, announce
from splits.kernels.compiler import cache_lock
from splits.kernels.compiler.cache import KernelCache

openpty = getattr(os, "openpty", None)
NEEDS_TERMINAL = pytest.mark.skipif(openpty is None, reason="no terminals here")


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """Let notices come at once, and none of a test in the next."""
    monkeypatch.setattr(notices, "NOTICE_DELAY_S", 0.05)
    monkeypatch.setattr(notices, "_NOTICE_INTERVAL_S", 0.01)
    monkeypatch.setattr(notices, "_session", None)
    yield
    wait_for_notices()


@contextmanager
def terminal(monkeypatch):
    """Let errors go to a terminal, and give its other end."""
    ours, theirs = openpty()
    with open(theirs, "w", encoding="ascii") as errors:
        monkeypatch.setattr(sys, "stderr", errors)
        yield ours
        wait_for_notices()
    monkeypatch.undo()
    with suppress(OSError):
        os.close(ours)


def wait_for_notices():
    while notices._session is not None and not notices._session.is_over:
        time.sleep(0.01)
    time.sleep(0.1)


@pytest.fixture
def heard():
    """Return the notices that a callback receives."""
    told = []
    notices.listeners.append(told.append)
    yield told
    notices.listeners.remove(told.append)


@NEEDS_TERMINAL
def test_two_lines_on_a_terminal_say_that_kernels_are_compiled(monkeypatch):
    with terminal(monkeypatch) as ours:
        for _ in range(2):
            with announce(COMPILING_MESSAGE):
                time.sleep(0.2)
        wait_for_notices()
        said = os.read(ours, 10_000).decode()
    assert said.splitlines() == [f"splits: {COMPILING_MESSAGE}", f"splits: {DONE_MESSAGE}: 0 s"]


@NEEDS_TERMINAL
def test_what_is_compiled_at_once_needs_no_word(monkeypatch):
    with terminal(monkeypatch) as ours:
        with announce(COMPILING_MESSAGE):
            pass
        wait_for_notices()
        os.set_blocking(ours, False)
        with pytest.raises(BlockingIOError):
            os.read(ours, 1)


@NEEDS_TERMINAL
def test_a_terminal_that_was_closed_ends_nothing(monkeypatch):
    with terminal(monkeypatch) as ours:
        os.close(ours)
        with announce(COMPILING_MESSAGE):
            time.sleep(0.2)


def test_without_a_terminal_there_is_no_notice(capfd):
    with announce(COMPILING_MESSAGE):
        time.sleep(0.2)
    assert notices._session is None
    assert capfd.readouterr() == ("", "")


def test_bars_show_it_with_the_seconds(capsys):
    with splits.ProgressBar("mine"), announce(COMPILING_MESSAGE):
        time.sleep(0.3)
    assert f"{COMPILING_MESSAGE}: 0 s" in capsys.readouterr().err
    assert notices.listeners == []


def test_a_callback_that_fails_ends_nothing(heard):
    notices.listeners.insert(0, lambda text: 1 / 0)
    with announce(COMPILING_MESSAGE):
        time.sleep(0.2)
    del notices.listeners[0]
    assert heard


@pytest.mark.skipif(cache_lock.fcntl is None, reason="no locks here")
def test_a_process_that_waits_for_another_says_so(heard, monkeypatch, tmp_path):
    begun = time.monotonic()

    def lockf(*given):
        if time.monotonic() - begun < 0.3:
            raise BlockingIOError

    monkeypatch.setattr(cache_lock.fcntl, "lockf", lockf)
    assert cache_lock.acquire_lock(tmp_path, "kernel")
    assert heard[0] == f"{WAITING_MESSAGE}: 0 s"


def test_compiling_a_kernel_says_so(heard):
    """Held without a kernel, which may lie compiled in a folder."""
    compiled = KernelCache.release_locks_on_failure(None, time.sleep)
    compiled(0.3)
    assert heard[0] == f"{COMPILING_MESSAGE}: 0 s"
