"""One process that hosts environments, seen from the process that learns."""

import contextlib
import json
import mmap
import os
import signal
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from collections import deque
from multiprocessing.connection import Pipe
from pathlib import Path
from typing import Any

import numpy as np

from maesn.foreign import worker as program
from maesn.foreign.worker import MARK, PROTOCOL, packed

# Seconds that a new process may take until it calls its first environment: importing a user's
# module can take long on a busy machine.
START_LIMIT = 300.0
# Seconds in which a worker may close its environments before it is killed.
GRACE = 2.0
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


class Worker:
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
            self._python = python or sys.executable
            self.process = _started([self._python, *arguments], descriptors)
        self._seen, self._since = -1, time.monotonic()
        self._written: deque[bytes] = deque(maxlen=_LAST_LINES)
        self._relay = threading.Thread(target=self._pass_on, daemon=True)
        self._relay.start()
        with contextlib.suppress(OSError):  # a missing answer will tell that it is gone
            self.connection.send_bytes(recipe)

    def send(self, request: str, columns: list[Any]) -> None:
        """Send a request; a missing answer will tell that the worker is gone."""
        self._seen, self._since = -1, time.monotonic()
        arrays = [packed(x) if isinstance(x, np.ndarray) else x for x in columns]
        with contextlib.suppress(OSError):
            self.connection.send((request, arrays))

    def answer(self, first: int, stride: int) -> Any:
        """Wait for an answer; raise `WorkerError` if there is none, or a failure."""
        try:
            answer, failure = self.connection.recv()
        except (EOFError, OSError) as error:
            raise self._ended(first, stride) from error
        if failure is not None:
            environment, reason, trace = failure
            raise WorkerError(first + stride * environment, reason, trace)
        return answer

    def _ended(self, first: int, stride: int) -> WorkerError:
        (calls, environment), code = self._calls(), self.process.wait()
        lines = self._last_lines()
        if calls:
            reason = f"the environment has ended its process (exit code {code})"
            return WorkerError(first + stride * environment, reason, lines)
        said = f": {lines.splitlines()[-1]}" if lines else ""
        who = f"`{self._python}` ended before it could make an environment"
        return WorkerError(first, f"{who} (exit code {code}){said}")

    def _last_lines(self) -> str:
        """Return what the process has written last to its standard error."""
        self._relay.join(GRACE / 4)
        return b"".join(self._written).decode(errors="replace")

    def _pass_on(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            for line in iter(lambda: lines.readline(1000), b""):
                self._written.append(line)
                with contextlib.suppress(ValueError, OSError):  # there is nobody to read it
                    sys.stderr.write(line.decode(errors="replace"))

    def look(self, first: int, stride: int, time_limit: float) -> None:
        """Raise `WorkerError` if an environment has not returned within the limit in seconds."""
        calls, environment = self._calls()
        if calls != self._seen:
            self._seen, self._since = calls, time.monotonic()
        limit = time_limit if calls else max(time_limit, START_LIMIT)
        if time.monotonic() - self._since <= limit:
            return
        reason = f"the environment has not returned within `time_limit`, {limit:g} s"
        if not calls:
            reason = (
                "the process of the environment has imported what `make_env` needs for more than "
                f"{limit:g} s, and has not called it yet"
            )
        raise WorkerError(first + stride * environment, reason, self._last_lines())

    def _calls(self) -> tuple[int, int]:
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


def _variables() -> dict[str, str]:
    """Return the environment variables of a worker.

    Another interpreter must not find this one's packages, which a module path may name.
    """
    own = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
    given = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    kept = [x for x in given if not any(Path(x).is_relative_to(place) for place in own)]
    # A user's module may import JAX, which must leave the accelerator to the parent.
    return os.environ | {"JAX_PLATFORMS": "cpu", "PYTHONPATH": os.pathsep.join(kept)}


def _started(command: list[str], descriptors: tuple[int, ...]) -> "subprocess.Popen[bytes]":
    """Start a worker; a `WorkerError` if its interpreter is no program."""
    try:
        return subprocess.Popen(
            command,
            pass_fds=descriptors,
            env=_variables(),
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            # A session of its own: Ctrl-C is the parent's to handle.
            start_new_session=True,
        )
    except OSError as error:
        raise WorkerError(0, f"`{command[0]}` cannot be started: {error.strerror}") from error
