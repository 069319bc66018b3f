"""The study `quick`, as a user runs it: killed, and on Ray, it leaves the same bytes."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from study_files import files

from maesn.storage import LOCK

KILLS = 20
LONGEST = 30.0  # seconds between two kills; undisturbed, the study takes some minutes


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What the study leaves undisturbed."""
    out = tmp_path_factory.mktemp("whole")
    finish(start(out))
    return files(out / "quick")


def start(out: Path, *options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "maesn", "study", "run", "quick", "--out", str(out)]
    return subprocess.Popen([*command, *options], start_new_session=True)


def finish(process: subprocess.Popen[bytes]) -> None:
    assert process.wait() == 0


def kill_trainer(jobs: Path) -> bool:
    """Kill a process that has trained an iteration at least; return whether there is one."""
    for log in jobs.glob("train-*/run/metrics.jsonl"):
        with contextlib.suppress(OSError, IndexError):
            os.kill(int((log.parent / LOCK).read_text().split()[1]), signal.SIGKILL)
            return True
    return False


def test_killed_at_twenty_random_moments(tmp_path: Path, whole: dict[str, bytes]) -> None:
    draw = random.Random(0)
    kills = 0
    for _ in range(KILLS):
        process = start(tmp_path)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(draw.uniform(1.0, LONGEST))
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        kills += process.wait() == -signal.SIGKILL
    assert kills >= KILLS / 2  # the others came after the end
    finish(start(tmp_path))
    assert files(tmp_path / "quick") == whole


@pytest.mark.parametrize("is_killed", [False, True])
def test_on_ray(tmp_path: Path, whole: dict[str, bytes], *, is_killed: bool) -> None:
    pytest.importorskip("ray")
    process = start(tmp_path, "--executor", "ray", "--workers", "2")
    while is_killed and not kill_trainer(tmp_path / "jobs"):
        assert process.poll() is None
        time.sleep(0.05)
    finish(process)
    assert files(tmp_path / "quick") == whole
