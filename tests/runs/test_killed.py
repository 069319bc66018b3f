"""Real processes are really killed, and what they resume is the same bit for bit."""

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


def trained(run: Run, number: signal.Signals | None = None) -> tuple[int, str]:
    """Train in a process, to its end or until it is sent a signal after some more iterations.

    Returns its exit status, and what it says.
    """
    command = [sys.executable, "-W", "error", "-c", KILLED, str(run.directory)]
    log = run.directory / "metrics.jsonl"

    def num_lines() -> int:
        return log.read_bytes().count(b"\n") if log.exists() else 0

    target = num_lines() + 7
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        while number is not None and process.poll() is None and num_lines() < target:
            time.sleep(0.001)
        if number is not None:
            time.sleep(0.01)  # until the iteration that was logged is all there
            process.send_signal(number)
        _, said = process.communicate(timeout=300)
        return process.returncode, said


@pytest.mark.long
def test_a_run_whose_programs_are_optimised_and_read_from_the_cache_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XLA_FLAGS", "JAX_DISABLE_MOST_OPTIMIZATIONS"):  # compiled as in production
        monkeypatch.delenv(name)
    monkeypatch.setenv("JAX_ENABLE_COMPILATION_CACHE", "true")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    whole, killed = (
        create(tmp_path / name, tiny_maesn(), iterations=ITERATIONS, checkpoint_every=3)
        for name in ("whole", "killed")
    )
    assert trained(whole) == (0, "")
    assert trained(killed, signal.SIGKILL)[0] == -signal.SIGKILL
    status, said = trained(killed, signal.SIGINT)
    assert status != 0
    assert "KeyboardInterrupt" in said
    # Ctrl-C has saved the very last iteration, whatever `checkpoint_every` says.
    assert killed.latest().iteration == len(metrics(killed)) < ITERATIONS
    assert any((tmp_path / "cache").iterdir())
    assert trained(killed)[0] == 0
    assert outcome(whole) == outcome(killed)
    assert metrics(killed)[-1]["environment_steps"] == ITERATIONS * STEPS_PER_ITERATION
