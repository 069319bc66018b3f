"""Where jobs are computed: in processes of this machine."""

import multiprocessing
import os
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path

from maesn.runs.process import enable_compilation_cache, ending_by_signals
from maesn.storage import RunError
from maesn.studies.execution import AbstractExecutor
from maesn.studies.jobs import Job, computed


class LocalPool(AbstractExecutor):
    """Processes of this machine. Each is a pool of its own: one that dies costs its job alone."""

    def __init__(self, workers: int, threads: int) -> None:
        self.slots = workers
        self._before = dict(os.environ)
        os.environ.update(thread_variables(threads))  # for processes that begin from now on
        self._context = multiprocessing.get_context("spawn")
        # Workers wait until its end here is closed, by `close` or because this process ends.
        self._parent, self._alive = self._context.Pipe(duplex=False)
        self._has_begun = self._context.Event()  # set by the first worker that gets so far
        self._last: dict[ProcessPoolExecutor, Future[str | None]] = {}

    def submit(self, job: Job, jobs: Path) -> Future[str | None]:
        idle = [pool for pool, last in self._last.items() if last.done()]
        given = self._parent, self._has_begun
        pool = idle[0] if idle else ProcessPoolExecutor(1, self._context, _begin, given)
        try:
            self._last[pool] = pool.submit(_compute, job, jobs)
        except BrokenProcessPool:
            pool.shutdown()
            del self._last[pool]
            return self.submit(job, jobs)
        return self._last[pool]

    def describe(self, lost: BaseException) -> str:
        if not isinstance(lost, BrokenProcessPool):
            return super().describe(lost)
        if self._has_begun.is_set():
            return "its process died: something killed it, perhaps because memory ran out."
        raise RunError(
            "no process of the study could begin. Each runs your script from its first line, so "
            'what the script does must stand beneath `if __name__ == "__main__":`. If it does, the '
            "output above says what went wrong."
        )

    def close(self) -> None:
        self._alive.close()
        for pool in self._last:
            pool.shutdown()
        self._parent.close()
        os.environ.clear()
        os.environ.update(self._before)


def end_if_worker() -> None:
    """End a process that `LocalPool` has started and that runs the user's script once more.

    Without a main guard the script would begin its study again. `LocalPool.describe` says so.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise SystemExit(1)


def _begin(parent: Connection, has_begun: Event) -> None:
    """Prepare a worker, which gets SIGTERM when the parent closes its end of a pipe or dies."""

    def end() -> None:
        parent.poll(None)
        os.kill(os.getpid(), signal.SIGTERM)

    # Ctrl-C in a terminal reaches all processes; the parent alone answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    has_begun.set()
    enable_compilation_cache()
    threading.Thread(target=end, daemon=True).start()


def _compute(job: Job, jobs: Path) -> str | None:
    """Compute a job in a worker. On SIGTERM it saves its state and ends."""
    try:
        with ending_by_signals():
            return computed(job, jobs)
    except SystemExit:
        os._exit(1)  # the pool would catch it, and wait for jobs of a parent that may be gone


def thread_variables(threads: int) -> dict[str, str]:
    """Return environment variables that limit the threads of a process, XLA's included."""
    eigen = "" if threads > 1 else " --xla_cpu_multi_thread_eigen=false"
    return {
        "OMP_NUM_THREADS": str(threads),
        "OPENBLAS_NUM_THREADS": str(threads),
        "NPROC": str(threads),  # size of XLA's pool
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", "") + eigen,
    }
