"""`python -m faults.soak`: train for two hours, and show what grows."""

import argparse
import contextlib
import logging
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ |= {"JAX_PLATFORMS": "cpu", "MAESN_CACHE": "off"}

from small_runs import create_tiny

import maesn
from maesn.runs.run import Run
from maesn.runs.training import train

PERIOD = 10
"""Samples between start and end. The first one is taken when everything is compiled."""
WARM = 20
"""Iterations until then."""
MOST_MEMORY, MOST_FILES = 1.1, 2
"""What the end may have of the start: a share of the memory, and some open files more."""


def sample(run: Run) -> tuple[int, int, int]:
    """Return memory in kB, open files, and kB of the run directory."""
    status = Path("/proc/self/status").read_text().splitlines()
    memory = next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))
    size = sum(file.stat().st_size for file in run.directory.rglob("*") if file.is_file())
    return memory, len(list(Path("/proc/self/fd").iterdir())), size // 1024


def main() -> int:
    parser = argparse.ArgumentParser(prog="soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=120.0)
    minutes = parser.parse_args().minutes
    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as directory:
        run = create_tiny(Path(directory) / "run", iterations=10**8, checkpoint_every=10)
        print("| minutes | iterations | memory, MB | open files | directory, kB |")
        print("| ---: | ---: | ---: | ---: | ---: |")
        start, samples = time.monotonic(), []
        with contextlib.closing(train(run)) as steps:
            for progress in steps:
                passed = (time.monotonic() - start) / 60
                due = minutes * len(samples) / PERIOD
                if progress.iteration < WARM or passed < due:
                    continue
                samples.append(sample(run))
                memory, opened, size = samples[-1]
                numbers = (progress.iteration, memory // 1024, opened, size)
                print(f"| {passed:.1f} | {' | '.join(f'{n:,}' for n in numbers)} |", flush=True)
                if len(samples) > PERIOD:
                    break
    print(f"\nmaesn {maesn.__version__}, {minutes:g} minutes")
    first, last = samples[0], samples[-1]
    return int(last[0] > MOST_MEMORY * first[0] or last[1] > first[1] + MOST_FILES)


if __name__ == "__main__":
    sys.exit(main())
