"""The library's verbs, as functions of Python. The command line calls them, one for one."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn.context import Latent
from maesn.envs import RewardKind, TaskFamily
from maesn.evaluation.evaluate import AdaptationOutcome, tasks_at_once
from maesn.evaluation.evaluate import adapt as adapt_to_tasks
from maesn.evaluation.exploration import record_exploration
from maesn.evaluation.record import adaptation_record, identity_of_run
from maesn.evaluation.tables import (
    adaptation_file,
    engine_suffix,
    read_latents,
    write_outcome,
)
from maesn.evaluation.test_time import NOTHING_ADDED, AtTestTime
from maesn.learners import AbstractFastLearner, AbstractMetaLearner
from maesn.report.plot import plot_run_directories
from maesn.runs.beginning import begun_state
from maesn.runs.changes import change_run
from maesn.runs.config import RunSettings
from maesn.runs.export import export_policy
from maesn.runs.progress import train_live
from maesn.runs.run import Run
from maesn.runs.shipped import working_copy
from maesn.runs.starting import check_shown
from maesn.storage import RunError
from maesn.worlds import EngineName
from maesn.worlds.collector import Collector


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
        init_from: directory of a run, or name of a policy that comes with the library, whose policy
            and step sizes to start from.
        family: a family of your own; None for the one that `settings.family` names.

    Raises:
        RunError: a setting or the directory cannot be used.
        EpisodeError: an episode went wrong; the last good state is in the directory.
    """
    begin = None if init_from is None else partial(begun_state, source_directory=init_from)
    run = Run.create(directory, learner, settings, family=family, first_state=begin)
    train_live(run)
    return run


def resume(
    run: str | Path | Run,
    iterations: int | None = None,
    family: str | TaskFamily | None = None,
    change: Mapping[str, Any] | None = None,
) -> Run:
    """Go on with a run from its latest checkpoint, bit for bit as if it had never stopped.

    Args:
        run: the run, or its directory.
        iterations: total number of meta-iterations; None for that of the run's settings.
        family: the run's family, if it is your own: itself, or `module:name`.
        change: settings that are to differ from here on, name -> value, which is written down in
            the run; see `maesn.runs.changes.change_run`.

    Raises:
        RunError: there is no such run, or it cannot be changed so.
        EpisodeError: an episode went wrong; the last good state is in the directory.
    """
    run = Run.open(run, family=family)
    if change:
        run = change_run(run, change)
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
    test_time: AtTestTime = NOTHING_ADDED,
    engine: EngineName | None = None,
) -> AdaptationOutcome:
    """Adapt a trained policy to new tasks, and write the curves as a table.

    Args:
        directory: of the run, or the name of a policy that comes with the library, which is adapted
            in a copy, `maesn-NAME` in the current folder. A directory of that name wins. The latest
            checkpoint is adapted, never the best one.
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
        test_time: what is changed about the learner in new tasks: step sizes, curiosity,
            fine-tuning.
        engine: what moves the world; None for the run's own engine.

    Raises:
        RunError: a setting cannot be used, or not together with another one.
        EpisodeError: an episode went wrong.
    """
    if updates < 0 or episodes_per_task < 1 or not 0 <= seed < 2**32:
        raise RunError(
            "`updates` must be at least 0, `episodes_per_task` at least 1 and `seed` from 0 to "
            f"2^32 - 1, got {updates}, {episodes_per_task} and {seed}."
        )
    test_time.check_reached(updates)
    run = Run.open(working_copy(directory), family=family)
    learner = test_time.add_to(run.learner.fast_learner(run.latest_state()), run, run.env())
    go_on, done = None, 0
    with closing(run.world(run.task_set(tasks), reward, engine)) as world:
        check_shown(run.learner.player(run.latest_state()), world.env)
        if start is not None:
            latents, done = _latents_to_go_on_from(Path(start), learner, len(world.tasks))
            go_on = partial(_resume_chunk, learner, latents, done)
        outcome = adapt_to_tasks(
            learner,
            Collector(world, episodes_per_task),
            updates=updates,
            episodes_per_task=episodes_per_task,
            seed=seed,
            chunk_size=tasks_at_once(world.max_simulations, episodes_per_task),
            start=go_on,
            first_update=done,
        )
        record = adaptation_record(
            identity_of_run(run, test_time.written),
            world,
            run.settings.engine if engine is None else engine,
            episodes_per_task,
            seed,
            updates,
            done,
        )
    record["trial_episodes"] = outcome.trial_episodes
    suffix = test_time.suffix + engine_suffix(engine)
    table = adaptation_file(run.directory, tasks, reward, done, suffix)
    write_outcome(table if out is None else Path(out), outcome, record)
    return outcome


def export(directory: str | Path, path: str | Path, family: str | TaskFamily | None = None) -> Path:
    """Write a trained policy as one `.npz` file for `maesn.runtime`.

    Args:
        directory: of the run, or the name of a policy that comes with the library; its latest
            checkpoint is exported.
        path: of the file to write.
        family: the run's family, if it is your own: itself, or `module:name`.
    """
    run = Run.open(directory, family=family)
    checkpoint = run.latest()
    learner = run.learner.fast_learner(checkpoint.state)
    description: dict[str, str | int | float] = {
        "method": run.settings.method,
        "iteration": checkpoint.iteration,
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
        directories: of the runs, at least one, or names of policies that come with the library;
            several are compared in one figure.
        out: where the figures go; None for `figures` in the first directory.
        family: the runs' family, if it is your own: itself, or `module:name`.

    Returns:
        The files that were written, PNG and PDF.
    """
    runs = [Run.open(working_copy(directory), family=family) for directory in directories]
    for run in runs:
        if not adaptation_file(run.directory, "test", "sparse").exists():
            adapt(run.directory, family=family)
        if run.env().planar:
            record_exploration(run)
    first = runs[0].directory / "figures"
    return plot_run_directories(
        [run.directory for run in runs], first if out is None else Path(out)
    )


def _latents_to_go_on_from(
    path: Path, learner: AbstractFastLearner[Any], num_tasks: int
) -> tuple[Latent, int]:
    # A start at the prior has no use for keys.
    state = learner.init(jax.random.split(jax.random.key(0), num_tasks))
    latents, done = read_latents(path, learner.agents(state).context)
    try:
        learner.resume(latents, done)
    except ValueError as error:
        raise RunError(f"`{path}` cannot be a start: {error}") from error
    return latents, done


def _resume_chunk(
    learner: AbstractFastLearner[Any], latents: Latent, update: int, slots: np.ndarray
) -> Any:
    return learner.resume(jax.tree.map(lambda x: x[slots], latents), update)
