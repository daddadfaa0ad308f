"""Thread pool with daemon workers, so that an interrupted run exits immediately.

Compiled kernels cannot be interrupted.  `concurrent.futures.ThreadPoolExecutor` would keep a
process from exiting until they return, which may take minutes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from functools import cache
from queue import Empty, SimpleQueue
from typing import Any

from threadpoolctl import ThreadpoolController

from splits.core.process import make_lock

_thread_local, _blas_lock = threading.local(), make_lock()
# Inspecting the loaded libraries takes milliseconds.
_get_threadpool_controller = cache(ThreadpoolController)


@contextmanager
def limit_blas_threads() -> Iterator[None]:
    """Limit linear algebra to the calling thread.

    BLAS would use every CPU, whatever number of threads was requested; small products then take
    six to eighteen times as long where another process occupies a CPU.  The limit is that of the
    process, so that threads take turns: each restores what it found.
    """
    with _blas_lock, _get_threadpool_controller().limit(limits=1, user_api="blas"):
        yield


class DaemonThreadPool(Executor):
    """Pool of threads that run jobs until they are shut down or the process ends.

    After an error or a signal no further job begins, and running jobs are not waited for: their
    results are discarded.  A running job that submits jobs to a pool of its own then fails at its
    next submission.

    Parameters
    ----------
    n_threads : int
        At least 1.

    Examples
    --------
    >>> with DaemonThreadPool(2) as threads:
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
        """Submit a job.

        Raises
        ------
        CancelledError
            If this pool, or the pool that runs the calling job, was shut down.
        """
        pool: DaemonThreadPool | None = self
        while pool is not None:
            if pool.closed:
                raise CancelledError("the pool was shut down")
            pool = pool._parent_pool
        future: Future = Future()
        self._jobs.put((future, fn, args, kwargs))
        if self._n_started < self.n_threads:
            self._n_started += 1
            threading.Thread(target=self._run_jobs, daemon=True).start()
        return future

    def shutdown(self, wait: bool = False, *, cancel_futures: bool = True) -> None:
        """Start no further jobs; running ones are not waited for."""
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
            # Release the last result while the thread is idle.
            del job, future, fn, args, kwargs
