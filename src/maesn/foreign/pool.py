"""Processes that host environments, seen from the process that learns.

Gymnasium's own `AsyncVectorEnv` starts a process for every environment, steps environments that
have ended, and does not report which one raised or hangs. Here a process hosts a share of the
environments, so that hundreds of episodes are played by as many processes as there are CPUs.
"""

import contextlib
import importlib
import io
import os
import pickle
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8

from maesn.foreign.guard import Guard
from maesn.foreign.interface import Interface, derive
from maesn.foreign.process import GRACE, Worker, WorkerError
from maesn.foreign.worker import described, unpacked
from maesn.storage import RunError

# What is read of every environment, one row each. All but the observation are single numbers.
Readings: TypeAlias = dict[str, Float[np.ndarray, "simulation ..."]]
_NUMBERS = ("reward", "terminated", "truncated", "solved")

# Variable with the interpreter of the environments. Processes that this one starts inherit it.
PYTHON = "MAESN_PYTHON"

_CHECKS_PER_LIMIT = 10


class WorkerPool:
    """Worker processes, each of which hosts every n-th environment.

    Tasks are those of `pack_task`. Every request raises a `WorkerError` if an environment cannot be
    used, or if `make_env` cannot be sent; the pool must then be closed.

    Args:
        make_env: as for `gymnasium_family`. Functions that a worker cannot import (those of a
            script, and lambdas) are sent by value.
        reward: "dense" or "sparse".
        spaces: those that every task must have; None for the first one's.
        num_workers: largest number of processes; they start when there are simulations for them.
        time_limit: seconds that one call of one environment may take.
        python: path of the interpreter, unless `hosted_in` names another; empty, or where there is
            none: this one.
    """

    def __init__(
        self,
        make_env: Any,
        reward: str,
        spaces: dict[str, Any] | None,
        num_workers: int,
        time_limit: float,
        python: str = "",
    ) -> None:
        self._num_workers = num_workers
        self._time_limit = time_limit
        usual = str(Path(python).absolute()) if Path(python).is_file() else None
        self._python = os.environ.get(PYTHON, usual)
        self._recipe = _recipe(make_env, (reward, spaces), self._python)
        self._workers: list[Worker] = []
        self._guard: Guard | None = None

    @property
    def process_ids(self) -> list[int]:
        """Process ids of the workers that have been started."""
        return [worker.process.pid for worker in self._workers]

    def describe(self, task: bytes) -> Interface:
        """Return the interface of the environment of a task, or raise InterfaceError."""
        return derive(self._first("facts", task))

    def renders(self, task: bytes) -> bool:
        """Return whether the environment of a task draws itself."""
        return bool(self._first("renders", task))

    def begin(self, tasks: Sequence[bytes], seeds: Sequence[int]) -> Readings:
        """Begin an episode in every simulation, each with its task and its seed."""
        return self._read("begin", len(tasks), tasks, seeds)

    def step(self, controls: Float[np.ndarray, "simulation control"]) -> Readings:
        """Advance every simulation whose episode has not ended."""
        return self._read("step", len(controls), controls)

    def pictures(
        self, num_simulations: int, library: str | None = None
    ) -> list[UInt8[np.ndarray, "height width 3"]]:
        """Return the pictures that the first simulations draw of their present states.

        MuJoCo draws with that library, unless the variable MUJOCO_GL says so.
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
        deadline = time.monotonic() + GRACE
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
        observation, numbers = np.split(rows, [-len(_NUMBERS)], axis=1)
        return {"observation": observation, **dict(zip(_NUMBERS, numbers.T, strict=True))}

    def _ask(
        self, request: str, num_simulations: int, *columns: Any
    ) -> Iterator[tuple[slice, Any]]:
        """Yield the simulations of each worker and its answer, in the order of arrival."""
        workers = self._workers_for(num_simulations)
        stride = len(workers)
        for first, worker in enumerate(workers):
            worker.send(request, [column[first::stride] for column in columns])
        pending = {worker.connection: (first, worker) for first, worker in enumerate(workers)}
        while pending:
            ready = wait(list(pending), self._time_limit / _CHECKS_PER_LIMIT)
            for connection in ready:
                assert isinstance(connection, Connection)
                first, worker = pending.pop(connection)
                yield slice(first, None, stride), worker.answer(first, stride)
            for first, worker in pending.values():
                worker.look(first, stride, self._time_limit)

    def _workers_for(self, num_simulations: int) -> "list[Worker]":
        """Return the workers for this number of simulations; start those that are missing."""
        number = min(self._num_workers, num_simulations)
        self._guard = self._guard or Guard()
        while len(self._workers) < number:
            self._workers.append(Worker(self._recipe, self._python))
            self._guard.watch(self._workers[-1].process.pid)
        return self._workers[:number]


@contextlib.contextmanager
def hosted_in(python: str | os.PathLike[str]) -> Iterator[None]:
    """Let workers that start in this block run in another interpreter, Python 3.10 or later.

    It needs NumPy and what the environments import. Nothing of this library is installed there, and
    no run records where it is. RunError says that the path is none of a program.
    """
    if not os.access(python, os.X_OK) or Path(python).is_dir():
        raise RunError(
            "`--python` must be the path of an interpreter, such as .venv/bin/python, got "
            f"`{os.fspath(python)}`."
        )
    before = os.environ.get(PYTHON)
    os.environ[PYTHON] = str(Path(python).absolute())  # unresolved: a venv's is a link
    try:
        yield
    finally:
        del os.environ[PYTHON]
        if before is not None:
            os.environ[PYTHON] = before


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
