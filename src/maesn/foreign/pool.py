"""Processes that host environments, seen from the process that learns.

Gymnasium's own `AsyncVectorEnv` starts a process for every environment, steps environments that
have ended, and does not report which one raised or hangs. Here a process hosts a share of the
environments, so that hundreds of episodes are played by as many processes as there are CPUs.
"""

import contextlib
import json
import mmap
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any, TypeAlias

import cloudpickle
import numpy as np
from jaxtyping import Float, UInt8

from maesn.foreign.errors import described
from maesn.foreign.guard import Guard
from maesn.foreign.hosted import Reading
from maesn.foreign.interface import Interface
from maesn.foreign.worker import MARK, Failure

# The fields of `maesn.foreign.hosted.Reading`, with a row for each environment.
Readings: TypeAlias = dict[str, Float[np.ndarray, "simulation ..."]]

# Seconds that a new process may take until it calls its first environment: importing a user's
# module can take long on a busy machine.
START_LIMIT = 300.0
# Seconds in which a worker may close its environments before it is killed.
_GRACE = 2.0
_CHECKS_PER_LIMIT = 10

# With the parent's module path, so that the worker can import all that the parent can.
_PROGRAM = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from maesn.foreign.worker import main; main(*map(int, sys.argv[2:]))"
)


class WorkerError(RuntimeError):
    """An environment failed, hangs, or took its process down.

    Attributes:
        simulation: index of the environment among the arguments of `begin`.
        reason: what went wrong.

    If the environment has raised an exception, a note holds the traceback of its code.
    """

    def __init__(self, simulation: int, reason: str, traceback: str = "") -> None:
        super().__init__(f"simulation {simulation}: {reason}")
        if traceback:
            self.add_note(f"In the process of the environment:\n{traceback.rstrip()}")
        self.simulation = simulation
        self.reason = reason


class WorkerPool:
    """Worker processes, each of which hosts every n-th environment.

    Tasks are pickled. Every request raises a `WorkerError` if an environment cannot be used; the
    pool must then be closed.

    Args:
        recipe: arguments of `maesn.foreign.hosted.HostedEnvironment`. Functions that a worker
            cannot import (those of a script, and lambdas) are sent by value.
        num_workers: largest number of processes; they start when there are simulations for them.
        time_limit: seconds that one call of one environment may take.

    Raises:
        WorkerError: the recipe cannot be sent to a process.
    """

    def __init__(self, recipe: tuple[Any, ...], num_workers: int, time_limit: float) -> None:
        self._num_workers = num_workers
        self._time_limit = time_limit
        self._content = _content(recipe)
        self._workers: list[_Worker] = []
        self._guard: Guard | None = None

    @property
    def process_ids(self) -> list[int]:
        """Process ids of the workers that have been started."""
        return [worker.process.pid for worker in self._workers]

    def describe(self, task: bytes) -> Interface:
        """Return the interface of the environment of a task."""
        answer: Interface = self._ask_about(task, "describe")
        return answer

    def complaint(self, task: bytes) -> str | None:
        """Return the complaint of Gymnasium's own check about a task's environment, if any."""
        answer: str | None = self._ask_about(task, "complaint")
        return answer

    def begin(self, tasks: Sequence[bytes], seeds: Sequence[int]) -> Readings:
        """Begin an episode in every simulation.

        Args:
            tasks: one for each simulation, pickled.
            seeds: one for each episode.
        """
        return self._read("begin", len(tasks), tasks, seeds)

    def step(self, controls: Float[np.ndarray, "simulation control"]) -> Readings:
        """Advance every simulation whose episode has not ended."""
        return self._read("step", len(controls), controls)

    def renders(self, task: bytes) -> bool:
        """Return whether the environment of a task draws itself."""
        answer: bool = self._ask_about(task, "renders")
        return answer

    def pictures(
        self, num_simulations: int, size: tuple[int, int]
    ) -> list[UInt8[np.ndarray, "height width 3"]]:
        """Return the pictures that the first simulations draw of their present states.

        Args:
            num_simulations: number of the first ones; at most as many as have begun.
            size: width and height of the pictures, in pixels.
        """
        pictures: list[Any] = [None] * num_simulations
        for share, drawn in self._ask("picture", num_simulations, [size] * num_simulations):
            pictures[share] = drawn
        return pictures

    def close(self) -> None:
        """Stop all workers, and all processes that their environments have started."""
        workers, self._workers = self._workers, []
        for worker in workers:
            worker.connection.close()
        deadline = time.monotonic() + _GRACE
        for worker in workers:
            worker.stop(deadline)
        if self._guard is not None:
            self._guard.close()
            self._guard = None

    def _ask_about(self, task: bytes, request: str) -> Any:
        """Return the first worker's answer about a task."""
        ((_, (answer,)),) = self._ask(request, 1, [task])
        return answer

    def _read(self, request: str, num_simulations: int, *columns: Any) -> Readings:
        readings: Readings = {}
        for share, values in self._ask(request, num_simulations, *columns):
            for name, value in zip(Reading._fields, values, strict=True):
                if name not in readings:
                    readings[name] = np.empty((num_simulations, *value.shape[1:]), np.float32)
                readings[name][share] = value
        return readings

    def _ask(
        self, request: str, num_simulations: int, *columns: Any
    ) -> Iterator[tuple[slice, Sequence[Any]]]:
        """Yield the simulations of each worker and its answer, in the order of arrival."""
        workers = self._workers_for(num_simulations)
        stride = len(workers)
        for first, worker in enumerate(workers):
            # A missing answer will tell that a worker is gone.
            with contextlib.suppress(OSError):
                worker.connection.send((request, *(column[first::stride] for column in columns)))
        pending = {worker.connection: (first, worker) for first, worker in enumerate(workers)}
        watch = _Watch(self._time_limit)
        while pending:
            ready = wait(list(pending), self._time_limit / _CHECKS_PER_LIMIT)
            for connection in ready:
                assert isinstance(connection, Connection)
                first, worker = pending.pop(connection)
                yield slice(first, None, stride), _answer(worker, first, stride)
            for first, worker in pending.values():
                watch.look(worker, first, stride)

    def _workers_for(self, num_simulations: int) -> "list[_Worker]":
        """Return the workers for this number of simulations; start those that are missing."""
        number = min(self._num_workers, num_simulations)
        self._guard = self._guard or Guard()
        while len(self._workers) < number:
            self._workers.append(_Worker(self._content))
            self._guard.watch(self._workers[-1].process.pid)
        return self._workers[:number]


class _Worker:
    """One process and the connection to it."""

    def __init__(self, recipe: bytes) -> None:
        with contextlib.ExitStack() as stack:
            self.connection, theirs = Pipe()
            stack.callback(theirs.close)
            shared = stack.enter_context(tempfile.TemporaryFile())
            shared.truncate(MARK.size)
            self._mark = mmap.mmap(shared.fileno(), MARK.size)
            descriptors = (theirs.fileno(), shared.fileno())
            numbers = map(str, descriptors)
            self.process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, json.dumps(sys.path), *numbers],
                pass_fds=descriptors,
                # A user's module may import JAX, which must leave the accelerator to the parent.
                env=os.environ | {"JAX_PLATFORMS": "cpu"},
                stdin=subprocess.DEVNULL,
                # A session of its own: Ctrl-C is the parent's to handle.
                start_new_session=True,
            )
        with contextlib.suppress(OSError):  # a missing answer will tell that it is gone
            self.connection.send_bytes(recipe)

    def mark(self) -> tuple[int, int]:
        """Return the number of calls so far, and the environment that was called last."""
        calls, environment = MARK.unpack_from(self._mark, 0)
        return calls, environment

    def stop(self, deadline: float) -> None:
        """Wait until the deadline for the process to end, then kill it and its children."""
        try:
            self.process.wait(max(deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            pass
        finally:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            self._mark.close()


class _Watch:
    """Detects workers whose environment hangs."""

    def __init__(self, time_limit: float) -> None:
        self._time_limit = time_limit
        self._start_limit = max(time_limit, START_LIMIT)
        self._seen: dict[int, tuple[int, float]] = {}

    def look(self, worker: _Worker, first: int, stride: int) -> None:
        """Raise `WorkerError` if the worker's mark has not changed within the limit."""
        calls, environment = worker.mark()
        now = time.monotonic()
        seen, since = self._seen.get(first, (-1, now))
        if calls != seen:
            self._seen[first] = (calls, now)
        elif calls and now - since > self._time_limit:
            raise WorkerError(
                first + stride * environment,
                f"the environment has not returned within `time_limit`, {self._time_limit:g} s",
            )
        elif not calls and now - since > self._start_limit:
            raise WorkerError(
                first,
                "the process of the environment has imported what `make_env` needs for more than "
                f"{self._start_limit:g} s, and has not called it yet",
            )


def _content(recipe: tuple[Any, ...]) -> bytes:
    try:
        return cloudpickle.dumps(recipe)
    except Exception as error:  # the objects in a user's closure can raise anything
        raise WorkerError(
            0, f"`make_env` cannot be sent to a process: {described(error)}"
        ) from error


def _answer(worker: _Worker, first: int, stride: int) -> Sequence[Any]:
    try:
        answer = worker.connection.recv()
    except (EOFError, OSError) as error:
        code = worker.process.wait()
        raise WorkerError(
            first + stride * worker.mark()[1],
            f"the environment has ended its process (exit code {code})",
        ) from error
    if isinstance(answer, Failure):
        raise WorkerError(first + stride * answer.environment, answer.reason, answer.traceback)
    return answer
