"""Environments in an interpreter that has NumPy and nothing else: neither this library nor JAX."""

import json
import os
import re
import sys
import venv
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from playing import play
from small_runs import metrics

from maesn import cli
from maesn.envs import TaskFamily, describe_env
from maesn.envs.foreign import gymnasium_family
from maesn.foreign import InterfaceError, WorkerPool, hosted_in
from maesn.runs.run import Run
from maesn.storage import RunError
from maesn.worlds import EpisodeError

ENVIRONMENT = """
import os, sys, time
import numpy as np

class Box:
    dtype = np.dtype(np.float32)
    def __init__(self, bound):
        self.low, self.high, self.shape = -bound * np.ones(2), bound * np.ones(2), (2,)

class Env:
    observation_space, action_space = Box(np.inf), Box(1.0)
    metadata, spec = {"render_fps": 10}, None
    def __init__(self, goal):
        self.goal, self.steps = goal, 0
    def reset(self, *, seed=None, options=None):
        self.at = np.random.default_rng(seed).normal(0, 0.1, 2)
        return self.at, {}
    def step(self, action):
        self.at = self.at + action
        distance = float(np.linalg.norm(self.at - self.goal))
        return self.at, -distance, False, False, {"success": distance < 0.5}
    def close(self):
        pass

class Crashing(Env):
    def step(self, action):
        print("the arm is on fire", file=sys.stderr, flush=True)
        os._exit(3)

def make(task, reward):
    assert not {"jax", "gymnasium", "maesn"} & set(sys.modules)
    return Env(task)

def crash(task, reward):
    return Crashing(task)

def hang(task, reward):
    print("waiting for the arm", file=sys.stderr, flush=True)
    time.sleep(3600)
"""


def family_of(name: str, time_limit: float = 60.0, **settings: Any) -> TaskFamily:
    def draw(stream: np.random.Generator, size: int) -> np.ndarray:
        return stream.uniform(-1, 1, (size, 2)).astype(np.float32)

    return gymnasium_family("there", f"{name}", draw, horizon=5, time_limit=time_limit, **settings)


@pytest.fixture
def python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An interpreter with NumPy, and a directory with the environment."""
    bare = bare_interpreter(tmp_path / "there")
    packages = next((tmp_path / "there").glob("lib/*/site-packages"))
    for found in Path(np.__file__).parents[1].glob("numpy*"):
        (packages / found.name).symlink_to(found)
    (tmp_path / "there_env.py").write_text(ENVIRONMENT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    return bare


def bare_interpreter(place: Path) -> Path:
    venv.create(place, symlinks=True)
    return place / "bin/python"


def test_episodes_are_those_of_this_interpreter(
    python: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    family = family_of("there_env:make")
    tasks = family.task_set("test", 3)
    with hosted_in(python):
        there = play(family.make_env(), tasks, [0, 1, 2], num_threads=2)
    assert np.ptp(there.reward) > 0
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys.modules["playing"], "_collectors", {})
    here = play(family_of("there_env:make").make_env(), tasks, [0, 1, 2], num_threads=1)
    jax.tree.map(np.testing.assert_array_equal, here, there)


FAILING = {
    "there_env:crash": r"the environment has ended its process \(exit code 3\)",
    "there_env:hang": r"the environment has not returned within `time_limit`, 2 s",
    "elsewhere:make": r"`make_env` cannot be loaded by .*python: ModuleNotFoundError: .*elsewhere",
}


@pytest.mark.parametrize("name", FAILING)
def test_what_goes_wrong_there_is_said_with_its_last_words(name: str, python: Path) -> None:
    family = family_of(name, time_limit=2.0)
    failures = (InterfaceError, EpisodeError)
    with hosted_in(python), pytest.raises(failures, match=FAILING[name]) as error:
        play(family.make_env(), family.task_set("test", 2), [0, 1], num_threads=1)
    words = "".join(cli._notes(error.value))
    wanted = {"there_env:crash": "the arm is on fire", "there_env:hang": "waiting for the arm"}
    assert wanted.get(name, "") in words
    assert name != "elsewhere:make" or not words  # no traceback of what imports modules


def test_an_interpreter_that_cannot_do_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    family = family_of("there_env:make")
    bare, text = bare_interpreter(tmp_path / "bare"), tmp_path / "text"
    text.write_text("no program")
    text.chmod(0o755)
    monkeypatch.setenv("PYTHONPATH", str(Path(np.__file__).parents[1]))  # of this interpreter
    reasons = {
        bare: "python` ended before it could make an environment .*No module named 'numpy'",
        text: "text` cannot be started: Exec format error",
        Path("/bin/true"): r"true` ended before it could make an environment \(exit code 0\)",
    }
    for python, reason in reasons.items():
        with hosted_in(python), pytest.raises(InterfaceError, match=reason):
            family.make_env()
    with pytest.raises(RunError, match="`--python` must be the path of an interpreter"):
        hosted_in(tmp_path).__enter__()
    sent = gymnasium_family("there", lambda task, reward: None, family.draw_tasks, horizon=5)
    with hosted_in(sys.executable), pytest.raises(InterfaceError, match="must be its"):
        sent.make_env()
    monkeypatch.setattr("maesn.foreign.process.PROTOCOL", 0)
    with pytest.raises(InterfaceError, match="speaks version 0 of the protocol, this file 2"):
        family.make_env()


def test_a_family_may_know_its_interpreter(python: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the current directory, unless there is none or another one is named."""
    monkeypatch.delenv("MAESN_PYTHON", raising=False)
    usual = os.path.relpath(python)
    pools = [WorkerPool("there_env:make", "dense", None, 1, 60.0, x) for x in (usual, "absent", "")]
    assert [pool._python for pool in pools] == [str(python), None, None]
    with hosted_in(sys.executable):
        assert WorkerPool("there_env:make", "dense", None, 1, 60.0, usual)._python == sys.executable
    made = family_of("there_env:make", python=usual).make_env()
    assert made.recipe.python == usual
    assert "there" not in json.dumps(describe_env(made)).replace('"there"', "")


def test_commands_take_the_interpreter_and_runs_do_not_name_it(
    python: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there_family.py").write_text(
        "import numpy as np\n"
        "from maesn.envs.foreign import gymnasium_family\n"
        "def draw(stream, size):\n"
        "    return stream.uniform(-1, 1, (size, 2)).astype(np.float32)\n"
        "family = gymnasium_family('there', 'there_env:make', draw, horizon=5)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    family = ["--family", "there_family:family"]
    train = ["train", "walk:Walk", "--run", "run", "--iterations", "1", *family]
    assert cli.run([*train, "--python", str(python)]) == 0
    assert cli.run(["resume", "run", "--iterations", "2", f"--python={python}", *family]) == 0
    assert len(metrics(Run.open("run", "there_family:family"))) == 2
    texts = [path.read_text() for path in Path("run").glob("*.json*")]
    assert texts
    assert not any(re.search("there/bin", text) for text in texts)
    assert cli.run([*train, "--python"]) == cli.USAGE_ERROR
