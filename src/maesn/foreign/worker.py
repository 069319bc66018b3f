"""The program of a worker process: hosts a share of the environments and steps them in turn.

It is started by `maesn.foreign.pool`, and ends when its connection does, however that comes about.
"""

import contextlib
import mmap
import pickle
import struct
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from maesn.foreign.hosted import HostedEnvironment, HostedError, Reading

# What a worker writes before each call of an environment: how many calls so far, and whose.
MARK = struct.Struct("=Qq")


def main(connection_descriptor: int, mark_descriptor: int) -> None:
    """Serve the parent process until it closes the connection.

    Args:
        connection_descriptor: of a socket to the parent, which sends first the recipe and then
            requests.
        mark_descriptor: of a file that both processes map.
    """
    connection = Connection(connection_descriptor)
    with mmap.mmap(mark_descriptor, MARK.size) as mark, contextlib.suppress(EOFError, OSError):
        share = _load_share(connection, mark)
        try:
            while share is not None:
                request, *arguments = connection.recv()
                connection.send(share.answer(request, arguments))
        finally:
            if share is not None:
                share.close()


def _load_share(connection: Connection, mark: mmap.mmap) -> "_Share | None":
    recipe = connection.recv_bytes()
    try:
        return _Share(pickle.loads(recipe), mark)
    except Exception as error:  # noqa: BLE001  # the import of a user's module can raise anything
        connection.send((0, f"`make_env` cannot be loaded: {type(error).__name__}: {error}"))
        return None


class _Share:
    """The environments of one worker."""

    def __init__(self, recipe: tuple[Any, ...], mark: mmap.mmap) -> None:
        self._recipe = recipe
        self._mark = mark
        self._calls = 0
        self._environments: list[HostedEnvironment] = []

    def answer(self, request: str, arguments: list[Any]) -> tuple[int, str] | tuple[Any, ...]:
        """Return the readings of all environments, or (index, reason) of the first that fails."""
        if request == "begin":
            while len(self._environments) < len(arguments[0]):
                self._environments.append(HostedEnvironment(*self._recipe))
        readings: list[Reading] = []
        for index, values in enumerate(zip(*arguments, strict=True)):
            self._calls += 1
            MARK.pack_into(self._mark, 0, self._calls, index)
            environment = self._environments[index]
            try:
                call = environment.begin if request == "begin" else environment.step
                readings.append(call(*values))
            except HostedError as error:
                return index, str(error)
        return tuple(np.asarray(column, np.float32) for column in zip(*readings, strict=True))

    def close(self) -> None:
        """Close all environments, whatever each of them does about it."""
        for environment in self._environments:
            with contextlib.suppress(Exception):
                environment.close()
