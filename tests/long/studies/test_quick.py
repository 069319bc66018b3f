"""The study `quick`, as a user runs it: killed, it leaves the same bytes."""

import contextlib
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from study_files import files

KILLS = 20
LONGEST = 30.0  # seconds between two kills; undisturbed, the study takes some minutes


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What the study leaves undisturbed."""
    out = tmp_path_factory.mktemp("whole")
    finish(start(out))
    return files(out / "quick")


def start(out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "maesn", "study", "run", "quick", "--out", str(out)]
    return subprocess.Popen(command, start_new_session=True)


def finish(process: subprocess.Popen[bytes]) -> None:
    assert process.wait() == 0


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
