"""A small process that kills workers and their children when the parent is gone.

`PR_SET_PDEATHSIG` of Linux would not reach the processes that environments start.
"""

import contextlib
import os
import subprocess
import sys

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
        theirs, self._input = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _PROGRAM],
            stdin=theirs,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that Ctrl-C does not end it
        )
        os.close(theirs)

    def watch(self, group: int) -> None:
        """Add a process group to those that will be killed."""
        with contextlib.suppress(OSError):  # somebody has killed the guard; workers run without it
            os.write(self._input, b"%d\n" % group)

    def close(self) -> None:
        """End the guard, and spare the process groups."""
        self._process.kill()
        self._process.wait()
        os.close(self._input)
