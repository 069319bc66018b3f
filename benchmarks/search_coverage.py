"""How often a search's 90 % intervals hold what a latent returns in a new task.

    python benchmarks/search_coverage.py --out coverage

Searches are played in the tasks. Each return of a proposed latent is compared with its interval. So
are, after every other episode, those of the latent to deploy and of a random one of the archive,
which play one more episode each. Latents whose return is known exactly, because they have been
played and nothing is random, are counted apart. The log score is the mean log density of the
returns: that of the model's mixture, and that of a Gaussian with its mean and standard deviation.
"""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from scipy.stats import norm
from search_rows import private_copy

from maesn.rules import SearchRule
from maesn.runs.run import Run
from maesn.runtime.posterior import Reading
from maesn.runtime.search import LatentSearch
from maesn.search import SearchFastLearner, latent_of
from maesn.search.stored import prior_file, read_prior
from maesn.worlds.collector import Collector

EPISODES = 20


@dataclass(frozen=True)
class Settings:
    """What is searched."""

    out: Path
    """Where copies of the runs are kept."""
    runs: tuple[str, ...] = ("wheeled", "blockpush", "ant")
    """Policies that come with the library by name, others as NAME=DIRECTORY."""
    tasks: str = "test"
    """Task set."""


class Score(NamedTuple):
    """One return beside what was predicted of it."""

    known: float
    covered: float
    mixture: float
    gaussian: float


def score(search: LatentSearch, reading: Reading) -> Score:
    """Return how well a search predicted a reading; `known` has no density."""
    low, high = search.interval(reading.point)
    value = reading.episode_return
    if low == high:
        return Score(1.0, float(np.isclose(low, value, rtol=1e-4)), np.nan, np.nan)
    weights, means, stds = search.posterior.predicted(reading.point, reading.length)
    mean = weights @ means
    std = np.sqrt(weights @ ((means - mean) ** 2 + stds**2))
    density = weights @ norm.pdf(value, means, stds)
    return Score(0.0, float(low <= value <= high), np.log(density), norm.logpdf(value, mean, std))


def scores(run: Run, tasks: str) -> Iterator[tuple[str, Score]]:
    """Search in all tasks of a set; yield kinds of latents, and scores of their returns."""
    generator = np.random.default_rng(0)
    with closing(run.world(run.task_set(tasks), "sparse")) as world:
        settings = SearchRule().settings
        model = settings.model(read_prior(prior_file(run, world.env))[0])
        latent = latent_of(run.learner.fast_learner(run.latest_state()))
        learner, collect = SearchFastLearner(latent, model, settings), Collector(world, 1)
        keys = jax.random.split(jax.random.key(0), collect.num_tasks)
        slots, state = jnp.arange(collect.num_tasks), learner.init(keys)

        def played(points: list[int], stream: int) -> Iterator[tuple[LatentSearch, Reading]]:
            chosen = state.searches
            latents = [one.points[point] for one, point in zip(chosen, points, strict=True)]
            agents = learner.steered.holding(np.asarray(latents, np.float32))
            agents = replace(agents, is_noisy=False)
            episodes = collect(jax.vmap(jax.random.fold_in, (0, None))(keys, stream), agents, slots)
            returns = np.asarray(episodes.undiscounted_return[:, 0], np.float64)
            lengths = np.asarray(episodes.valid[:, 0].mean(-1), np.float64)
            for one, *reading in zip(chosen, points, returns, lengths, strict=True):
                yield one, Reading(*reading)

        for episode in range(EPISODES):
            after = learner.update(
                state,
                collect(
                    jax.vmap(jax.random.fold_in, (0, None))(keys, episode),
                    learner.agents(state),
                    slots,
                ),
            )
            for search, later in zip(state.searches, after.searches, strict=True):
                yield "proposed", score(search, later.posterior.readings[-1])
            state = after
            if episode % 2:
                best = [search.best for search in state.searches]
                some = generator.integers(len(model.archive), size=len(best)).tolist()
                for stream, (kind, points) in enumerate((("deployed", best), ("random", some))):
                    for pair in played(points, 1000 * (stream + 1) + episode):
                        yield kind, score(*pair)


def main(settings: Settings) -> None:
    """Print a line for each run and kind of latent."""
    settings.out.mkdir(parents=True, exist_ok=True)
    print("run,latents,known,readings,covered,log_score,gaussian_log_score")
    for one in settings.runs:
        name, _, source = one.partition("=")
        run = private_copy(name, source or name, settings.out)
        found = defaultdict(list)
        for kind, row in scores(run, settings.tasks):
            found[kind].append(row)
        for kind, rows in found.items():
            table = np.array(rows)
            open_ones = table[table[:, 0] == 0]
            known = len(table) - len(open_ones)
            _, covered, mixture, gaussian = open_ones.mean(axis=0)
            numbers = f"{covered:.3f},{mixture:.2f},{gaussian:.2f}"
            print(f"{name},{kind},{known},{len(open_ones)},{numbers}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Settings))
