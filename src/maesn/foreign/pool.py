"""Processes that host environments, seen from the process that learns.

Gymnasium's own `AsyncVectorEnv` starts a process for every environment, steps environments that
have ended, and does not report which one raised or hangs. Here a process hosts a share of the
environments, so that hundreds of episodes are played by as many processes as there are CPUs.
"""

import contextlib
import importlib
import io
import json
import mmap
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, Pipe, wait
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8

from maesn.foreign import worker as program
from maesn.foreign.guard import Guard
from maesn.foreign.interface import Interface, derive
from maesn.foreign.worker import MARK, PROTOCOL, described, packed, unpacked

# What is read of every environment, one row each. All but the observation are single numbers.
Readings: TypeAlias = dict[str, Float[np.ndarray, "simulation ..."]]
_NUMBERS = ("reward", "terminated", "truncated", "solved")

PYTHON = "MAESN_PYTHON"
"""Variable with the interpreter of the environments, as `--python` sets it; this one without it."""

# Seconds that a new process may take until it calls its first environment: importing a user's
# module can take long on a busy machine.
START_LIMIT = 300.0
# Seconds in which a worker may close its environments before it is killed.
_GRACE = 2.0
_CHECKS_PER_LIMIT = 10
# Lines that an error shows of what an environment has written last.
_LAST_LINES = 20


class WorkerError(RuntimeError):
    """An environment failed, hangs, or took its process down.

    Attributes:
        simulation: index of the environment among the arguments of `begin`.
        reason: what went wrong.

    A note holds the traceback of the environment's code, or what its process has written last.
    """

    def __init__(self, simulation: int, reason: str, last_words: str = "") -> None:
        super().__init__(f"simulation {simulation}: {reason}")
        if last_words:
            self.add_note(f"In the process of the environment:\n{last_words.rstrip()}")
        self.simulation = simulation
        self.reason = reason


class WorkerPool:
    """Worker processes, each of which hosts every n-th environment.

    Tasks are those of `pack_task`. Every request raises a `WorkerError` if an environment cannot be
    used; the pool must then be closed.

    Args:
        make_env: the user's function of a task and the kind of reward, or its `module:name`.
            Functions that a worker cannot import (those of a script, and lambdas) are sent by
            value.
        reward: "dense" or "sparse".
        spaces: those that every task must have; None for the first one's.
        num_workers: largest number of processes; they start when there are simulations for them.
        time_limit: seconds that one call of one environment may take.

    Raises:
        WorkerError: `make_env` cannot be sent to a process.
    """

    def __init__(
        self,
        make_env: Any,
        reward: str,
        spaces: dict[str, Any] | None,
        num_workers: int,
        time_limit: float,
    ) -> None:
        self._num_workers = num_workers
        self._time_limit = time_limit
        self._python = os.environ.get(PYTHON) or None
        self._recipe = _recipe(make_env, (reward, spaces), self._python)
        self._workers: list[_Worker] = []
        self._guard: Guard | None = None

    @property
    def process_ids(self) -> list[int]:
        """Process ids of the workers that have been started."""
        return [worker.process.pid for worker in self._workers]

    def describe(self, task: bytes) -> Interface:
        """Return the interface of the environment of a task.

        Raises:
            InterfaceError: its spaces are not supported.
        """

        def arrivals(controls: np.ndarray) -> tuple[list[np.ndarray], list[float]]:
            found, clocks = self._first("probe", task, packed(controls))
            return list(map(unpacked, found)), clocks

        return derive(self._first("facts", task), arrivals)

    def complaint(self, task: bytes) -> str | None:
        """Return the complaint of Gymnasium's own check about a task's environment, if any."""
        answer: str | None = self._first("complaint", task)
        return answer

    def renders(self, task: bytes) -> bool:
        """Return whether the environment of a task draws itself."""
        answer: bool = self._first("renders", task)
        return answer

    def begin(self, tasks: Sequence[bytes], seeds: Sequence[int]) -> Readings:
        """Begin an episode in every simulation.

        Args:
            tasks: one for each simulation.
            seeds: one for each episode.
        """
        return self._read("begin", len(tasks), tasks, seeds)

    def step(self, controls: Float[np.ndarray, "simulation control"]) -> Readings:
        """Advance every simulation whose episode has not ended."""
        return self._read("step", len(controls), controls)

    def pictures(
        self, num_simulations: int, library: str | None = None
    ) -> list[UInt8[np.ndarray, "height width 3"]]:
        """Return the pictures that the first simulations draw of their present states.

        Args:
            num_simulations: number of the first ones; at most as many as have begun.
            library: what MuJoCo draws with, unless the variable MUJOCO_GL says so.
        """
        pictures: list[Any] = [None] * num_simulations
        for share, drawn in self._ask("picture", num_simulations, [library] * num_simulations):
            pictures[share] = map(unpacked, drawn)
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

    def _first(self, request: str, *arguments: Any) -> Any:
        """Return the first worker's answer about its first environment."""
        ((_, (answer,)),) = self._ask(request, 1, *([argument] for argument in arguments))
        return answer

    def _read(self, request: str, num_simulations: int, *columns: Any) -> Readings:
        rows = np.zeros((0, 0), np.float32)
        for share, answer in self._ask(request, num_simulations, *columns):
            part = unpacked(answer)
            if not rows.size:
                rows = np.empty((num_simulations, part.shape[1]), np.float32)
            rows[share] = part
        _refuse_infinite(rows)
        *numbers, observation = (rows[:, -4], rows[:, -3], rows[:, -2], rows[:, -1], rows[:, :-4])
        return {"observation": observation, **dict(zip(_NUMBERS, numbers, strict=True))}

    def _ask(
        self, request: str, num_simulations: int, *columns: Any
    ) -> Iterator[tuple[slice, Any]]:
        """Yield the simulations of each worker and its answer, in the order of arrival."""
        workers = self._workers_for(num_simulations)
        stride = len(workers)
        for first, worker in enumerate(workers):
            worker.send(request, [column[first::stride] for column in columns])
        pending = {worker.connection: (first, worker) for first, worker in enumerate(workers)}
        watch = _Watch(self._time_limit)
        while pending:
            ready = wait(list(pending), self._time_limit / _CHECKS_PER_LIMIT)
            for connection in ready:
                assert isinstance(connection, Connection)
                first, worker = pending.pop(connection)
                yield slice(first, None, stride), worker.answer(first, stride)
            for first, worker in pending.values():
                watch.look(worker, first, stride)

    def _workers_for(self, num_simulations: int) -> "list[_Worker]":
        """Return the workers for this number of simulations; start those that are missing."""
        number = min(self._num_workers, num_simulations)
        self._guard = self._guard or Guard()
        while len(self._workers) < number:
            self._workers.append(_Worker(self._recipe, self._python))
            self._guard.watch(self._workers[-1].process.pid)
        return self._workers[:number]


class _Worker:
    """One process and the connection to it."""

    def __init__(self, recipe: bytes, python: str | None) -> None:
        with contextlib.ExitStack() as stack:
            self.connection, theirs = Pipe()
            stack.callback(theirs.close)
            shared = stack.enter_context(tempfile.TemporaryFile())
            shared.truncate(MARK.size)
            self._mark = mmap.mmap(shared.fileno(), MARK.size)
            descriptors = (theirs.fileno(), shared.fileno())
            # With this interpreter's module path, a worker can import all that the parent can.
            path = json.dumps(None if python else sys.path)
            arguments = [str(Path(program.__file__)), str(PROTOCOL), *map(str, descriptors), path]
            self.process = subprocess.Popen(
                [python or sys.executable, *arguments],
                pass_fds=descriptors,
                # A user's module may import JAX, which must leave the accelerator to the parent.
                env=os.environ | {"JAX_PLATFORMS": "cpu"},
                stdin=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                # A session of its own: Ctrl-C is the parent's to handle.
                start_new_session=True,
            )
        self._written: deque[bytes] = deque(maxlen=_LAST_LINES)
        self._relay = threading.Thread(target=self._pass_on, daemon=True)
        self._relay.start()
        with contextlib.suppress(OSError):  # a missing answer will tell that it is gone
            self.connection.send_bytes(recipe)

    def send(self, request: str, columns: list[Any]) -> None:
        """Send a request; a missing answer will tell that the worker is gone."""
        arrays = [packed(x) if isinstance(x, np.ndarray) else x for x in columns]
        with contextlib.suppress(OSError):
            self.connection.send((request, arrays))

    def answer(self, first: int, stride: int) -> Any:
        """Wait for an answer; raise `WorkerError` if there is none, or a failure."""
        try:
            answer, failure = self.connection.recv()
        except (EOFError, OSError) as error:
            calls, environment = self.mark()
            code = self.process.wait()
            who = "the environment has ended its process"
            if not calls:
                who = "the process of the environment ended before it could make one"
            raise WorkerError(
                first + stride * environment, f"{who} (exit code {code})", self.last_lines()
            ) from error
        if failure is not None:
            environment, reason, trace = failure
            raise WorkerError(first + stride * environment, reason, trace)
        return answer

    def last_lines(self) -> str:
        """Return what the process has written last to its standard error."""
        self._relay.join(_GRACE / 4)
        return b"".join(self._written).decode(errors="replace")

    def _pass_on(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            for line in iter(lambda: lines.readline(1000), b""):
                self._written.append(line)
                with contextlib.suppress(ValueError, OSError):  # there is nobody to read it
                    sys.stderr.write(line.decode(errors="replace"))

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
                worker.last_lines(),
            )
        elif not calls and now - since > self._start_limit:
            raise WorkerError(
                first,
                "the process of the environment has imported what `make_env` needs for more than "
                f"{self._start_limit:g} s, and has not called it yet",
                worker.last_lines(),
            )


def pack_task(task: Any) -> bytes:
    """Return a task such that workers with any version of Python and NumPy can unpickle it."""
    content = io.BytesIO()
    pickler = pickle.Pickler(content, protocol=4)
    pickler.dispatch_table = {np.ndarray: _plain}
    pickler.dump(task)
    return content.getvalue()


def _plain(array: np.ndarray) -> tuple[Any, ...]:
    return np.ndarray, (array.shape, array.dtype.str, bytearray(array.tobytes()))


def _recipe(make_env: Any, others: tuple[Any, ...], python: str | None) -> bytes:
    """Return the pickled arguments of `maesn.foreign.worker.HostedEnvironment`."""
    if isinstance(make_env, str):
        return pickle.dumps((make_env, *others), protocol=4)
    if python:
        raise WorkerError(
            0,
            f"another interpreter, {python}, cannot be sent a function: `make_env` must be its "
            '"module:name", of a module that can be imported there',
        )
    try:
        # An extra of the installation.
        return bytes(importlib.import_module("cloudpickle").dumps((make_env, *others)))
    except Exception as error:  # the objects in a user's closure can raise anything
        raise WorkerError(
            0, f"`make_env` cannot be sent to a process: {described(error)}"
        ) from error


def _refuse_infinite(rows: Float[np.ndarray, "simulation component"]) -> None:
    """Raise an error about a number that is not finite in single precision."""
    sound = np.isfinite(rows)
    if sound.all():
        return
    simulation, index = (int(one) for one in np.argwhere(~sound)[0])
    value = rows[simulation, index]
    size = rows.shape[1] - len(_NUMBERS)
    what = f"the reward is not finite: {value}"
    if index < size:
        what = f"the observation is not finite: component {index} is {value}"
    raise WorkerError(simulation, what)
