"""What a cheaper prior costs a search: return after some episodes, by the size of the prior.

    python benchmarks/prior_cost.py blockpush --episodes 10

For each size, the prior of a run is made anew, and a search adapts to validation tasks with it.
The table has the episodes of the archive, without those of the dense update and the calibration,
the mean return of the deployed latent, and the difference to the largest prior, paired by task,
with half its 95 % interval.
"""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import maesn
from maesn.runs.run import Run
from maesn.runs.sources import find_run
from maesn.search.stored import run_prior

# Draws, episodes of each latent, and whether the adapted latents are played too; the largest first.
SIZES = ((400, 4, True), (400, 1, True), (250, 1, True), (100, 1, True), (100, 1, False))
HEADING = (
    f"{'draws':>5} {'episodes each':>13} {'adapted':>7} {'episodes':>9} {'return':>8}  "
    "against the largest"
)


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    run: tyro.conf.Positional[str]
    """Directory of a run, or name of a policy that comes with the library."""
    episodes: int = 10
    """Episodes of the search in each task."""
    num_tasks: int = 100
    """Validation tasks."""
    deploy_episodes: int = 5
    """Fresh episodes that judge the deployed latent."""


def returns_with(run: Run, prior: maesn.PriorSettings, settings: Settings) -> np.ndarray:
    """Return each task's return after a search with such a prior."""
    run_prior(run, prior, directory=run.directory)
    done = maesn.adapt(
        run,
        tasks="validation",
        num_tasks=settings.num_tasks,
        rule=maesn.SearchRule(),
        episodes=settings.episodes,
        deploy_episodes=settings.deploy_episodes,
        deploy_after=(settings.episodes,),
        out=run.directory / "table.csv",
    )
    return np.asarray(done.curves.mean_return)[:, -1]


def main(settings: Settings) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "run"
        shutil.copytree(find_run(settings.run), copy)
        run, largest = Run.open(copy), None
        print(HEADING)
        for draws, episodes, adapted in SIZES:
            prior = maesn.PriorSettings(draws=draws, episodes=episodes, adapted=adapted)
            found = returns_with(run, prior, settings)
            largest = found if largest is None else largest
            steps = prior.steps(run.env(), run.training_tasks)
            gain = found - largest
            error = 1.96 * gain.std(ddof=1) / np.sqrt(len(gain))
            print(
                f"{draws:5d} {episodes:13d} {adapted!s:>7} {steps // run.env().horizon:9,d} "
                f"{found.mean():8.1f}  {gain.mean():.1f} ± {error:.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main(tyro.cli(Settings))
