"""The library's verbs, as functions of Python. The command line calls them, one for one."""

import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn.context import Latent
from maesn.envs import RewardKind, TaskFamily
from maesn.evaluate import AdaptationOutcome
from maesn.evaluate import adapt as adapt_to_tasks
from maesn.explore import explore
from maesn.learners import AbstractMetaLearner, GradientFastLearner, GradientFastState
from maesn.report.plot import plot_run_directories
from maesn.rollout import Collector
from maesn.runs.adaptation_files import (
    adaptation_file,
    read_latents,
    write_arrays,
    write_outcome,
)
from maesn.runs.config import RunSettings
from maesn.runs.export import export_policy
from maesn.runs.progress import train_live
from maesn.runs.run import Run
from maesn.runs.storage import RunError
from maesn.runs.training import init_from as start_from

# Episodes that figures show, and among which the share of goals reached is counted.
EXPLORATION_EPISODES = 50
# Where they are recorded in a run directory.
EXPLORATION = Path("figures") / "exploration.npz"


def train(
    learner: AbstractMetaLearner[Any, Any],
    settings: RunSettings,
    directory: str | Path,
    *,
    init_from: str | Path | None = None,
    family: TaskFamily | None = None,
) -> Run:
    """Meta-train in a new run directory, with a live display.

    Args:
        learner: the method and its settings; see `maesn.PRESETS`.
        settings: of the run.
        directory: must be empty or not exist.
        init_from: directory of a run whose policy and step sizes to start from.
        family: a family of your own; None for the one that `settings.family` names.

    Raises:
        RunError: a setting or the directory cannot be used.
        EpisodeError: an episode went wrong; the last good state is in the directory.
    """
    run = Run.create(directory, learner, settings, family=family)
    if init_from is not None:
        try:
            start_from(run, init_from)
        except RunError:
            shutil.rmtree(run.directory)  # made above, so nothing of the user's is in it
            raise
    train_live(run)
    return run


def resume(
    directory: str | Path, iterations: int | None = None, family: str | TaskFamily | None = None
) -> Run:
    """Go on with a run from its latest checkpoint, bit for bit as if it had never stopped.

    Args:
        directory: of the run.
        iterations: total number of meta-iterations; None for that of the run's settings.
        family: the run's family, if it is your own: itself, or `module:name`.
    """
    run = Run.open(directory, family=family)
    train_live(run, iterations=iterations)
    return run


def adapt(
    directory: str | Path,
    *,
    reward: RewardKind = "sparse",
    updates: int = 10,
    episodes_per_task: int = 50,
    tasks: str = "test",
    seed: int = 0,
    out: str | Path | None = None,
    start: str | Path | None = None,
    family: str | TaskFamily | None = None,
) -> AdaptationOutcome:
    """Adapt a trained policy to new tasks, and write the curves as a table.

    Args:
        directory: of the run; its latest checkpoint is adapted, never the best one.
        reward: dense or sparse.
        updates: policy-gradient updates per task.
        episodes_per_task: episodes per task and update.
        tasks: test (report on these), validation (choose on these), training, ood (unlike all of
            these, where the family has such), or the path of an `.npz` file.
        seed: of the episodes.
        out: path of the table; None for what `adaptation_file` says. The adapted latents are
            written beside it as `.latents.npz`.
        start: an earlier `.latents.npz` of the same tasks to go on from.
        family: the run's family, if it is your own: itself, or `module:name`.
    """
    if updates < 0 or episodes_per_task < 1 or not 0 <= seed < 2**32:
        raise RunError(
            "`updates` must be at least 0, `episodes_per_task` at least 1 and `seed` from 0 to "
            f"2^32 - 1, got {updates}, {episodes_per_task} and {seed}."
        )
    run = Run.open(directory, family=family)
    learner = _gradient_learner(run, run.latest_state())
    collect = Collector(run.world(run.task_set(tasks), reward), episodes_per_task)
    go_on, done = None, 0
    if start is not None:
        latents, done = _latents_to_go_on_from(Path(start), learner, collect.num_tasks)
        go_on = partial(_resume_chunk, learner, latents, done)
    outcome = adapt_to_tasks(
        learner,
        collect,
        updates=updates,
        episodes_per_task=episodes_per_task,
        seed=seed,
        start=go_on,
        first_update=done,
    )
    write_outcome(
        adaptation_file(run.directory, tasks, reward, done) if out is None else Path(out), outcome
    )
    return outcome


def export(directory: str | Path, path: str | Path, family: str | TaskFamily | None = None) -> Path:
    """Write a trained policy as one `.npz` file for `maesn.runtime`.

    Args:
        directory: of the run; its latest checkpoint is exported.
        path: of the file to write.
        family: the run's family, if it is your own: itself, or `module:name`.
    """
    run = Run.open(directory, family=family)
    snapshot = run.latest()
    learner = run.learner.fast_learner(snapshot.state)
    description: dict[str, str | int | float] = {
        "method": run.settings.method,
        "iteration": snapshot.iteration,
    }
    try:
        export_policy(learner, run.env(), path, description)
    except (ValueError, OSError) as error:
        raise RunError(f"`{directory}` cannot be exported to `{path}`: {error}") from error
    return Path(path)


def plot(
    directories: Sequence[str | Path],
    out: str | Path | None = None,
    family: str | TaskFamily | None = None,
) -> list[Path]:
    """Draw the paper's figures from run directories.

    Episodes of exploration are played first, and adaptation to the test tasks on sparse reward
    where no table of it is there yet. A table that is there is drawn as it is: after more
    training, `adapt` renews it.

    Args:
        directories: of the runs, at least one; several are compared in one figure.
        out: where the figures go; None for `figures` in the first directory.
        family: the runs' family, if it is your own: itself, or `module:name`.

    Returns:
        The files that were written, PNG and PDF.
    """
    runs = [Run.open(directory, family=family) for directory in directories]
    for run in runs:
        if not adaptation_file(run.directory, "test", "sparse").exists():
            adapt(run.directory, family=family)
        record_exploration(run)
    first = runs[0].directory / "figures"
    return plot_run_directories(
        [run.directory for run in runs], first if out is None else Path(out)
    )


def record_exploration(run: Run) -> Path:
    """Play and record what the figures of exploration show."""
    tasks, env = run.task_set("test"), run.env()
    collect = Collector(run.world(tasks), EXPLORATION_EPISODES)
    trained = explore(_gradient_learner(run, run.latest_state()), collect)
    untrained = explore(_gradient_learner(run, run.untrained_state()), collect)
    goal = jax.vmap(env.goal)
    arrays = {
        "training_goals": goal(run.training_tasks.tasks),
        "goals": goal(tasks.tasks),
        "sparse_radius": np.asarray(env.sparse_radius),
        "prior_paths": trained.prior_paths,
        "untrained_paths": untrained.prior_paths,
        "prior_latents": trained.prior_latents,
    }
    if trained.fixed_paths is not None:
        arrays["fixed_paths"] = trained.fixed_paths
    path = run.directory / EXPLORATION
    write_arrays(path, arrays)
    return path


def _latents_to_go_on_from(
    path: Path, learner: GradientFastLearner, num_tasks: int
) -> tuple[Latent, int]:
    if learner.adaptation.policy is not None:
        raise RunError(
            f"`{path}` cannot be a start: this run's method adapts the policy as well, and the "
            "file holds latents alone."
        )
    return read_latents(path, learner.init(num_tasks).agents.context)


def _resume_chunk(
    learner: GradientFastLearner, latents: Latent, update: int, slots: np.ndarray
) -> GradientFastState:
    return learner.resume(jax.tree.map(lambda x: x[slots], latents), update)


def _gradient_learner(run: Run, state: Any) -> GradientFastLearner:
    learner = run.learner.fast_learner(state)
    assert isinstance(learner, GradientFastLearner)  # the only kind so far
    return learner
