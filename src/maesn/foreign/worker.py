"""The program of a worker process, which hosts a share of the environments and steps them in turn.

`maesn.foreign.pool` starts it. It ends when its connection is closed; if an environment hangs then,
`maesn.foreign.guard` kills it.
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

from maesn.foreign.errors import described, raised, shortened, user_traceback
from maesn.foreign.hosted import HostedEnvironment, HostedError, Reading

# Before each call of an environment, the worker writes the number of calls so far and the
# environment's index to shared memory. So the pool can tell which environment hangs.
MARK = struct.Struct("=Qq")


class Failure(NamedTuple):
    """A worker's answer if one of its environments cannot go on."""

    environment: int
    """Index of the environment within the worker."""
    reason: str
    traceback: str
    """Lines of the user's code in which an exception was raised; empty without one."""


def main(connection_descriptor: int, mark_descriptor: int) -> None:
    """Serve the parent process until it closes the connection.

    Args:
        connection_descriptor: file descriptor of a socket to the parent, which sends the recipe
            (arguments of `HostedEnvironment`) and then requests.
        mark_descriptor: file descriptor of the memory for `MARK`, which both processes map.
    """
    # Schedulers signal all processes of a job. The parent then saves, and ends this process. Hence
    # an empty handler, and not SIG_IGN, which the environments' own processes would inherit.
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
        connection.send(Failure(0, reason, user_traceback(error)))
        return None


class _Share:
    """The environments of one worker."""

    def __init__(self, recipe: tuple[Any, ...], mark: mmap.mmap) -> None:
        self._recipe = recipe
        self._mark = mark
        self._calls = 0
        self._environments: list[HostedEnvironment] = []

    def answer(self, request: str, columns: list[Sequence[Any]]) -> Any:
        """Call a method of one environment after the other.

        Args:
            request: name of the method of `HostedEnvironment`.
            columns: for each argument of the method, one value per environment.

        Returns:
            The results, readings as one array per field; or the `Failure` of the first environment
            that cannot go on.
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
                return Failure(index, shortened(str(error)), user_traceback(error.__cause__))
            except Exception as error:  # noqa: BLE001  # of a user's code, wherever it is called
                return Failure(index, f"the environment {raised(error)}", user_traceback(error))
        return _stack_fields(answers) if request in ("begin", "step") else answers

    def close(self) -> None:
        """Close all environments, and ignore their errors."""
        for environment in self._environments:
            with contextlib.suppress(Exception):
                environment.close()


def _stack_fields(readings: list[Reading]) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(column, np.float32) for column in zip(*readings, strict=True))
