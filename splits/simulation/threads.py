"""Threads that nobody has to wait for: a run that is broken off ends at once.

Kernels cannot be broken off.  Those of `concurrent.futures.ThreadPoolExecutor` keep a process
from ending until they are through, which may be minutes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from contextlib import AbstractContextManager
from functools import cache
from queue import Empty, SimpleQueue
from typing import Any

from threadpoolctl import ThreadpoolController

_thread_local = threading.local()


def count_cpus() -> int:
    """Return the number of CPUs this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    # macOS and Windows; Python 3.13 has a count that heeds PYTHON_CPU_COUNT.
    count: Callable[[], int | None] = getattr(os, "process_cpu_count", os.cpu_count)
    return count() or 1


def limit_blas_threads() -> AbstractContextManager[Any]:
    """Leave linear algebra the thread that calls it.

    It would take every CPU, whatever threads were asked for, for products so small that they take
    six to eighteen times as long where another process has a CPU.
    """
    return _get_threadpool_controller().limit(limits=1, user_api="blas")


@cache
def _get_threadpool_controller() -> ThreadpoolController:
    # To find the libraries that are loaded takes milliseconds.
    return ThreadpoolController()


class DaemonThreadPool(Executor):
    """So many threads that work off jobs, until they are shut down or the process ends.

    Left by an error or a signal, it begins no other job, and does not wait for those that run: what
    they find is lost.  A job that itself shares out work then fails as soon as it does so again.

    Parameters
    ----------
    n_threads : int
        At least 1.

    Examples
    --------
    >>> with Threads(2) as threads:
    ...     list(threads.map(abs, [-1, 2]))
    [1, 2]
    """

    def __init__(self, n_threads: int) -> None:
        self.n_threads = n_threads
        self.closed = False
        self._parent_pool: DaemonThreadPool | None = getattr(_thread_local, "threads", None)
        self._jobs: SimpleQueue = SimpleQueue()
        self._n_started = 0

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """Hand out a job.

        Raises
        ------
        CancelledError
            If these threads, or those that this job belongs to, were shut down.
        """
        within: DaemonThreadPool | None = self
        while within is not None:
            if within.closed:
                raise CancelledError("broken off")
            within = within._parent_pool
        future: Future = Future()
        self._jobs.put((future, fn, args, kwargs))
        if self._n_started < self.n_threads:
            self._n_started += 1
            threading.Thread(target=self._run_jobs, daemon=True).start()
        return future

    def shutdown(self, wait: bool = False, *, cancel_futures: bool = True) -> None:
        """Let no other job begin; those that run are not waited for."""
        self.closed = True
        while True:
            try:
                self._jobs.get_nowait()[0].cancel()
            except Empty:
                break
        for _ in range(self._n_started):
            self._jobs.put(None)

    def _run_jobs(self) -> None:
        _thread_local.threads = self
        while (job := self._jobs.get()) is not None:
            future, fn, args, kwargs = job
            if future.set_running_or_notify_cancel():
                try:
                    result = fn(*args, **kwargs)
                except BaseException as error:
                    future.set_exception(error)
                else:
                    future.set_result(result)
                    del result
            # Or the last result would be kept while there is nothing to do.
            del job, future, fn, args, kwargs
