"""Meta-World's families against Meta-World itself; `make test-metaworld` runs these.

Programs in its interpreter play the same tasks by its own classes.
"""

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from playing import constant_agents
from small_runs import metrics, tensors

from maesn import cli
from maesn.axes import TaskKeys
from maesn.envs import HOSTED
from maesn.envs.metaworld import INTERFACE, PYTHON
from maesn.evaluation.adapting import adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.protocols import PROTOCOLS
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.foreign import WorkerPool, pack_task
from maesn.learners import AbstractFastLearner, Capabilities, Purpose
from maesn.runs.run import Run
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

ROOT = Path(__file__).resolve().parents[2]
INTERPRETER = ROOT / PYTHON
STEPS = 120


@pytest.fixture(autouse=True)
def interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.delenv("MAESN_PYTHON", raising=False)


def said_there(program: str, *arguments: str) -> Any:
    """What a program prints as JSON in Meta-World's interpreter."""
    command = [str(INTERPRETER), "-c", program, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd="/")
    return json.loads(done.stdout.splitlines()[-1])


PLAYED = """
import json, pickle, sys
import numpy as np
from metaworld import ML1
from metaworld.types import Task
name, points, actions = sys.argv[1], *map(json.loads, sys.argv[2:])
given = ML1(name, seed=0).test_tasks[0]
data = pickle.loads(given.data) | {"rand_vec": np.float64(points)}
env = data["env_cls"]()
env.set_task(given._replace(data=pickle.dumps(data)))
seen = [[env.reset()[0].tolist(), 0.0, 0.0]]
for action in actions:
    observation, reward, _, _, info = env.step(np.float32(action))
    seen.append([observation.tolist(), float(reward), float(info["success"])])
print(json.dumps(seen))
"""


@pytest.mark.parametrize("name", HOSTED)
def test_episodes_are_those_of_meta_worlds_own_classes(name: str) -> None:
    task, rng = HOSTED[name].task_set("test")[3], np.random.default_rng(1)
    actions = rng.uniform(-1, 1, (STEPS, 4)).astype(np.float32)
    its = "-".join([*name.partition(":")[2].split("_"), "v3"])
    seen = said_there(PLAYED, its, json.dumps(task.tolist()), json.dumps(actions.tolist()))
    observations, rewards, successes = map(np.float32, zip(*seen, strict=True))
    assert np.ptp(rewards[1:]) > 0
    np.testing.assert_array_equal(observations[:, 36:], 0)  # the goal is hidden
    for kind, wanted in (("dense", rewards), ("sparse", successes)):
        with contextlib.closing(HOSTED[name].make_env(reward_kind=kind).open_pool(1)) as pool:
            readings = [pool.begin([pack_task(np.asarray(task))], [0])]
            readings += [pool.step(action[None]) for action in actions]
        for reading, observation, reward in zip(readings, observations, wanted, strict=True):
            np.testing.assert_allclose(reading["observation"][0], observation, atol=1e-6)
            np.testing.assert_allclose(reading["reward"][0], reward, rtol=1e-5)
        solved = [reading["solved"][0] for reading in readings]
        np.testing.assert_array_equal(solved, successes)


@pytest.mark.parametrize("name", HOSTED)
def test_its_environments_look_as_the_library_says(name: str) -> None:
    task = pack_task(np.asarray(HOSTED[name].task_set("test")[0]))
    recipe = HOSTED[name].make_env().recipe
    with contextlib.closing(WorkerPool(recipe.make_env, "dense", None, 1, 120.0, PYTHON)) as pool:
        assert pool.describe(task) == INTERFACE


class Forward(AbstractFastLearner[None]):
    """Moves the hand away from the base, whatever it sees, and learns nothing."""

    env: Any

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(learns_from_reward=False)

    def init(self, keys: TaskKeys) -> None:
        return None

    def agents(self, state: None, purpose: Purpose = "explore") -> Agents:
        return constant_agents(self.env, GOALS, jnp.array([0.0, 1.0, 0.0, 0.0]), 1e-6)

    def update(self, state: None, episodes: Episodes) -> None:
        return None


OFFICIAL = """
import inspect, json, pickle, sys
import gymnasium, numpy as np
import metaworld
from metaworld.evaluation import metalearning_evaluation
points = json.loads(sys.argv[1])
given = metaworld.ML1("reach-v3", seed=0).test_tasks[0]
tasks = [
    given._replace(data=pickle.dumps(pickle.loads(given.data) | {"rand_vec": np.float64(one)}))
    for one in points
]
kind = pickle.loads(given.data)["env_cls"]
make = lambda: metaworld._init_each_env(kind, tasks, task_select="pseudorandom")
envs = gymnasium.vector.SyncVectorEnv(
    [make], autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP
)
class Forward:
    def eval_action(self, observation): return np.float32([[0, 1, 0, 0]])
    def adapt_action(self, observation): return self.eval_action(observation), {}
    def init(self): pass
    def step(self, timestep): pass
    def adapt(self): pass
    def reset(self, env_mask): pass
rate, _, _ = metalearning_evaluation(Forward(), envs, num_evals=len(points))
usual = inspect.signature(metalearning_evaluation).parameters
names = ("adaptation_steps", "adaptation_episodes", "evaluation_episodes")
print(json.dumps([rate, *(usual[name].default for name in names)]))
"""
GOALS = 10


def test_the_protocol_gives_the_number_of_its_own_evaluation() -> None:
    family, asked = HOSTED["metaworld:reach"], Evaluation().changed(protocol="metaworld-ml1")
    points = family.task_set("test").tasks[:GOALS]
    rate, steps, episodes, judged = said_there(OFFICIAL, json.dumps(points.tolist()))
    assert 0 < rate < 1
    assert (steps * episodes, episodes, judged) == asked.budget
    assert PROTOCOLS["metaworld-ml1"].measure == "success_rate"
    env = family.make_env(reward_kind=asked.reward)
    with contextlib.closing(make_world(env, family.task_set("test"), 2)) as world:
        done = adapt(Forward(env), Collector(world, episodes), asked, tasks=range(GOALS))
    np.testing.assert_allclose(done.curves.success_rate[:, -1].mean(), rate)


SMALL = ["--meta-batch-size", "2", "--episodes-per-task", "2", "--policy.hidden-sizes", "8"]
TRAIN = ["train", "maesn", "--family", "metaworld:reach", "--num-threads", "2", *SMALL]


def test_the_documented_commands(tmp_path: Path) -> None:
    """Without `--python`, as in a clone; a run that is resumed is the run that never stopped."""
    whole, run = tmp_path / "whole", tmp_path / "run"
    assert cli.run([*TRAIN, "--run", str(whole), "--iterations", "2"]) == 0
    assert cli.run([*TRAIN, "--run", str(run), "--iterations", "1"]) == 0
    assert cli.run(["resume", str(run), "--iterations", "2", "--python", str(INTERPRETER)]) == 0
    first, second = Run.open(whole), Run.open(run)
    assert metrics(first) == metrics(second)
    assert tensors(first.checkpoints()[-1]) == tensors(second.checkpoints()[-1])
    np.savez(tmp_path / "few.npz", points=HOSTED["metaworld:reach"].task_set("test", 2).tasks)
    few = ["--tasks", str(tmp_path / "few.npz"), "--episodes-per-update", "5"]
    table = tmp_path / "table.csv"
    words = ["adapt", str(run), "--protocol", "metaworld-ml1", *few, "--out", str(table)]
    assert cli.run(words) == 0
    with table.open() as file:
        deployed = [row for row in csv.DictReader(file) if row["purpose"] == "deploy"]
    assert [(row["update"], row["episodes"]) for row in deployed] == [("2", "10")] * 2
    assert cli.run(["export", str(run), str(tmp_path / "policy.npz")]) == 0


def test_a_run_that_is_told_to_end_saves_and_goes_on(tmp_path: Path) -> None:
    whole, run = tmp_path / "whole", tmp_path / "run"
    assert cli.run([*TRAIN, "--run", str(whole), "--iterations", "3"]) == 0
    command = [sys.executable, "-m", "maesn", *TRAIN, "--run", str(run), "--iterations", "3"]
    variables = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(command, env=variables, start_new_session=True) as process:
        while not (run / "metrics.jsonl").exists() or not (run / "metrics.jsonl").read_text():
            assert process.poll() is None
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGTERM)
    done = len(metrics(Run.open(run)))
    assert 1 <= done < 3
    assert cli.run(["resume", str(run)]) == 0
    assert [one["return_after"] for one in metrics(Run.open(run))] == [
        one["return_after"] for one in metrics(Run.open(whole))
    ]
