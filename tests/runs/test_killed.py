"""A real process is really killed, and what it resumes is the same bit for bit.

`tests/long` does it with programs that are compiled as in production and read back from the cache.
"""

import signal
from pathlib import Path

from killing import ITERATIONS, Killer, num_lines
from small_runs import create, finish, metrics, outcome, reopened, tiny_maesn


def test_a_killed_process_resumes_bit_for_bit(tmp_path: Path) -> None:
    whole, killed = (
        create(tmp_path / name, tiny_maesn(), iterations=ITERATIONS, checkpoint_every=3)
        for name in ("whole", "killed")
    )
    killer = Killer(tmp_path)
    process = killer.start(killed)
    assert killer.stop(killed, process, signal.SIGKILL) == -signal.SIGKILL
    iterations = num_lines(killed) + 5
    assert iterations < ITERATIONS
    assert outcome(finish(reopened(killed), iterations)) == outcome(finish(whole, iterations))
    assert metrics(killed)[-1]["environment_steps"] == iterations * 2 * 4 * 3 * 40
