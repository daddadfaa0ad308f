"""Threads that work off jobs: in order, with errors passed on, and without waiting at the end."""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import CancelledError

import pytest
from chi2 import NEEDS_JIT
from threadpoolctl import threadpool_info, threadpool_limits

import splits
from splits.simulation.arguments import check_threads
from splits.simulation.runner import Runner
from splits.simulation.threads import DaemonThreadPool, count_cpus, limit_blas_threads

SNOW = splits.Snow(depth_m=0.02)
LONG_TIME_S = 20.0
"""How long a job would take that nobody waits for."""


def test_systems_without_affinity_count_their_cpus(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(os, "process_cpu_count", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert count_cpus() == check_threads(None) == Runner(SNOW, 0.0, 1, None, False).threads == 6
    monkeypatch.setattr(os, "process_cpu_count", lambda: 4, raising=False)
    assert count_cpus() == 4
    monkeypatch.setattr(os, "process_cpu_count", lambda: None)
    assert count_cpus() == 1


def test_cpus_are_those_that_this_process_may_use():
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("this system does not tell")
    assert count_cpus() == len(os.sched_getaffinity(0))


def test_linear_algebra_is_left_one_thread():
    def blas():
        return [lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"]

    # Whatever it was given at the start: tests that run side by side leave it one thread, too.
    with threadpool_limits(limits=2, user_api="blas"):
        assert set(blas()) == {2}
        with limit_blas_threads():
            assert set(blas()) == {1}
        assert set(blas()) == {2}


@pytest.mark.parametrize("number", [1, 2, 7])
def test_results_come_in_order(number):
    def late(x):
        time.sleep(0.002 * (x % 3))
        return x * x

    with DaemonThreadPool(number) as threads:
        assert list(threads.map(late, range(30))) == [x * x for x in range(30)]
        assert list(threads.map(late, range(3))) == [0, 1, 4]
    with pytest.raises(CancelledError):
        threads.submit(late, 1)


def test_no_more_threads_than_asked_for_nor_than_jobs():
    seen = set()

    def note(x):
        time.sleep(0.01)
        seen.add(threading.get_ident())

    with DaemonThreadPool(3) as threads:
        list(threads.map(note, range(20)))
    assert len(seen) <= 3
    before = threading.active_count()
    with DaemonThreadPool(100) as threads:
        list(threads.map(note, range(2)))
        assert threading.active_count() <= before + 2


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_error_of_a_job_is_passed_on(error):
    def fail(x):
        if x == 1:
            raise error("at one")
        return x

    with pytest.raises(error, match="at one"), DaemonThreadPool(2) as threads:
        list(threads.map(fail, range(5)))


def test_nobody_waits_for_jobs_of_a_run_that_is_broken_off():
    begun, go_on = [], threading.Event()

    def wait(x):
        begun.append(x)
        go_on.wait(LONG_TIME_S)

    since = time.perf_counter()
    with pytest.raises(KeyboardInterrupt), DaemonThreadPool(2) as threads:
        threads.map(wait, range(10))
        while len(begun) < 2:
            time.sleep(0.001)
        raise KeyboardInterrupt
    assert time.perf_counter() - since < LONG_TIME_S / 2
    go_on.set()
    time.sleep(0.1)
    assert begun == [0, 1]


def test_a_job_that_shares_out_work_ends_with_the_run_it_belongs_to():
    inside, go_on, ended = threading.Event(), threading.Event(), []

    def outer(x):
        try:
            with DaemonThreadPool(1) as inner:
                while True:
                    list(inner.map(abs, [x]))
                    inside.set()
                    go_on.wait(LONG_TIME_S)
        except CancelledError:
            ended.append(x)

    with DaemonThreadPool(1) as threads:
        threads.submit(outer, 1)
        assert inside.wait(LONG_TIME_S)
    go_on.set()
    for _ in range(1000):
        if ended:
            break
        time.sleep(0.01)
    assert ended == [1]


def report_at_once(runner, *told):
    """Stand for `Runner._report_progress`, which reports twice a second at most."""
    runner.progress_callback(told)


@NEEDS_JIT
@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, RuntimeError])
def test_what_a_report_of_progress_raises_ends_the_run(error, monkeypatch):
    def tell(progress):
        raise error("enough")

    with pytest.raises(error, match="enough"):
        splits.deep_transmittance(SNOW, [1000.0], relative_stderr=0.5, threads=2, progress=tell)
    monkeypatch.setattr(Runner, "_report_progress", report_at_once)
    with pytest.raises(error, match="enough"):
        splits.spectrophotometer(SNOW, [500.0], max_stderr=1e-4, threads=2, progress=tell)


@NEEDS_JIT
def test_numbers_are_the_same_after_a_run_that_was_broken_off(monkeypatch):
    def enough(progress):
        raise KeyboardInterrupt

    whole = splits.spectrophotometer(SNOW, [500.0, 1030.0], max_stderr=0.02, threads=2)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(Runner, "_report_progress", report_at_once)
        splits.spectrophotometer(SNOW, [500.0], max_stderr=1e-4, threads=2, progress=enough)
    again = splits.spectrophotometer(SNOW, [500.0, 1030.0], max_stderr=0.02, threads=1)
    assert whole.equals(again)
