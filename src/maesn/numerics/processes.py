"""Start and coordinate the processes and devices that train one run together."""

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import jax
import numpy as np
from jax.experimental import multihost_utils

from maesn.numerics.mesh import sharing_tasks
from maesn.storage import RunError

# Seconds of silence after which a process counts as dead; the others then end as well.
HEARTBEAT_TIMEOUT = 20
# Seconds that a process that has finished waits for the others.
SHUTDOWN_TIMEOUT = 20
# The `coordinator` for which JAX reads everything from the scheduler's environment variables.
AUTO = "auto"


@dataclass(frozen=True)
class Sharing:
    """Which devices and processes share the tasks of a meta-batch.

    Random draws do not depend on it. Sums over tasks do, in their last digits, and training makes
    such differences grow.
    """

    devices: int | None = None
    """Number of devices of each process, which share the tasks of a meta-batch. On a CPU, devices
    are threads. None: one; but for a method whose inner update moves the policy's weights, the
    largest number up to that of the cores which divides the tasks, unless several processes train
    the run."""
    coordinator: str | None = None
    """Address of process 0 as HOST:PORT, if several processes train one run. auto: under Slurm and
    Open MPI, JAX finds the address, the number of processes and their indices by itself."""
    num_processes: int | None = None
    """Number of processes that train one run."""
    process: int | None = None
    """Index of this process, counted from 0. Process 0 writes and prints."""

    def __post_init__(self) -> None:
        given = self.num_processes, self.process
        if self.devices is not None and self.devices < 1:
            raise RunError(f"`devices` must be at least 1, got {self.devices}.")
        if self.coordinator in (None, AUTO):
            if given != (None, None):
                raise RunError(
                    "`num_processes` and `process` need a `coordinator`, the HOST:PORT at which "
                    "process 0 listens."
                )
        elif None in given:
            raise RunError("`coordinator` needs `num_processes` and `process` beside it.")
        if self.num_processes is not None and not 0 <= (self.process or 0) < self.num_processes:
            raise RunError(
                f"`process` must be from 0 to {self.num_processes - 1}, got {self.process}."
            )

    @contextlib.contextmanager
    def begun(self) -> Iterator[None]:
        """Let the devices share the tasks until the block ends.

        Raises:
            RunError: JAX has started with fewer devices, or the processes do not find each other.
        """
        number = self.devices or (num_cores() if self._is_open else 1)
        if number > 1:
            _request_cpu_devices(number)
        if self.coordinator is not None and not jax.distributed.is_initialized():
            self._connect(self.coordinator)
        given = self.devices or 1
        is_shared = given > 1 or self.coordinator is not None
        with sharing_tasks(_devices_of_each_process(given) if is_shared else []):
            yield

    @contextlib.contextmanager
    def of_tasks(self, tasks: int) -> Iterator[None]:
        """Let the largest number of cores that divides the tasks share them, if it was left open.

        Args:
            tasks: `AbstractMetaLearner.tasks_for_cores`.
        """
        found = jax.local_devices()
        if not self._is_open or found[0].platform != "cpu":
            yield
            return
        number = max(n for n in range(1, min(len(found), num_cores()) + 1) if tasks % n == 0)
        with sharing_tasks(found[:number]):
            yield

    @property
    def _is_open(self) -> bool:
        return self.devices is None and self.coordinator is None

    def _connect(self, coordinator: str) -> None:
        address = None if coordinator == AUTO else coordinator
        try:
            jax.distributed.initialize(
                address,
                self.num_processes,
                self.process,
                heartbeat_timeout_seconds=HEARTBEAT_TIMEOUT,
                shutdown_timeout_seconds=SHUTDOWN_TIMEOUT,
            )
        except (RuntimeError, ValueError) as error:
            raise RunError(
                f"the processes of this run cannot begin together: {error} Give `coordinator`, "
                "`num_processes` and `process` before anything else uses JAX."
            ) from error


ALONE = Sharing()


def num_cores() -> int:
    """Return the number of cores that this process may compute on."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    limit = os.environ.get("NPROC", "")  # XLA's own limit on its threads
    return max(1, min(found or 1, int(limit))) if limit.isdecimal() else found or 1


def _request_cpu_devices(number: int) -> None:
    # JAX refuses this once it has started. The devices that it has may still be enough.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", number)  # type: ignore[no-untyped-call]


def _devices_of_each_process(number: int) -> list[jax.Device]:
    found = jax.local_device_count()
    if found < number:
        raise RunError(
            f"`devices` is {number}, but JAX has begun with {found}: ask for them before anything "
            f"uses JAX, or set XLA_FLAGS=--xla_force_host_platform_device_count={number} (on CPUs)."
        )
    grouped = groupby(jax.devices(), key=lambda device: device.process_index)
    return [device for _, own in grouped for device in list(own)[:number]]


def is_lead() -> bool:
    """Whether this process writes and prints. One of those that share a run does."""
    return not jax.distributed.is_initialized() or jax.process_index() == 0


def wait_for_all(step: str) -> None:
    """Wait until all processes of the run have reached this step."""
    if jax.distributed.is_initialized():
        multihost_utils.sync_global_devices(step)


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Run a block in which the processes of the run wait for each other.

    Raises:
        RunError: another process is gone. JAX soon names it, and then ends this process too if it
            still runs.
    """
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if not jax.distributed.is_initialized():
            raise
        first = (str(error).splitlines() or [""])[0]
        raise RunError(
            f"process {jax.process_index()} of {jax.process_count()} has lost another process of "
            f"this run, whose own output says why ({first}). JAX names it below. `maesn resume` "
            "goes on from the last checkpoint."
        ) from error


def total_of_processes(number: int) -> int:
    """Return the sum of a number over the processes of the run."""
    if not jax.distributed.is_initialized():
        return number
    return int(multihost_utils.process_allgather(np.asarray(number)).sum())


def check_agreement(number: int, what: str) -> None:
    """Raise a `RunError` if the processes of the run do not all have the same number."""
    if not jax.distributed.is_initialized():
        return
    found = multihost_utils.process_allgather(np.asarray(number)).tolist()
    if len(set(found)) > 1:
        raise RunError(
            f"the processes of this run differ in {what} ({', '.join(map(str, found))}): give all "
            "of them the same settings, and a run directory that all of them see."
        )
