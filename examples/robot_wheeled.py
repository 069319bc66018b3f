"""A wheeled robot explores unseen sparse tasks by itself: `maesn.runtime` without the library.

    maesn export RUN policy.npz
    python examples/robot_wheeled.py policy.npz --tasks 10

The loop below is what a program on a robot looks like: read the sensors, ask the `Explorer`, send
its answer to the motors, and hand it the rewards at the end of the episode. MuJoCo stands in for
the robot, one simulation of it, through MuJoCo's own functions. The library proper is asked for the
list of goals and for nothing else.

Printed are the mean return and the success rate after each update, and the time that `act` takes.
With `--evaluation FILE.csv`, written by `maesn adapt RUN --tasks test --out FILE.csv`, the result
stands beside that of the batched evaluator on the same tasks.
"""

import argparse
import csv
import time
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from maesn.envs.catalogue import FAMILIES
from maesn.runtime import Explorer

MODEL = files("maesn") / "physics" / "models" / "wheeled.xml"
HORIZON = 200
CONTROL_PERIOD = 0.01  # seconds
RADIUS = 0.8  # metres; within it the sparse reward is minus the distance from the goal
CONTROL_COST = 0.05
POSITION_NOISE, VELOCITY_NOISE = 0.01, 0.1
NUM_RESAMPLES = 10_000


class Outcome(NamedTuple):
    """What came of one episode."""

    undiscounted_return: float
    success: bool
    """Whether the goal region was reached at any step."""


class Robot:
    """One simulated robot: what a driver of sensors and motors would be."""

    def __init__(self, seed: Sequence[int]) -> None:
        self.model = mujoco.MjModel.from_xml_string(MODEL.read_text("utf-8"))
        self.data = mujoco.MjData(self.model)
        self.generator = np.random.default_rng(seed)

    def reset(self) -> None:
        """Put the robot back near the origin."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = POSITION_NOISE * self.generator.standard_normal(self.model.nq)
        self.data.qvel[:] = VELOCITY_NOISE * self.generator.standard_normal(self.model.nv)

    def observation(self) -> np.ndarray:
        """Read the sensors: positions, then velocities."""
        return np.concatenate([self.data.qpos, self.data.qvel])

    def move(self, torque: np.ndarray) -> None:
        """Drive the motors (N m) for one control period."""
        self.data.ctrl[:] = torque
        mujoco.mj_step(self.model, self.data)


def sparse_reward(position: np.ndarray, torque: np.ndarray, goal: np.ndarray) -> float:
    """Return -d within the goal region, else -|goal|, less the cost of the torques."""
    distance = np.linalg.norm(position - goal)
    closeness = -distance if distance <= RADIUS else -np.linalg.norm(goal)
    return float(closeness - CONTROL_COST * np.sum(torque**2))


def play_episode(
    explorer: Explorer, robot: Robot, goal: np.ndarray, latencies: list[float]
) -> Outcome:
    """Play one episode; append the seconds that each call of `act` took to `latencies`."""
    robot.reset()
    explorer.begin_episode()
    rewards, success = [], False
    for _ in range(HORIZON):
        observation = robot.observation()
        before = time.perf_counter()
        torque = explorer.act(observation)  # in N m, the motors' unit
        latencies.append(time.perf_counter() - before)
        robot.move(torque)
        position = robot.data.qpos[:2]
        rewards.append(sparse_reward(position, torque, goal))
        success |= bool(np.linalg.norm(position - goal) <= RADIUS)
    explorer.end_episode(rewards)
    return Outcome(sum(rewards), success)


def solve_task(
    options: argparse.Namespace, task: int, goal: np.ndarray, latencies: list[float]
) -> np.ndarray:
    """Explore one task from the prior.

    Returns:
        Mean return and success rate before each update and after the last one,
        `[update + 1, 2]`.
    """
    seeds = np.random.SeedSequence([options.seed, task]).generate_state(2)
    explorer, robot = Explorer.load(options.policy, seed=int(seeds[0])), Robot([int(seeds[1])])
    curve = []
    for update in range(options.updates + 1):
        if update > 0:
            explorer.adapt()
        batch = [play_episode(explorer, robot, goal, latencies) for _ in range(options.episodes)]
        curve.append(np.mean(batch, axis=0))
    return np.stack(curve)


def interval(values: np.ndarray) -> str:
    """Return the mean with its 95 % interval; tasks are resampled (percentile bootstrap)."""
    if len(values) < 2:
        return f"{values.mean():8.2f}  (one task: no interval)"
    picks = np.random.default_rng(0).integers(len(values), size=(NUM_RESAMPLES, len(values)))
    low, high = np.percentile(values[picks].mean(axis=1), [2.5, 97.5])
    return f"{values.mean():8.2f}  [{low:.2f}, {high:.2f}]"


def evaluated(path: str, tasks: int, update: int) -> np.ndarray:
    """Return the evaluator's mean return of tasks 0 ... `tasks - 1` after that many updates."""
    with Path(path).open(newline="", encoding="utf-8") as file:
        found = {
            int(row["task"]): float(row["mean_return"])
            for row in csv.DictReader(file)
            if int(row["update"]) == update
        }
    missing = sorted(set(range(tasks)) - set(found))
    if missing:
        raise SystemExit(
            f"{path} must hold the tasks 0 to {tasks - 1} after {update} updates, but task "
            f"{missing[0]} is missing; lower --tasks or --updates, or evaluate more."
        )
    return np.asarray([found[task] for task in range(tasks)])


def report(options: argparse.Namespace, curves: np.ndarray, latencies: np.ndarray) -> None:
    """Print what was reached, and how long `act` took."""
    print("\nupdate  mean return  success rate")
    for update, (mean_return, success) in enumerate(curves.mean(axis=0)):
        print(f"{update:6d}  {mean_return:11.2f}  {success:12.3f}")
    print("\nmean return, 95 % interval over tasks:")
    for update in sorted({0, options.updates}):
        ours = curves[:, update, 0]
        print(f"  after {update} updates, this robot         {interval(ours)}")
        if options.evaluation:
            theirs = evaluated(options.evaluation, len(curves), update)
            print(f"  after {update} updates, batched evaluator  {interval(theirs)}")
            print(f"  difference, task by task          {interval(ours - theirs)}")
    median, slowest = 1e6 * np.percentile(latencies, [50, 99])
    print(
        f"\nact: median {median:.1f} us, 99th percentile {slowest:.1f} us, which is "
        f"{slowest / (1e4 * CONTROL_PERIOD):.2f} % of the control period of "
        f"{1e3 * CONTROL_PERIOD:.0f} ms"
    )


def parse_arguments(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Drive the wheeled robot by `maesn.runtime`.")
    parser.add_argument("policy", help="policy file, written by `maesn export`")
    parser.add_argument("--tasks", type=int, default=10, help="number of goals (default: 10)")
    parser.add_argument("--episodes", type=int, default=50, help="episodes per update (50)")
    parser.add_argument("--updates", type=int, default=10, help="updates per task (10)")
    parser.add_argument("--seed", type=int, default=0, help="of all random draws (0)")
    parser.add_argument(
        "--task-set", choices=["validation", "test"], default="test", help="unseen goals (test)"
    )
    parser.add_argument("--evaluation", help="CSV of `maesn adapt` on the same task set")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Explore and adapt, task after task, and print what came of it."""
    options = parse_arguments(arguments)
    goals = np.asarray(FAMILIES["wheeled"].task_set(options.task_set).tasks)[: options.tasks]
    latencies: list[float] = []
    curves = []
    for task, goal in enumerate(goals):
        begin = time.perf_counter()
        curves.append(solve_task(options, task, np.asarray(goal, np.float64), latencies))
        first, last = curves[-1][0, 0], curves[-1][-1, 0]
        seconds = time.perf_counter() - begin
        print(f"task {task}: mean return {first:.1f} -> {last:.1f} in {seconds:.1f} s", flush=True)
    report(options, np.stack(curves), np.asarray(latencies))


if __name__ == "__main__":
    main()
