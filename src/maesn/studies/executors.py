"""Where jobs are computed: in this process, in processes of this machine, or on a Ray cluster."""

import contextlib
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, NamedTuple

from maesn.physics import EngineError
from maesn.runs.process import enable_compilation_cache, ending_by_signals
from maesn.storage import RunError
from maesn.studies.jobs import AbstractJob, run_job
from maesn.worlds import EpisodeError

ExecutorName = Literal["local", "ray"]


class Failure(NamedTuple):
    """Why a job is not done."""

    error: str
    is_final: bool = False
    """Whether the same would happen again: a setting, not an accident."""


class AbstractExecutor(ABC):
    """Computes jobs, each with a fixed number of threads."""

    slots: int
    """Jobs that may run at a time."""

    @abstractmethod
    def submit(self, job: AbstractJob, jobs: Path) -> Future[Failure | None]:
        """Begin a job in the directory of all jobs. There is a slot for it.

        What is returned will hold None, or how the job has failed. It raises if the job is lost,
        with its process or its machine.
        """

    def close(self) -> None:
        """Stop all jobs; what they are at is saved as far as they can."""
        return


def computed(job: AbstractJob, jobs: Path) -> Failure | None:
    """Compute a job; return how it has failed, None if it is done."""
    try:
        run_job(job, jobs)
    except (RunError, EngineError) as error:
        return Failure(str(error), is_final=True)
    except (EpisodeError, MemoryError, OSError, RuntimeError) as error:
        return accident(error)
    return None


def accident(error: BaseException) -> Failure:
    """Return a failure that need not happen again."""
    return Failure(f"{type(error).__name__}: {error}")


class Here(AbstractExecutor):
    """This process, one job after the other."""

    slots = 1

    def submit(self, job: AbstractJob, jobs: Path) -> Future[Failure | None]:
        future: Future[Failure | None] = Future()
        future.set_result(computed(job, jobs))
        return future


class LocalPool(AbstractExecutor):
    """Processes of this machine. Each is a pool of its own: one that dies costs its job alone."""

    def __init__(self, workers: int, threads: int) -> None:
        self.slots = workers
        self._threads = threads
        self._context = multiprocessing.get_context("spawn")
        # Workers wait at the one end of a pipe until the other one is closed, by `close` or by the
        # end of this process.
        self._parent, self._alive = self._context.Pipe(duplex=False)
        self._last: dict[ProcessPoolExecutor, Future[Failure | None]] = {}

    def submit(self, job: AbstractJob, jobs: Path) -> Future[Failure | None]:
        idle = [pool for pool, last in self._last.items() if last.done()]
        # First those that lost a job, perhaps this one: nobody else can begin it before they end.
        for pool in sorted(idle, key=lambda one: self._last[one].exception() is None):
            try:
                return self._begin_in(pool, job, jobs)
            except BrokenProcessPool:
                pool.shutdown()  # waits until its process, and with it the lock of a job, is gone
                del self._last[pool]
        pool = ProcessPoolExecutor(1, self._context, initializer=_begin, initargs=(self._parent,))
        return self._begin_in(pool, job, jobs)

    def _begin_in(
        self, pool: ProcessPoolExecutor, job: AbstractJob, jobs: Path
    ) -> Future[Failure | None]:
        with _environment(thread_variables(self._threads)):  # a process begins with its first job
            self._last[pool] = pool.submit(_compute, job, jobs)
        return self._last[pool]

    def close(self) -> None:
        self._alive.close()
        for pool in self._last:
            pool.shutdown()
        self._parent.close()


def _begin(parent: Connection) -> None:
    """Prepare a worker: it has SIGTERM when the parent has closed its end of a pipe, or is gone."""

    def end() -> None:
        parent.poll(None)
        os.kill(os.getpid(), signal.SIGTERM)

    # Ctrl-C in a terminal reaches all processes; what it means is the parent's to say.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    enable_compilation_cache()
    threading.Thread(target=end, daemon=True).start()


def _compute(job: AbstractJob, jobs: Path) -> Failure | None:
    """Compute a job in a worker, which ends by SIGTERM when it has saved what there is."""
    try:
        with ending_by_signals():
            return computed(job, jobs)
    except SystemExit:
        os._exit(1)  # the pool would catch it, and wait for jobs of a parent that may be gone


class Ray(AbstractExecutor):
    """A Ray cluster: that of `RAY_ADDRESS`, else one on this machine.

    Its machines must see the study's directory at the same path.
    """

    def __init__(self, workers: int, threads: int, jobs: Path, gpus: float = 0.0) -> None:
        try:
            self._ray: Any = __import__("ray")
        except ImportError as error:
            raise RunError("the executor `ray` needs Ray: pip install 'maesn[ray]'.") from error
        local = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": workers * threads}
        if not self._ray.is_initialized():
            self._ray.init(log_to_driver=False, include_dashboard=False, **local)
        path = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        variables = path | thread_variables(threads)
        self._remote = self._ray.remote(_on_cluster).options(
            num_cpus=threads, num_gpus=gpus, max_retries=0, runtime_env={"env_vars": variables}
        )
        cpus = int(self._ray.cluster_resources().get("CPU", 1))
        self.slots = min(workers, cpus // threads) or 1
        self._references: dict[Future[Failure | None], Any] = {}
        self._check_shared(jobs)

    def submit(self, job: AbstractJob, jobs: Path) -> Future[Failure | None]:
        reference = self._remote.remote(computed, job, jobs.resolve())
        future: Future[Failure | None] = reference.future()
        self._references[future] = reference
        return future

    def close(self) -> None:
        running = [one for future, one in self._references.items() if not future.done()]
        for one in running:
            self._ray.cancel(one)  # as Ctrl-C: training saves
        self._ray.wait(running, num_returns=len(running), timeout=30)
        self._ray.shutdown()

    def _check_shared(self, jobs: Path) -> None:
        """Refuse a directory that workers do not see."""
        with tempfile.NamedTemporaryFile(dir=jobs, prefix="probe-") as probe:
            if not self._ray.get(self._remote.remote(Path.exists, Path(probe.name).resolve())):
                raise RunError(
                    f"the cluster's workers do not see `{jobs.resolve()}`: give an --out on a file "
                    "system that all machines share, at the same path."
                )


def _on_cluster(function: Any, *arguments: Any) -> Any:
    enable_compilation_cache()
    return function(*arguments)


def thread_variables(threads: int) -> dict[str, str]:
    """Return variables with which a process computes in so many threads, XLA's included."""
    eigen = "" if threads > 1 else " --xla_cpu_multi_thread_eigen=false"
    return {
        "OMP_NUM_THREADS": str(threads),
        "OPENBLAS_NUM_THREADS": str(threads),
        "NPROC": str(threads),  # of XLA's pool
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", "") + eigen,
    }


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
