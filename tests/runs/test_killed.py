"""Real processes are really killed, and what they resume is the same bit for bit."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_runs import create, metrics, outcome, tiny_maesn

from maesn.runs.run import Run

# More than pass while this process waits for its turn on a busy machine.
ITERATIONS = 150
# 2 collections of 4 tasks, 3 episodes and 40 steps.
STEPS_PER_ITERATION = 2 * 4 * 3 * 40

KILLED = """
import sys
from maesn.runs.process import enable_compilation_cache
from maesn.runs.run import Run
from maesn.runs.training import train
enable_compilation_cache()
for _ in train(Run.open(sys.argv[1])):
    pass
"""


def num_lines(run: Run) -> int:
    log = run.directory / "metrics.jsonl"
    return log.read_bytes().count(b"\n") if log.exists() else 0


class Killer:
    """Starts real training processes, and ends them at random moments."""

    def __init__(self, directory: Path, **environment: str) -> None:
        self._stream = random.Random(1)
        self._environment = os.environ | environment
        self._errors = directory / "errors"

    def start(self, run: Run) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-W", "error", "-c", KILLED, str(run.directory)]
        with self._errors.open("ab") as errors:
            return subprocess.Popen(command, env=self._environment, stderr=errors)

    def said(self) -> str:
        """What all processes have written to their standard error."""
        return self._errors.read_text()

    def stop(self, run: Run, process: subprocess.Popen[bytes], number: signal.Signals) -> int:
        """Send a signal a random number of lines and milliseconds later."""
        target = num_lines(run) + self._stream.randint(1, 12)
        deadline = time.monotonic() + 120
        while num_lines(run) < target:
            assert process.poll() is None, self.said()
            assert time.monotonic() < deadline, "it never got there"
            time.sleep(0.001)
        time.sleep(self._stream.uniform(0, 0.01))
        process.send_signal(number)
        return process.wait(timeout=60)


def new_runs(directory: Path) -> list[Run]:
    return [
        create(directory / name, tiny_maesn(), iterations=ITERATIONS, checkpoint_every=3)
        for name in ("whole", "killed")
    ]


@pytest.mark.long
def test_so_does_one_whose_programs_are_optimised_and_read_from_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XLA_FLAGS", "JAX_DISABLE_MOST_OPTIMIZATIONS"):  # compiled as in production
        monkeypatch.delenv(name)
    whole, killed = new_runs(tmp_path)
    killer = Killer(tmp_path, MAESN_CACHE=str(tmp_path / "cache"))
    assert killer.start(whole).wait(timeout=300) == 0
    process = killer.start(killed)
    assert killer.stop(killed, process, signal.SIGKILL) == -signal.SIGKILL
    process = killer.start(killed)
    assert killer.stop(killed, process, signal.SIGINT) != 0
    assert "KeyboardInterrupt" in killer.said()
    # Ctrl-C has saved the very last iteration, whatever `checkpoint_every` says.
    assert killed.latest().iteration == len(metrics(killed)) < ITERATIONS
    assert killer.start(killed).wait(timeout=300) == 0
    assert outcome(whole) == outcome(killed)
    assert metrics(killed)[-1]["environment_steps"] == ITERATIONS * STEPS_PER_ITERATION
