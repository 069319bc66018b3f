"""Processes that die at any operation on files: copies of this one, so that they start warm."""

import gc
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from faults.table import Hang

OPERATIONS = {
    *("open", "write", "writelines", "flush", "close", "truncate", "ftruncate", "fsync"),
    *("fdatasync", "replace", "rename", "unlink", "remove", "mkdir", "rmdir", "flock"),
}
"""Functions and methods, written in C, that change files."""
_MODULES = {"posix", "_io", "fcntl"}


class Ended(NamedTuple):
    """How a process has ended."""

    status: int
    """Exit status; minus the signal that ended it."""
    said: str
    """All that it has written to its terminal."""


def at_operations(act: Callable[[int], None]) -> Callable[[Any, str, Any], None]:
    """Return a profiling function that acts before each operation on files, which it numbers."""
    count = 0

    def watch(_: Any, event: str, called: Any) -> None:
        nonlocal count
        if event == "c_call" and called.__name__ in OPERATIONS and _module(called) in _MODULES:
            count += 1
            act(count - 1)

    return watch


def _module(called: Any) -> str:
    return called.__module__ or type(called.__self__).__module__


def count_operations(work: Callable[[], Any], directory: Path) -> int:
    """Do the work in another process, and return how many operations it needs."""
    counts = directory / "count"

    def counted() -> None:
        numbers = []
        sys.setprofile(at_operations(numbers.append))
        work()
        sys.setprofile(None)
        counts.write_text(str(len(numbers)))

    ended = wait(fork(counted, directory / "counted"), directory / "counted")
    assert ended.status == 0, ended.said
    return int(counts.read_text())


def failing_at(
    work: Callable[[], Any], moment: int, reason: int | None = None
) -> Callable[[], Any]:
    """Return work whose n-th operation fails with an error of the operating system.

    Without a reason the process does not survive it: SIGKILL.
    """

    def act(number: int) -> None:
        if number == moment and reason is not None:
            raise OSError(reason, os.strerror(reason))
        if number == moment:
            os.kill(os.getpid(), signal.SIGKILL)

    def failing() -> None:
        sys.setprofile(at_operations(act))
        work()

    return failing


def on_a_full_disk(work: Callable[[], Any], size: int) -> Callable[[], Any]:
    """Return work in which no file can become larger; the write that tries is half done."""

    def failing() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        try:
            work()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)

    return failing


def killed_in_write(work: Callable[[], Any], size: int) -> Callable[[], Any]:
    """Return work that is killed in the middle of a write, as soon as a file has that size."""

    def dying() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        work()

    return dying


def fork(work: Callable[[], Any], output: Path) -> int:
    """Let a copy of this process do something; return its number.

    Threads do not come along, so it must not run large compiled programs. Its exit status is 1
    after an exception, whose traceback is in the output.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of JAX, about its threads
        process = os.fork()
    if process:
        return process
    gc.disable()  # it would touch, and so copy, all memory
    status = 1
    try:
        signal.setitimer(signal.ITIMER_REAL, 0)
        descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        sys.stdout = os.fdopen(1, "w", buffering=1, closefd=False)
        sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False)
        work()
        status = 0
    except SystemExit as left:
        status = left.code if isinstance(left.code, int) else 1
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
    finally:
        sys.setprofile(None)
        os._exit(status)


def wait(process: int, output: Path, limit: float = 60.0) -> Ended:
    """Wait until a process has ended; `Hang` if it does not."""
    deadline, found, status = time.monotonic() + limit, 0, 0
    try:
        while not found:
            found, status = os.waitpid(process, os.WNOHANG)
            if time.monotonic() > deadline:
                raise Hang
            time.sleep(0.002)
    finally:
        if not found:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
    said = output.read_text(errors="replace") if output.exists() else ""
    return Ended(os.waitstatus_to_exitcode(status), said)
