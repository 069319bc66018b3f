"""How often the posterior's 90 % intervals hold what a latent returns in a new task.

    python benchmarks/search_coverage.py --out coverage

The archive of each run is played in the tasks. Searches then read half of these episodes, drawn at
random, and the mean of the other half is compared with the posterior of every latent: it is covered
if its place in the predictive distribution lies between 5 and 95 %. The distribution is that of a
mean of so many episodes, the noise of episodes included. Archives are kept in `--out`.
"""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import tyro
from scipy.stats import norm
from search_rows import archive_returns, private_copy

from maesn.runs.run import Run
from maesn.runtime.return_model import Posterior, Reading, ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings

LOW, HIGH = 0.05, 0.95
SHOWN = (0, 1, 3, 5, 10, 20)


@dataclass(frozen=True)
class Settings:
    """What is searched."""

    out: Path
    """Where archives are kept."""
    runs: tuple[str, ...] = ("wheeled", "blockpush", "ant")
    """Policies that come with the library by name, others as NAME=DIRECTORY."""
    tasks: str = "validation"
    """Task set."""
    residual: tuple[float, ...] = (0.0, 0.03, 0.1, 0.3)
    """Variances of the residual, as shares of that over training tasks."""


def places(model: ReturnModel, posterior: Posterior, truth: np.ndarray, count: int) -> np.ndarray:
    """Return where a mean of `count` episodes lies in the predictive distribution, `[latent]`."""
    variance = np.maximum(posterior.variance, 0.0) + model.noise(posterior.points) / count
    standard = (truth - posterior.task_mean) / np.sqrt(variance)
    return np.asarray(posterior.task_weights @ norm.cdf(standard))


def covered(
    model: ReturnModel, settings: SearchSettings, returns: np.ndarray, length: np.ndarray,
    offset: float, seed: int,
) -> np.ndarray:  # fmt: skip
    """Search in one task by recorded episodes.

    Args:
        model: of the returns.
        settings: of the search.
        returns: of the archive in this task, `[latent, episode]`.
        length: likewise.
        offset: what the task returns to who never finds the goal.
        seed: of the choice of episodes.

    Returns:
        After each of `SHOWN` episodes: the share of latents that are covered, whether the deployed
        one is, and whether that one's mean is below its interval, `[count, 3]`.
    """
    half = returns.shape[1] // 2
    truth = (returns - length * offset)[:, half:].mean(axis=1)
    generator = np.random.default_rng(seed)
    search, found = LatentSearch.start(model, settings), []
    for episode in range(max(SHOWN) + 1):
        if episode in SHOWN:
            place = places(model, search.posterior, truth, half)
            inside = (place > LOW) & (place < HIGH)
            found.append([inside.mean(), inside[search.best], place[search.best] <= LOW])
        search, point = search.proposed(generator)
        pick = generator.integers(half)
        search = search.after([Reading(point, returns[point, pick], length[point, pick])])
    return np.asarray(found, np.float64)


def offsets(run: Run, tasks: str) -> np.ndarray:
    """Return what each task returns to who never finds the goal, `[task]`."""
    with closing(run.world(run.task_set(tasks), "sparse")) as world:
        env = world.env
        return env.horizon * np.asarray(jax.vmap(env.far_reward)(world.tasks.tasks))


def main(settings: Settings) -> None:
    """Print the share of latents that is covered, by run, residual and number of episodes."""
    settings.out.mkdir(parents=True, exist_ok=True)
    print("run,residual,episodes,covered,deployed_covered,deployed_below")
    for one in settings.runs:
        name, _, source = one.partition("=")
        run = private_copy(name, source or name, settings.out)
        prior, returns, length = archive_returns(run, settings.tasks, settings.out)
        far = offsets(run, settings.tasks)
        for residual in settings.residual:
            # Of the archive alone: nothing else has been played.
            how = SearchSettings(draws=0, residual=residual)
            model = how.model(prior)
            shares = np.mean(
                [
                    covered(model, how, returns[task], length[task], far[task], task)
                    for task in range(len(returns))
                ],
                axis=0,
            )
            for count, row in zip(SHOWN, shares, strict=True):
                print(
                    name, residual, count, *(f"{share:.3f}" for share in row), sep=",", flush=True
                )


if __name__ == "__main__":
    main(tyro.cli(Settings))
