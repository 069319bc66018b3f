"""Where jobs are computed: in this process, in a pool of processes, or on a Ray cluster.

Each starts jobs and says which have ended. A job that is lost, with its process or its machine, is
one that has failed.
"""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import tempfile
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Literal, NamedTuple

from maesn.physics import EngineError
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.signals import ending_by_signals
from maesn.storage import RunError
from maesn.studies.jobs import AbstractJob, run_job
from maesn.worlds import EpisodeError

ExecutorName = Literal["local", "ray"]


class Ended(NamedTuple):
    """A job that has ended."""

    job: str
    error: str = ""
    """Empty if it is done."""
    is_final: bool = False
    """Whether the same would happen again: a setting, not an accident."""


class AbstractExecutor(ABC):
    """Computes jobs, each with a fixed number of threads."""

    slots: int
    """Jobs that may run at a time."""

    @abstractmethod
    def start(self, job: AbstractJob, jobs: Path) -> None:
        """Begin a job. There is a slot for it."""

    @abstractmethod
    def wait(self, seconds: float) -> list[Ended]:
        """Return the jobs that have ended by now, or do within some seconds."""

    @abstractmethod
    def close(self) -> None:
        """Stop all jobs; what they are at is saved as far as they can."""


def computed(job: AbstractJob, jobs: Path) -> Ended:
    """Compute a job, and say how it ended."""
    try:
        run_job(job, jobs)
    except (RunError, EngineError) as error:
        return Ended(job.name, str(error), is_final=True)
    except (EpisodeError, MemoryError, OSError, RuntimeError) as error:
        return Ended(job.name, f"{type(error).__name__}: {error}")
    return Ended(job.name)


class Here(AbstractExecutor):
    """This process, one job after the other."""

    slots = 1

    def __init__(self) -> None:
        self._ended: list[Ended] = []

    def start(self, job: AbstractJob, jobs: Path) -> None:
        """Compute the job."""
        self._ended.append(computed(job, jobs))

    def wait(self, seconds: float) -> list[Ended]:
        ended, self._ended = self._ended, []
        return ended

    def close(self) -> None:
        pass


class _Worker:
    """A process that computes one job at a time."""

    def __init__(self, threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=False)
        with _environment(thread_variables(threads)):
            self.process.start()
        theirs.close()
        self.job = ""

    def start(self, job: AbstractJob, jobs: Path) -> None:
        self.job = job.name
        with contextlib.suppress(OSError):  # it is gone, which `ended` will say
            self.connection.send((job, jobs))

    def ended(self) -> Ended:
        """Return how its job ended, which it has just said, or died over."""
        try:
            ended: Ended = self.connection.recv()
        except (EOFError, OSError):
            self.process.join()
            ended = Ended(self.job, f"its process ended with status {self.process.exitcode}")
        self.job = ""
        return ended


class LocalPool(AbstractExecutor):
    """Processes of this machine. One that dies is replaced."""

    def __init__(self, workers: int, threads: int) -> None:
        self.slots = workers
        self._threads = threads
        self._workers: list[_Worker] = []

    def start(self, job: AbstractJob, jobs: Path) -> None:
        self._workers = [one for one in self._workers if one.process.is_alive() or one.job]
        idle = next((one for one in self._workers if not one.job), None)
        if idle is None:
            idle = _Worker(self._threads)
            self._workers.append(idle)
        idle.start(job, jobs)

    def wait(self, seconds: float) -> list[Ended]:
        at_work = {one.connection: one for one in self._workers if one.job}
        return [at_work[one].ended() for one in wait(list(at_work), seconds)]  # type: ignore[index]

    def close(self) -> None:
        for one in self._workers:
            one.connection.close()  # ends one that waits
            if one.job:
                one.process.terminate()
        for one in self._workers:
            one.process.join()


def _serve(connection: Connection) -> None:
    """Compute the jobs that come, until the parent ends."""
    # Ctrl-C in a terminal reaches all processes; what it means is the parent's to say.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_parent()
    enable_compilation_cache()
    with contextlib.suppress(EOFError, OSError), ending_by_signals():
        while True:
            connection.send(computed(*connection.recv()))


def _end_with_parent() -> None:
    """Get SIGTERM when the parent is gone, where the system can: jobs then save what they have."""
    parent = multiprocessing.parent_process()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG
    if parent is not None and os.getppid() != parent.pid:
        raise SystemExit(0)


class Ray(AbstractExecutor):
    """A Ray cluster: that of `RAY_ADDRESS`, else one on this machine.

    Its machines must see the study's directory at the same path.
    """

    def __init__(self, workers: int, threads: int, jobs: Path, gpus: float = 0.0) -> None:
        self._ray = _import_ray()
        local = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": workers * threads}
        if not self._ray.is_initialized():
            self._ray.init(log_to_driver=False, include_dashboard=False, **local)
        variables = {
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            **thread_variables(threads),
        }
        self._remote = self._ray.remote(_on_cluster).options(
            num_cpus=threads, num_gpus=gpus, max_retries=0, runtime_env={"env_vars": variables}
        )
        cpus = int(self._ray.cluster_resources().get("CPU", 1))
        self.slots = min(workers, cpus // threads) or 1
        self._running: dict[Any, str] = {}
        _check_shared(self._ray, self._remote, jobs)

    def start(self, job: AbstractJob, jobs: Path) -> None:
        self._running[self._remote.remote(computed, job, jobs.resolve())] = job.name

    def wait(self, seconds: float) -> list[Ended]:
        ready, _ = self._ray.wait(list(self._running), timeout=seconds)
        return [self._ended(one, self._running.pop(one)) for one in ready]

    def _ended(self, reference: Any, job: str) -> Ended:
        try:
            ended: Ended = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            return Ended(job, f"its Ray worker is gone ({type(error).__name__})")
        return ended

    def close(self) -> None:
        for one in self._running:
            self._ray.cancel(one)  # as Ctrl-C: training saves
        self._ray.wait(list(self._running), num_returns=len(self._running), timeout=30)
        self._ray.shutdown()


def _on_cluster(function: Any, *arguments: Any) -> Any:
    enable_compilation_cache()
    return function(*arguments)


def _check_shared(ray: Any, remote: Any, jobs: Path) -> None:
    """Refuse a directory that workers do not see."""
    with tempfile.NamedTemporaryFile(dir=jobs, prefix="probe-") as probe:
        probe.write(uuid.uuid4().bytes)
        probe.flush()
        seen = ray.get(remote.remote(Path.exists, Path(probe.name).resolve()))
    if not seen:
        raise RunError(
            f"the cluster's workers do not see `{jobs.resolve()}`: give an --out on a file system "
            "that all machines share, at the same path."
        )


def _import_ray() -> Any:
    try:
        return __import__("ray")
    except ImportError as error:
        raise RunError("the executor `ray` needs Ray: pip install 'maesn[ray]'.") from error


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
