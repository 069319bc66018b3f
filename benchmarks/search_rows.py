"""The rows behind `search_tables.py`: one run, one line, one seed, adapted to all tasks of a set.

A row is a small file, by name, with a line for each task and number of episodes. A file that is
there is finished.
"""

import csv
import dataclasses
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from maesn.evaluation.adapting import AdaptationOutcome, adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import new_tasks
from maesn.rules import SearchRule, from_text
from maesn.runs.run import Run
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.runtime.search import SearchSettings
from maesn.search import PriorSettings, latent_of, play_archive
from maesn.search.learner import SearchFastLearner
from maesn.search.stored import prior_file, read_prior, run_prior
from maesn.worlds.collector import Collector

JUDGED_AFTER = (0, 1, 2, 3, 5, 10, 20, 50, 100, 200, 500)
DEPLOYED = 20  # fresh episodes that judge a deployed latent
ARCHIVE_EPISODES = 8  # of each latent, for the ceiling and the coverage: half select, half judge
SIMULATIONS = 2000  # at once; bounds the memory


@dataclasses.dataclass(frozen=True)
class Line:
    """What is done in new tasks."""

    rule: str = "search"
    """As behind `--rule`."""
    episodes: int = 20
    per_update: int = 1
    seeds: int = 1
    """Their number; a seed is one of the episodes, not of the training."""
    tasks: str = ""
    """Another task set than the one that is asked for."""
    change: Callable[[ReturnModel, SearchSettings], Any] | None = None
    """What a control puts in the place of the model of returns."""
    prior: tuple[Any, float] | None = None
    """Reward, and radius as a share of that of the test, that a control makes its prior with."""


def permuted(model: ReturnModel, settings: SearchSettings) -> ReturnModel:
    """Return the model with each latent's returns permuted over tasks, independently."""
    generator = np.random.default_rng(0)
    mixed = generator.permuted(model.prior.excess, axis=0)
    return settings.model(dataclasses.replace(model.prior, excess=mixed))


def private_copy(name: str, source: str | Path, out: Path) -> Run:
    """Return a copy of a run, to which priors can be added.

    Args:
        name: of the copy.
        source: a run, or the name of a policy that comes with the library. `untrained:SOURCE` is
            the same before its first meta-iteration.
        out: where copies are.
    """
    directory = out / "runs" / name
    if not directory.exists():
        opened = Run.open(str(source).removeprefix("untrained:"))
        if str(source).startswith("untrained:"):
            Run.create(directory, opened.learner, dataclasses.replace(opened.settings))
        else:
            shutil.copytree(opened.directory, directory)
    return Run.open(directory)


def evaluation(
    run: Run, line: Line, tasks: str, num_tasks: int | None, seed: int, num_threads: int
) -> Evaluation:
    """Return what a line does in new tasks."""
    rule = from_text("rule", line.rule)
    if line.prior is not None:
        reward, share = line.prior
        radius = share * run.env().sparse_radius
        with closing(run.world(reward_kind=reward, sparse_radius=radius)) as world:
            path = prior_file(run, world.env)
        if not path.exists():
            run_prior(run, reward=reward, sparse_radius=radius)
        rule = SearchRule(prior=str(path), any_reward=True)
    reached = range(0, line.episodes + 1, line.per_update)
    return Evaluation(
        tasks=line.tasks or tasks,
        num_tasks=num_tasks,
        rule=rule,
        episodes=line.episodes,
        episodes_per_update=line.per_update,
        deploy_episodes=DEPLOYED,
        deploy_after=tuple(count for count in JUDGED_AFTER if count in reached),
        seed=seed,
        num_threads=num_threads,
        tasks_at_once=SIMULATIONS // max(line.per_update, DEPLOYED),
    )


def adapted_rows(run: Run, line: Line, asked: Evaluation) -> Iterator[dict[str, Any]]:
    """Adapt to the tasks; yield the rows of the file."""
    with new_tasks(run, asked) as (world, prescribed):
        learner: Any = prescribed
        if line.change is not None:
            assert isinstance(learner, SearchFastLearner)
            model = line.change(learner.model, learner.settings)
            learner = dataclasses.replace(learner, model=model)
        outcome = adapt(learner, Collector(world, line.per_update), asked)
    yield from _rows(outcome, line, asked.deploy_after)


def _rows(outcome: AdaptationOutcome, line: Line, counts: Iterable[int]) -> Iterator[Any]:
    explored, deployed = outcome.explored, outcome.deployed
    assert deployed is not None
    for task in range(len(explored.mean_return)):
        for count in counts:
            update = count // line.per_update
            before = explored.mean_return[task, :update]
            yield {
                "task": task,
                "episodes": count,
                "deployed": deployed.mean_return[task, update],
                "success": deployed.success_rate[task, update],
                "at_reset": deployed.solved_at_reset[task, update],
                "drawn": explored.mean_return[task, update],
                "drawn_success": explored.success_rate[task, update],
                "searching": before.mean() if update else np.nan,
                "reached": float((explored.success_rate[task, :update] > 0).any()),
            }


def archive_returns(run: Run, tasks: str, out: Path) -> tuple[ReturnPrior, np.ndarray, np.ndarray]:
    """Play the archive of a run in the tasks; kept in a file.

    Returns:
        The prior of the run; returns and lengths, `[task, latent, episode]`.
    """
    with closing(run.world(run.task_set(tasks), "sparse")) as world:
        prior, _ = read_prior(prior_file(run, world.env))
        path = out / f"{run.directory.name}-archive.npz"
        if not path.exists():
            latent = latent_of(run.learner.fast_learner(run.latest_state()))
            settings = PriorSettings(episodes=ARCHIVE_EPISODES, seed=1)
            returns, length = play_archive(latent, world, prior.latents, settings)
            np.savez_compressed(path, returns=np.float32(returns), length=np.float32(length))
    with np.load(path) as kept:
        return prior, np.float64(kept["returns"]), np.float64(kept["length"])


def ceiling_rows(returns: np.ndarray) -> Iterator[dict[str, Any]]:
    """Yield what the archive's best latent returns: selected on half, judged on the other half."""
    half = returns.shape[-1] // 2
    halves = returns[..., :half].mean(-1), returns[..., half:].mean(-1)
    best = [np.take_along_axis(b, a.argmax(1)[:, None], 1) for a, b in (halves, halves[::-1])]
    for task, value in enumerate(np.mean(best, axis=0)[:, 0]):
        yield {"task": task, "episodes": 0, "deployed": value}


def write_row(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a finished row."""
    found = list(rows)
    partial = path.with_suffix(".partial")
    with partial.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(found[0]), lineterminator="\n")
        writer.writeheader()
        for row in found:
            writer.writerow({n: f"{v:.5g}" if isinstance(v, float | np.floating) else v
                             for n, v in row.items()})  # fmt: skip
    partial.replace(path)


def read_row(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a row, `[task, count]` each."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    tasks = len({row["task"] for row in rows})
    return {
        name: np.array([float(row[name]) for row in rows]).reshape(tasks, -1) for name in rows[0]
    }
