"""Bounds on returns that need no training, in the families on Gymnasium's robots.

    python benchmarks/limits_walking.py

Printed are mean returns of an episode over the test tasks: of a robot that stands still, which is
measured; and two bounds. The first holds for every policy that sees neither the task nor a reward:
in each step it is judged as the best speed or place that is the same in all tasks, at no cost (in
`ant_dir` for directions that balance each other, as those of a set nearly do). The second holds for
every policy: what a robot would have that is at the goal or target speed all the time. "-" where
nothing limits the speed.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maesn.envs import find_family
from maesn.envs.ant_v5 import GOAL_RADIUS, LARGEST_DISTANCE, SURVIVAL_BONUS
from maesn.envs.walking import HORIZON
from maesn.evaluation.adapting import adapt
from maesn.learners import baselines
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

FAMILIES = ("cheetah_vel", "cheetah_dir", "cheetah_body", "ant_dir", "ant_goal", "sparse_ant_goal")
GRID = 201  # places tried along each axis of the disc of goals


class Bounds(NamedTuple):
    """Mean returns of an episode that are not exceeded; infinite where the speed counts."""

    blind: float
    """Without seeing the task or a reward."""
    oracle: float


def standing_return(name: str, tasks: str = "test") -> float:
    """Return the mean return of episodes without torques, one in each task of a set."""
    family = find_family(name)
    env = family.make_env()
    still = baselines(env.observation_size, env.action_size, env.action_kind)["zero action"]
    collect = Collector(make_world(env, family.task_set(tasks)), 1)  # type: ignore[arg-type]
    return float(adapt(still, collect, episodes=0).curves.mean_return.mean())


def bounds(name: str, tasks: np.ndarray) -> Bounds:
    """Return bounds on the mean return over tasks."""
    per_step = {
        "cheetah_vel": lambda: (-np.abs(tasks - np.median(tasks)).mean(), 0.0),
        "cheetah_dir": lambda: (0.0, np.inf),
        "cheetah_body": lambda: (np.inf, np.inf),
        "ant_dir": lambda: (SURVIVAL_BONUS, np.inf),
        "ant_goal": lambda: (-np.abs(tasks - np.median(tasks, axis=0)).sum(1).mean(), 0.0),
        "sparse_ant_goal": lambda: (_best_place(tasks), 1.0),
    }[name]()
    return Bounds(*(HORIZON * float(x) for x in per_step))


def _best_place(goals: Float[np.ndarray, "task 2"]) -> float:
    """Return the largest mean sparse reward of a place, on a grid."""
    line = np.linspace(-LARGEST_DISTANCE, LARGEST_DISTANCE, GRID)
    places = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 1, 2)
    distance = np.linalg.norm(places - goals, axis=-1)
    return float(np.where(distance <= GOAL_RADIUS, 1.0 - distance, -GOAL_RADIUS).mean(1).max())


def main() -> None:
    """Print a row for each family."""
    print("| family | stands still | no blind policy exceeds | no policy exceeds |")
    print("|---|---|---|---|")
    for name in FAMILIES:
        found = bounds(name, find_family(name).task_set("test").tasks)
        shown = (str(round(x)) if np.isfinite(x) else "-" for x in (standing_return(name), *found))
        print(f"| `{name}` | {' | '.join(shown)} |")


if __name__ == "__main__":
    main()
