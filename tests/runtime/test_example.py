"""The example of the wheeled robot: its robot is the library's, and its report is true."""

import csv
import importlib.util
from pathlib import Path
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from runtime.robot import policy_file

from maesn.envs import Wheeled
from maesn.physics import NativeSimulator

EXAMPLE = Path(__file__).parents[2] / "examples" / "robot_wheeled.py"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    specification = importlib.util.spec_from_file_location("robot_wheeled", EXAMPLE)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def wheeled_policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return policy_file(tmp_path_factory.mktemp("wheeled"), Wheeled())


def test_the_robot_moves_as_the_library_s(example: ModuleType) -> None:
    robot = example.Robot([0])
    robot.reset()
    simulator = NativeSimulator("wheeled", 1, readings=("qpos", "qvel"))
    simulator.reset(robot.data.qpos[None].copy(), robot.data.qvel[None].copy())
    for torque in np.random.default_rng(0).uniform(-2, 2, (50, 2)):
        robot.move(torque)
        readings = simulator.step(torque[None])
        expected = np.concatenate([readings["qpos"][0], readings["qvel"][0]])
        np.testing.assert_array_equal(robot.observation(), expected)


def test_the_rewards_are_the_library_s(example: ModuleType) -> None:
    env, goal = Wheeled(reward_kind="sparse"), np.asarray([1.2, 1.6])
    generator = np.random.default_rng(1)
    reward = jax.jit(env.reward)
    kinds = set()
    for _ in range(50):
        position, torque = goal + generator.uniform(-1, 1, 2), generator.uniform(-2, 2, 2)
        qpos = jnp.asarray([*position, 0, 0, 0, 0], jnp.float32)
        readings = {"qpos": qpos, "qvel": jnp.zeros(6)}
        action = jnp.asarray(torque / 2, jnp.float32)
        wanted = reward(readings, action, readings, jnp.asarray(goal, jnp.float32))
        found = example.sparse_reward(position, torque, goal)
        assert found == pytest.approx(float(wanted.total), abs=1e-5)
        kinds.add(bool(np.linalg.norm(position - goal) <= example.RADIUS))
    assert kinds == {True, False}


def evaluation(path: Path, num_tasks: int, updates: int) -> Path:
    """A table as `maesn adapt` writes it."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["task", "update", "mean_return"])
        writer.writerows((t, u, -400.0 - t) for t in range(num_tasks) for u in range(updates + 1))
    return path


def test_it_runs_and_reports(
    example: ModuleType, wheeled_policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = evaluation(tmp_path / "table.csv", 2, 1)
    sizes = ["--tasks", "2", "--episodes", "2", "--updates", "1"]
    example.main([str(wheeled_policy), *sizes, "--evaluation", str(table)])
    printed = capsys.readouterr().out
    assert "task 1: mean return" in printed
    assert "after 1 updates, this robot" in printed
    assert "after 1 updates, batched evaluator   -400.50  [-401.00, -400.00]" in printed
    assert "difference, task by task" in printed
    assert "% of the control period of 10 ms" in printed
