"""A small process that ends workers, and what they have started, when their parent is gone.

Linux can signal a process when its parent ends (`PR_SET_PDEATHSIG`), but that does not reach the
processes of its environments, and takes the end of the parent's thread for that of the parent.
"""

import contextlib
import subprocess
import sys
from typing import IO

# The end of the input is the end of the parent, however that came about. A second is for
# environments that can be closed.
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
            start_new_session=True,  # Ctrl-C is not for it
        )

    @property
    def _input(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    def watch(self, group: int) -> None:
        """End this process group as well."""
        with contextlib.suppress(OSError):  # killed by somebody: nothing else depends on it
            self._input.write(b"%d\n" % group)
            self._input.flush()

    def close(self) -> None:
        """Watch no longer."""
        self._process.kill()
        self._process.wait()
        with contextlib.suppress(OSError):
            self._input.close()
