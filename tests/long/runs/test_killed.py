"""Real processes are really killed, and what they resume is the same bit for bit."""

import signal
from pathlib import Path

import pytest
from killing import ITERATIONS, Killer
from small_runs import create, metrics, outcome, tiny_maesn


def test_a_killed_process_resumes_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XLA_FLAGS", "JAX_DISABLE_MOST_OPTIMIZATIONS"):  # compiled as in production
        monkeypatch.delenv(name)
    runs = [
        create(tmp_path / name, tiny_maesn(), iterations=ITERATIONS, checkpoint_every=3)
        for name in ("whole", "killed")
    ]
    killer = Killer(tmp_path, MAESN_CACHE=str(tmp_path / "cache"))
    assert killer.start(runs[0]).wait(timeout=300) == 0
    process = killer.start(runs[1])
    assert killer.stop(runs[1], process, signal.SIGKILL) == -signal.SIGKILL
    process = killer.start(runs[1])
    assert killer.stop(runs[1], process, signal.SIGINT) != 0
    assert "KeyboardInterrupt" in killer.said()
    # Ctrl-C has saved the very last iteration, whatever `checkpoint_every` says.
    assert runs[1].latest().iteration == len(metrics(runs[1])) < ITERATIONS
    assert killer.start(runs[1]).wait(timeout=300) == 0
    assert outcome(runs[0]) == outcome(runs[1])
    assert metrics(runs[1])[-1]["environment_steps"] == ITERATIONS * 2 * 4 * 3 * 40
