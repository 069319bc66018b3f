"""Memory that a command and all its processes take together.

    python benchmarks/memory.py                     # of `make test`
    python benchmarks/memory.py maesn train maesn   # of any command

Twice a second, the proportional set sizes (PSS) of all processes are added up. Unlike resident
sizes, they count a page that several processes share only once.
"""

import ctypes
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

SECONDS = 0.5
"""Between two samples."""
PR_SET_CHILD_SUBREAPER = 36
WORKER = "sys.stdin.readline()"
"""What the command line of pytest's workers contains, and of nothing else."""


@dataclass(frozen=True)
class Sample:
    """What the processes take at one moment."""

    total: int
    """Bytes of all processes."""
    largest: int
    """Bytes of the largest one."""
    processes: int
    """Number of processes."""
    workers: int
    """Number of pytest's workers among them."""


def descendants(root: int) -> dict[int, int]:
    """Return the processes below a process, and the parent of each."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                # The name of the program, in parentheses, may itself contain some.
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:  # it has ended
                continue
            children.setdefault(parent, []).append(int(entry.name))
    found, new = {}, [(child, root) for child in children.get(root, [])]
    while new:
        found.update(new)
        new = [(child, parent) for parent, _ in new for child in children.get(parent, [])]
    return found


def proportional_size(process: int) -> int:
    """Return the bytes of a process; 0 if it has ended."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def is_worker(process: int) -> bool:
    """Return whether a process is one of pytest's workers."""
    try:
        return WORKER in Path(f"/proc/{process}/cmdline").read_text()
    except OSError:
        return False


def sample() -> Sample:
    """Measure all processes below this one."""
    processes = descendants(os.getpid())
    sizes = [proportional_size(process) for process in processes]
    # What a worker forks has its command line.
    workers = sum(is_worker(one) and not is_worker(two) for one, two in processes.items())
    return Sample(sum(sizes), max(sizes, default=0), len(processes), workers)


def measure(command: list[str]) -> tuple[list[Sample], int, float]:
    """Run a command; return samples, its exit status, and the seconds that it took."""
    # Processes whose parent ends become children of this one, and are still counted.
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    begin, samples = time.monotonic(), []
    with subprocess.Popen(command) as process:
        while process.poll() is None:
            samples.append(sample())
            time.sleep(SECONDS)
    return samples, process.returncode, time.monotonic() - begin


def main() -> int:
    """Run the command, print its memory, and end as it ends."""
    samples, status, seconds = measure(sys.argv[1:] or ["make", "test"])
    peak = max(samples, key=lambda one: one.total)
    print(f"peak memory (PSS): {peak.total / 1e9:.2f} GB in {peak.processes} processes")
    print(f"largest process:   {max(one.largest for one in samples) / 1e9:.2f} GB")
    print(f"pytest's workers:  {max(one.workers for one in samples)}")
    print(f"seconds:           {seconds:.0f}")
    return status


if __name__ == "__main__":
    sys.exit(main())
