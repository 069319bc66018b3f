"""What a search reaches in tasks unlike those of training, beside random latents and the limit.

    PYTHONPATH=examples python benchmarks/search_unfamiliar.py --out unfamiliar --tasks ood

For each kind of goal: the share of episodes in which the deployed latent reaches it, and the
return. The latent is that of a search of 20 episodes, the best of 20 random ones, or the best of
the archive, which no search within it exceeds.
"""

from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from search_rows import (
    DEPLOYED,
    Line,
    adapted_rows,
    archive_returns,
    evaluation,
    private_copy,
)

from maesn.runs.run import Run
from maesn.search import latent_of
from maesn.worlds.collector import Collector

KINDS = ("behind", "nearer", "farther")  # by turns, as `draw_unfamiliar_goals` draws them
LIMIT = "limit"


@dataclass(frozen=True)
class Settings:
    """What is searched."""

    out: Path
    """Where copies of the runs and the played archives are kept."""
    runs: tuple[str, ...] = ("wheeled",)
    """Policies that come with the library by name, others as NAME=DIRECTORY."""
    tasks: str = "ood-validation"
    """Task set."""
    rules: tuple[str, ...] = ("search", "search familiar=1", "own_searches:BestOf spread=3", LIMIT)
    """Rules to compare; `limit` is the archive's best latent."""
    episodes: int = 20
    """Episodes of a search."""


def searched(run: Run, rule: str, settings: Settings) -> np.ndarray:
    """Return success and return of the deployed latent in each task, `[task, 2]`."""
    line = Line(rule, episodes=settings.episodes, tasks=settings.tasks)
    rows = adapted_rows(run, line, evaluation(run, line, settings.tasks, None, 0, 0))
    last = [row for row in rows if row["episodes"] == settings.episodes]
    return np.array([[row["success"], row["deployed"]] for row in last])


def limit(run: Run, settings: Settings) -> np.ndarray:
    """Return the same for the best latent of the archive, chosen by episodes of all of them."""
    out = settings.out / settings.tasks
    out.mkdir(exist_ok=True)
    prior, returns, _ = archive_returns(run, settings.tasks, out)
    best = prior.latents[returns.mean(axis=2).argmax(axis=1)]
    latent = latent_of(run.learner.fast_learner(run.latest_state()))
    with closing(run.world(run.task_set(settings.tasks), "sparse")) as world:
        collect, slots = Collector(world, DEPLOYED), jnp.arange(len(best))
        agents = replace(latent.holding(np.asarray(best, np.float32)), is_noisy=False)
        episodes = collect(jax.random.split(jax.random.key(0), len(best)), agents, slots)
    reached = np.asarray((episodes.valid & episodes.solved).any(-1).mean(-1))
    return np.stack([reached, np.asarray(episodes.undiscounted_return.mean(-1))], axis=-1)


def main(settings: Settings) -> None:
    """Print a line for each run, rule and kind of goal."""
    settings.out.mkdir(parents=True, exist_ok=True)
    print("run,rule,goals,tasks,reached,return")
    for one in settings.runs:
        name, _, source = one.partition("=")
        run = private_copy(name, source or name, settings.out)
        for rule in settings.rules:
            found = limit(run, settings) if rule == LIMIT else searched(run, rule, settings)
            for kind, goals in enumerate(KINDS):
                some = found[kind :: len(KINDS)]
                reached, value = some.mean(axis=0)
                print(f"{name},{rule},{goals},{len(some)},{reached:.3f},{value:.1f}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Settings))
