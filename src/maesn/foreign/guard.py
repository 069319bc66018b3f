"""A small process that kills workers and their children when the parent is gone.

Linux can signal a process when its parent ends (`PR_SET_PDEATHSIG`). But that does not reach the
processes that environments start, and it also happens when the thread ends that started the worker.
"""

import contextlib
import subprocess
import sys
from typing import IO

# The input ends when the parent does, however that ends. The workers get a second to close their
# environments.
_PROGRAM = """
import os, signal, sys, time
for number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
groups = [int(line) for line in sys.stdin]
time.sleep(1.0)
for group in groups:
    try:
        os.killpg(group, signal.SIGKILL)
    except OSError:
        pass
"""


class Guard:
    """Ends process groups when this process ends, also if it is killed while they hang."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that Ctrl-C does not end it
        )

    @property
    def _input(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    def watch(self, group: int) -> None:
        """Add a process group to those that will be killed."""
        with contextlib.suppress(OSError):  # somebody has killed the guard; workers run without it
            self._input.write(b"%d\n" % group)
            self._input.flush()

    def close(self) -> None:
        """End the guard, and spare the process groups."""
        self._process.kill()
        self._process.wait()
        with contextlib.suppress(OSError):
            self._input.close()
