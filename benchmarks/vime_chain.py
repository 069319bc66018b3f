"""Who finds a reward that is far away: TRPO, REINFORCE, and VIME, on the sparse chain.

    PYTHONPATH=examples python benchmarks/vime_chain.py --out results/vime_chain

Every seed plays several tasks, each with weights and random draws of its own. A run has found the
reward at the first update before which some episode had it. Policies and batches are the same for
all, and so is the step of TRPO for all but `reinforce`. `random_bonus` is VIME with random numbers
in the place of information gains: what it finds, steps in random directions find.
"""

import csv
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from chain import chain
from random_bonus import curiosities

from maesn.evaluation.adapting import AdaptationCurves, adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import SCRATCH, AbstractFastLearner
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.policies import GaussianMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

METHODS = ("trpo", "reinforce", "random_bonus", "vime")
EARLY = 20  # updates within which a find counts as early: a quarter of the default number


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    seeds: int = 5
    """Seeds 0, 1, ... are played."""
    tasks: int = 4
    """Tasks per seed."""
    updates: int = 80
    """Updates per run."""
    episodes_per_task: int = 10
    """Episodes of 50 steps per update."""
    reward_elsewhere: float = 0.0
    """Reward of a step that does not reach the goal. Where it is not 0, TRPO drifts."""
    bonus: float = CuriosityBonus().weight
    """VIME's bonus for a transition of typical information gain."""
    out: Path | None = None
    """Directory for the table; None: it is printed alone."""


def learner(name: str, settings: Settings) -> AbstractFastLearner:
    """Return a method for the chain's one observation and one action."""
    bonuses = curiosities(settings.bonus)
    bonus = {"curiosity": bonuses[name]} if name in bonuses else {}
    method = "vime" if bonus else name
    return SCRATCH[method](1, 1, policy=GaussianMLP(hidden_sizes=(32,)), **bonus)


def row(name: str, seed: int, curves: AdaptationCurves) -> dict[str, str | int | float]:
    """Summarise the runs of one method and one seed."""
    found = curves.success_rate > 0
    first = np.where(found.any(axis=1), found.argmax(axis=1), np.inf)
    return {
        "method": name,
        "seed": seed,
        "runs": len(found),
        "found": int(found.any(axis=1).sum()),
        "found_early": int(found[:, : EARLY + 1].any(axis=1).sum()),
        "median_first_update": float(np.median(first)),
        "final_success_rate": round(float(curves.success_rate[:, -1].mean()), 3),
        "final_return": round(float(curves.mean_return[:, -1].mean()), 3),
    }


def main(settings: Settings) -> None:
    """Play all methods and seeds, and print one line for each."""
    tasks = chain.task_set("test", size=settings.tasks)
    env = chain.make_env(reward_kind="sparse", reward_elsewhere=settings.reward_elsewhere)
    collect = Collector(make_world(env, tasks), settings.episodes_per_task)
    rows = []
    for name in METHODS:
        for seed in range(settings.seeds):
            start = time.perf_counter()
            outcome = adapt(
                learner(name, settings),
                collect,
                Evaluation(seed=seed),
                episodes=settings.updates * settings.episodes_per_task,
            )
            rows.append(row(name, seed, outcome.curves))
            print(*rows[-1].values(), f"{time.perf_counter() - start:.0f} s", sep="\t", flush=True)
    summarise(rows, settings)
    if settings.out is not None:
        settings.out.mkdir(parents=True, exist_ok=True)
        with (settings.out / "table.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def summarise(rows: list[dict[str, str | int | float]], settings: Settings) -> None:
    """Print what the seeds of each method come to."""
    print(
        f"\nsparse chain, reward {settings.reward_elsewhere:g} elsewhere, "
        f"{settings.updates} updates of {settings.episodes_per_task} episodes"
    )
    for name in METHODS:
        mine = [row for row in rows if row["method"] == name]
        found, early, runs = (
            sum(int(row[key]) for row in mine) for key in ("found", "found_early", "runs")
        )
        seeds = sum(int(row["found"]) > 0 for row in mine)
        success = np.mean([float(row["final_success_rate"]) for row in mine])
        print(
            f"{name:12s} found the reward in {found} of {runs} runs, in {early} of them within "
            f"{EARLY} updates, in {seeds} of {len(mine)} seeds; success rate at the end "
            f"{success:.2f}"
        )


if __name__ == "__main__":
    main(tyro.cli(Settings))
