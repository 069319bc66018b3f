"""Does any bonus help, or only that of VIME? Information gains against random numbers.

    python benchmarks/bonus_control.py --out runs/bonus_control

Both methods are TRPO from scratch with the same policies, batches and size of the bonus. One adds
the information gain of each transition to its reward, the other (`random_bonus`) random numbers,
exponentially distributed. Where returns hardly differ otherwise, random bonuses move the policy in
random directions, which is a search as well.
"""

import csv
import gzip
import math
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from random_bonus import curiosities

from maesn.envs import find_family
from maesn.evaluation.adapting import adapt, as_rows
from maesn.evaluation.evaluation import Evaluation
from maesn.learners.scratch.policy_gradient import vime
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.policies import GaussianMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


@dataclass(frozen=True)
class Settings:
    """What is compared. The defaults are those of `vime` on `blockpush` in the study `paper`."""

    family: str = "blockpush"
    """Family of tasks."""
    methods: tuple[Literal["random_bonus", "vime"], ...] = ("random_bonus", "vime")
    """Which of the two."""
    num_tasks: int = 30
    """The first so many test tasks, at least 2."""
    updates: int = 100
    """Updates per task."""
    episodes_per_task: int = 20
    """Episodes per update."""
    weight: float = CuriosityBonus().weight
    """Bonus of a transition with the typical gain."""
    seed: int = 0
    """Of policies and episodes."""
    out: Path | None = None
    """Directory for the table; None: a summary is printed alone."""


def curves(method: str, settings: Settings) -> list[dict[str, object]]:
    """Return the rows of one method, a row per task and update."""
    family = find_family(settings.family)
    env, tasks = family.make_env(reward_kind="sparse"), family.task_set("test")
    learner = vime(
        env.observation_size,
        env.action_size,
        policy=GaussianMLP(),
        curiosity=curiosities(settings.weight)[method],
    )
    with closing(make_world(env, tasks)) as world:
        outcome = adapt(
            learner,
            Collector(world, settings.episodes_per_task),
            Evaluation(seed=settings.seed),
            episodes=settings.updates * settings.episodes_per_task,
            tasks=range(settings.num_tasks),
        )
    return [{"method": method, **row} for row in as_rows(outcome)]


def summarise(method: str, rows: list[dict[str, object]]) -> str:
    """Return a line on where a method ends."""
    last = max(int(row["update"]) for row in rows)
    ends = [row for row in rows if int(row["update"]) == last]
    returns = np.array([float(row["mean_return"]) for row in ends])
    success = np.array([float(row["success_rate"]) for row in ends])
    error = returns.std(ddof=1) / math.sqrt(len(returns))
    return (
        f"{method:12s} after {last} updates: return {returns.mean():.1f} ± {error:.1f} (one "
        f"standard error over {len(returns)} tasks), reaches the goal in {success.mean():.0%} of "
        "the episodes"
    )


def main(settings: Settings) -> None:
    """Play the methods, print where they end, and write the curves."""
    for method in settings.methods:
        rows = curves(method, settings)
        print(summarise(method, rows), flush=True)
        if settings.out is not None:
            settings.out.mkdir(parents=True, exist_ok=True)
            with gzip.open(settings.out / f"{method}.csv.gz", "wt", newline="") as file:
                writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
