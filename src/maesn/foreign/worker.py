"""The program of a worker process: hosts a share of the environments and steps them in turn.

It is started by `maesn.foreign.pool`, and ends when its connection does. If an environment hangs
then, `maesn.foreign.guard` ends it.
"""

import contextlib
import mmap
import pickle
import signal
import struct
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from maesn.foreign.errors import calls_of, described, raised, shortened
from maesn.foreign.hosted import HostedEnvironment, HostedError, Reading

# What a worker writes before each call of an environment: how many calls so far, and whose.
MARK = struct.Struct("=Qq")


class Failure(NamedTuple):
    """What a worker answers if one of its environments cannot go on."""

    environment: int
    """Which one, among those of the worker."""
    reason: str
    calls: str
    """Those of its code in which it has raised an exception; empty if it has not."""


def main(connection_descriptor: int, mark_descriptor: int) -> None:
    """Serve the parent process until it closes the connection.

    Args:
        connection_descriptor: of a socket to the parent, which sends first the recipe and then
            requests.
        mark_descriptor: of a file that both processes map.
    """
    # Schedulers signal all processes of a job; the parent then saves, and ends this one. A handler
    # that does nothing, because what is ignored would be ignored by environments' processes too.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    connection = Connection(connection_descriptor)
    with mmap.mmap(mark_descriptor, MARK.size) as mark, contextlib.suppress(EOFError, OSError):
        _serve(connection, mark)


def _serve(connection: Connection, mark: mmap.mmap) -> None:
    share = _load_share(connection, mark)
    if share is None:
        return
    try:
        while True:
            request, *columns = connection.recv()
            connection.send(share.answer(request, columns))
    finally:
        share.close()


def _load_share(connection: Connection, mark: mmap.mmap) -> "_Share | None":
    recipe = connection.recv_bytes()
    try:
        return _Share(pickle.loads(recipe), mark)
    except Exception as error:  # noqa: BLE001  # the import of a user's module can raise anything
        reason = f"`make_env` cannot be loaded: {described(error)}"
        connection.send(Failure(0, reason, calls_of(error)))
        return None


class _Share:
    """The environments of one worker."""

    def __init__(self, recipe: tuple[Any, ...], mark: mmap.mmap) -> None:
        self._recipe = recipe
        self._mark = mark
        self._calls = 0
        self._environments: list[HostedEnvironment] = []

    def answer(self, request: str, columns: list[Sequence[Any]]) -> Any:
        """Ask one environment after the other.

        Args:
            request: the method of `HostedEnvironment` that is called.
            columns: for each of its arguments, one value for each environment.

        Returns:
            What they return, readings as one array for each field; or the `Failure` of the first
            one that cannot go on.
        """
        answers = []
        for index, arguments in enumerate(zip(*columns, strict=True)):
            self._calls += 1
            MARK.pack_into(self._mark, 0, self._calls, index)
            if index == len(self._environments):
                self._environments.append(HostedEnvironment(*self._recipe))
            try:
                answers.append(getattr(self._environments[index], request)(*arguments))
            except HostedError as error:
                return Failure(index, shortened(str(error)), calls_of(error.__cause__))
            except Exception as error:  # noqa: BLE001  # of a user's code, wherever it is called
                return Failure(index, f"the environment {raised(error)}", calls_of(error))
        return _by_field(answers) if request in ("begin", "step") else answers

    def close(self) -> None:
        """Close all environments, whatever each of them does about it."""
        for environment in self._environments:
            with contextlib.suppress(Exception):
                environment.close()


def _by_field(readings: list[Reading]) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(column, np.float32) for column in zip(*readings, strict=True))
