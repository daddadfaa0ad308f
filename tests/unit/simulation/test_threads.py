"""Threads and random streams: order of results, errors, immediate exit, independence."""

import importlib
import os
import pkgutil
import signal
import threading
import time
from concurrent.futures import CancelledError
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from threadpoolctl import threadpool_info, threadpool_limits

import splits
from splits.core.process import count_cpus
from splits.instruments.angular_tallies import ORDER_CLASSES, AngularBinTally, ExpansionTally
from splits.instruments.beam_spread import BeamSpreadTally
from splits.instruments.flux_tally import FluxTally
from splits.io.netcdf import NETCDF_LOCK
from splits.kernels.records import make_basis
from splits.simulation import engine
from splits.simulation.grain_optics import SingleScatteringTally
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import OpticalConstants, build_scene
from splits.simulation.shared_paths import SpectralRows
from splits.simulation.spectral_nodes import MAX_SEPARATE_NODES, make_separate_nodes
from splits.simulation.spectral_tally import ANALOG_STREAM, SpectralTally
from splits.simulation.strata import STRATUM_BOUNDS
from splits.simulation.tally import Tally
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads

SNOW = splits.Snow(depth_m=0.02)
LONG_TIME_S = 20.0
"""Duration of a job that an interrupted run does not wait for (s)."""


def test_cpu_count_without_affinity(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(os, "process_cpu_count", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert count_cpus() == RunOptions.start(1, None).threads == 6
    monkeypatch.setattr(os, "process_cpu_count", lambda: 4, raising=False)
    assert count_cpus() == 4
    monkeypatch.setattr(os, "process_cpu_count", lambda: None)
    assert count_cpus() == 1


def test_cpu_count_respects_affinity():
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("needs os.sched_getaffinity")
    assert count_cpus() == len(os.sched_getaffinity(0))


def count_blas_threads():
    return [lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"]


def test_blas_is_limited_to_one_thread():
    # The initial number is set, as tests that run in parallel may have limited it already.
    with threadpool_limits(limits=2, user_api="blas"):
        assert set(count_blas_threads()) == {2}
        with limit_blas_threads():
            assert set(count_blas_threads()) == {1}
        assert set(count_blas_threads()) == {2}


def test_blas_is_restored_after_concurrent_limits():
    def limit_often(_):
        for _ in range(50):
            with limit_blas_threads():
                assert set(count_blas_threads()) == {1}

    before = count_blas_threads()
    with DaemonThreadPool(4) as threads:
        list(threads.map(limit_often, range(4)))
    assert count_blas_threads() == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
@pytest.mark.parametrize("hold", [limit_blas_threads, lambda: NETCDF_LOCK], ids=["solve", "read"])
def test_forked_children_find_locks_of_other_threads_free(hold):
    """While another thread solves or reads, forking waits until it has finished."""
    inside = threading.Event()

    def occupy():
        with hold():
            inside.set()
            time.sleep(0.3)

    before = count_blas_threads()
    thread = threading.Thread(target=occupy)
    thread.start()
    assert inside.wait(LONG_TIME_S)
    child = os.fork()
    if child == 0:
        # The alarm ends a child that waits for ever.
        signal.alarm(int(LONG_TIME_S))
        with hold():
            pass
        os._exit(count_blas_threads() != before)
    assert os.waitpid(child, 0)[1] == 0
    thread.join()
    with hold():
        pass
    assert count_blas_threads() == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
def test_children_forked_while_locks_are_held_keep_them():
    with limit_blas_threads():
        child = os.fork()
        if child == 0:
            signal.alarm(int(LONG_TIME_S))
            with limit_blas_threads():
                os._exit(set(count_blas_threads()) != {1})
    assert os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize("n_threads", [1, 2, 7])
def test_results_are_in_order(n_threads):
    def square_after_delay(x):
        time.sleep(0.002 * (x % 3))
        return x * x

    with DaemonThreadPool(n_threads) as threads:
        assert list(threads.map(square_after_delay, range(30))) == [x * x for x in range(30)]
        assert list(threads.map(square_after_delay, range(3))) == [0, 1, 4]
    with pytest.raises(CancelledError):
        threads.submit(square_after_delay, 1)


def test_number_of_threads_is_limited():
    thread_ids = set()

    def record_thread(x):
        time.sleep(0.01)
        thread_ids.add(threading.get_ident())

    with DaemonThreadPool(3) as threads:
        list(threads.map(record_thread, range(20)))
    assert len(thread_ids) <= 3
    before = threading.active_count()
    with DaemonThreadPool(100) as threads:
        list(threads.map(record_thread, range(2)))
        assert threading.active_count() <= before + 2


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_errors_of_jobs_are_propagated(error):
    def fail(x):
        if x == 1:
            raise error("at one")
        return x

    with pytest.raises(error, match="at one"), DaemonThreadPool(2) as threads:
        list(threads.map(fail, range(5)))


def test_interrupted_runs_do_not_wait_for_jobs():
    started, resume = [], threading.Event()

    def wait(x):
        started.append(x)
        resume.wait(LONG_TIME_S)

    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt), DaemonThreadPool(2) as threads:
        threads.map(wait, range(10))
        while len(started) < 2:
            time.sleep(0.001)
        raise KeyboardInterrupt
    assert time.perf_counter() - start < LONG_TIME_S / 2
    resume.set()
    time.sleep(0.1)
    assert started == [0, 1]


def test_nested_pools_end_with_the_outer_pool():
    running, resume, ended = threading.Event(), threading.Event(), []

    def outer(x):
        try:
            with DaemonThreadPool(1) as inner:
                while True:
                    list(inner.map(abs, [x]))
                    running.set()
                    resume.wait(LONG_TIME_S)
        except CancelledError:
            ended.append(x)

    with DaemonThreadPool(1) as threads:
        threads.submit(outer, 1)
        assert running.wait(LONG_TIME_S)
    resume.set()
    for _ in range(1000):
        if ended:
            break
        time.sleep(0.01)
    assert ended == [1]


@NEEDS_JIT
@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, RuntimeError])
def test_errors_of_progress_callbacks_end_the_run(error, monkeypatch):
    def fail(progress):
        raise error("enough")

    # Every job is reported, not only two a second.
    monkeypatch.setattr(engine, "MIN_REPORT_INTERVAL_S", -1.0)
    with pytest.raises(error, match="enough"):
        splits.spectrophotometer(SNOW, [500.0], max_stderr=1e-4, threads=2, progress=fail)


@NEEDS_JIT
def test_results_are_unchanged_after_an_interrupted_run(monkeypatch):
    def interrupt(progress):
        raise KeyboardInterrupt

    expected = splits.spectrophotometer(SNOW, [500.0, 1030.0], max_stderr=0.02, threads=2)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(engine, "MIN_REPORT_INTERVAL_S", -1.0)
        splits.spectrophotometer(SNOW, [500.0], max_stderr=1e-4, threads=2, progress=interrupt)
    repeated = splits.spectrophotometer(SNOW, [500.0, 1030.0], max_stderr=0.02, threads=1)
    assert expected.equals(repeated)


def list_tally_classes(base=Tally):
    """Return the classes of tallies of the package that have random streams."""
    classes = set()
    for child in base.__subclasses__():
        if child.__module__.startswith("splits."):
            classes |= list_tally_classes(child) | (
                {child} if "first_stream" in vars(child) else set()
            )
    return classes


def test_first_streams_leave_room_for_all_strata():
    for module in pkgutil.walk_packages(splits.__path__, "splits."):
        importlib.import_module(module.name)
    offsets = sorted([ANALOG_STREAM, *(one.first_stream for one in list_tally_classes())])
    max_streams = MAX_SEPARATE_NODES * max(len(STRATUM_BOUNDS), len(ORDER_CLASSES))
    assert len(set(offsets)) == len(offsets) == 10
    assert min(np.diff(offsets)) > max_streams


def test_strata_have_different_streams():
    """Three nodes, each used at three wavelengths of increasing absorption."""
    index = np.array([[1.3, 1.3], [1.4, 1.4], [1.5, 1.5]]) + 0j
    absorption = np.repeat([[0.0], [9.0], [99.0]], 2, axis=1)
    nodes = replace(make_separate_nodes(index), weights=np.full((3, 3), 1.0 / 3.0))
    scene = build_scene(splits.Snow(depth_m=1.0), 0.0, analog=False)
    analog_scene = scene._replace(rules=scene.rules._replace(analog=True))
    rows = SpectralRows(index, absorption, absorption, np.zeros((0, 3, 2)), ())
    traced_medium = SimpleNamespace(
        constants=OpticalConstants(index, absorption), path_fractions=None, planes_m=np.ones(2),
    )  # fmt: skip
    directions = SimpleNamespace(basis=make_basis(2))
    tallies = {
        SpectralTally(rows, nodes, scene): 9,
        SpectralTally(rows, nodes, analog_scene): 3,
        FluxTally(nodes, traced_medium, scene, None): 9,
        ExpansionTally(nodes, absorption, directions, 30.0, None): 3 * len(ORDER_CLASSES),
        AngularBinTally(nodes, absorption, (2, 2), False): 3,
        BeamSpreadTally(nodes, absorption, 1.0): 3,
        BeamSpreadTally(nodes, absorption, 1.0, first_node=3): 3,
        SingleScatteringTally(nodes, absorption, np.zeros(3), 2, 2048): 3,
    }
    for tally, n_strata in tallies.items():
        assert len(tally.strata) == n_strata
    streams = [stratum.stream for tally in tallies for stratum in tally.strata]
    assert len(set(streams)) == len(streams)
