"""Processes that train one run together, as the command line starts them."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest

from maesn.numerics.processes import Sharing, num_cores
from maesn.storage import RunError, read_json_lines

SETTINGS = [
    *("--family", "point", "--meta-batch-size", "8", "--episodes-per-task", "5"),
    *("--num-threads", "1", "--checkpoint-every", "2", "--outer.trust-region.cg-steps", "5"),
]


@pytest.mark.parametrize(("limit", "cores"), [("1", 1), ("0", 1), ("many", None), ("", None)])
def test_cores_are_at_least_one_and_at_most_the_limit_if_it_is_a_number(
    monkeypatch: pytest.MonkeyPatch, limit: str, cores: int | None
) -> None:
    monkeypatch.delenv("NPROC", raising=False)
    found = num_cores()
    monkeypatch.setenv("NPROC", limit)
    assert num_cores() == (cores or found)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("localhost", 0))
        return int(found.getsockname()[1])


class Starter:
    """Starts `maesn` in double precision, and keeps what it says."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._environment = os.environ | {"JAX_ENABLE_X64": "1"}

    def start(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "maesn", *arguments]
        with (self.directory / name).open("wb") as said:
            return subprocess.Popen(
                command, cwd=self.directory, env=self._environment, stdout=said, stderr=said
            )

    def said(self, name: str) -> str:
        return (self.directory / name).read_text()

    def run(self, name: str, *arguments: str) -> None:
        assert self.start(name, *arguments).wait(timeout=300) == 0, self.said(name)

    def both(self, *arguments: str) -> list[subprocess.Popen[bytes]]:
        shared = ("--coordinator", f"localhost:{free_port()}", "--num-processes", "2")
        return [self.start(f"said-{i}", *arguments, *shared, "--process", str(i)) for i in range(2)]


def metrics(directory: Path) -> list[dict[str, float]]:
    return read_json_lines(directory / "metrics.jsonl")


@pytest.mark.long
def test_two_processes_train_what_one_does_and_one_goes_on(tmp_path: Path) -> None:
    starter = Starter(tmp_path)
    train = ("train", "maesn", *SETTINGS, "--iterations", "3", "--run")
    processes = starter.both(*train, "two")
    assert [process.wait(timeout=300) for process in processes] == [0, 0], starter.said("said-1")
    assert "3/3" in starter.said("said-0")
    assert "3/3" not in starter.said("said-1")
    assert "trained" not in starter.said("said-1")
    starter.run("said-resumed", "resume", "two", "--iterations", "5")
    starter.run("said-alone", *train, "one")
    starter.run("said-devices", "resume", "one", "--iterations", "5", "--devices", "2")
    for together, alone in zip(metrics(tmp_path / "two"), metrics(tmp_path / "one"), strict=True):
        np.testing.assert_allclose(list(together.values()), list(alone.values()), rtol=1e-4)
    devices = [line["devices"] for line in read_json_lines(tmp_path / "two" / "timing.jsonl")]
    assert devices == [2, 2, 2, 1, 1]
    devices = [line["devices"] for line in read_json_lines(tmp_path / "one" / "timing.jsonl")]
    assert devices == [1, 1, 1, 2, 2]


@pytest.mark.long
@pytest.mark.parametrize(("dies", "named"), [(0, "leader task"), (1, "Task 1 heartbeat timeout")])
def test_a_process_that_dies_ends_the_other_and_is_named(
    tmp_path: Path, dies: int, named: str
) -> None:
    starter = Starter(tmp_path)
    processes = starter.both("train", "maesn", *SETTINGS, "--iterations", "10000", "--run", "run")
    deadline = time.monotonic() + 300
    while not re.search("^4/", starter.said("said-0"), re.MULTILINE):
        assert processes[0].poll() is None, starter.said("said-0")
        assert time.monotonic() < deadline, "it never got there"
        time.sleep(0.1)
    processes[dies].kill()
    assert processes[dies].wait() == -signal.SIGKILL
    other = 1 - dies
    assert processes[other].wait(timeout=60) != 0
    assert named in starter.said(f"said-{other}")
    reached = int(max((tmp_path / "run" / "checkpoints").iterdir()).stem.split("-")[1])
    assert reached >= 2
    starter.run("said-resumed", "resume", "run", "--iterations", str(reached + 1))
    assert len(metrics(tmp_path / "run")) == reached + 1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"devices": 0}, "`devices` must be at least 1, got 0"),
        ({"process": 1}, "`num_processes` and `process` need a `coordinator`"),
        ({"coordinator": "here:1"}, "`coordinator` needs `num_processes` and `process`"),
        ({"coordinator": "h:1", "num_processes": 2, "process": 2}, "from 0 to 1, got 2"),
    ],
)
def test_what_cannot_be_shared_is_said(settings: dict[str, int], message: str) -> None:
    with pytest.raises(RunError, match=message):
        Sharing(**settings)  # type: ignore[arg-type]


def test_devices_are_asked_for_before_jax_begins() -> None:
    jax.devices()
    with (
        pytest.raises(RunError, match="`devices` is 64, but JAX has begun with"),
        Sharing(devices=64).begun(),
    ):
        pass
