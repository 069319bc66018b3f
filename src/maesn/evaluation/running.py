"""A trained run in new tasks, from what a user names to curves and their record."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import jax

from maesn.context import Latent
from maesn.evaluation.arguments import AnyFamily, AnyRun
from maesn.evaluation.evaluate import AdaptationOutcome, adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.tables import adaptation_record, read_latents
from maesn.learners import AbstractFastLearner, SavedContexts
from maesn.rules import Trained
from maesn.runs.run import Run
from maesn.runs.sources import working_copy
from maesn.search.stored import find_prior
from maesn.storage import RunError, refuse_links
from maesn.worlds import AbstractWorld, check_policy
from maesn.worlds.collector import Collector


def open_run(run: AnyRun, family: AnyFamily = None) -> Run:
    """Open a run whose directory will be written to; of a policy with the library, a copy."""
    opened = run if isinstance(run, Run) else Run.open(working_copy(run), family=family)
    refuse_links(opened.directory)
    return opened


@contextmanager
def new_tasks(
    run: Run, evaluation: Evaluation
) -> Iterator[tuple[AbstractWorld, AbstractFastLearner[Any]]]:
    """Open the world that a run is evaluated in, and say what learns there."""
    world = run.world(
        run.task_set(evaluation.tasks),
        evaluation.reward,
        evaluation.engine,
        sparse_radius=evaluation.sparse_radius,
        num_threads=evaluation.num_threads,
    )
    with closing(world):
        state = run.latest_state()
        check_policy(run.learner.player(state), world.env)
        trained = Trained(run.learner, state, partial(find_prior, run, state, world))
        yield world, evaluation.fast_learner(trained, run.settings.method, world.env)


def evaluate(
    run: Run,
    evaluation: Evaluation,
    start: Path | None = None,
    tasks: Sequence[int] | None = None,
) -> tuple[AdaptationOutcome, dict[str, Any]]:
    """Adapt a run to new tasks as `maesn.adapt` says; return the outcome, and its record.

    `tasks` are indices of some of them; None for all that `evaluation` says.
    """
    with new_tasks(run, evaluation) as (world, learner):
        saved = None if start is None else _saved_contexts(start, learner, len(world.tasks))
        outcome = play(world, learner, evaluation, saved, tasks)
        return outcome, adaptation_record(run, world, evaluation, outcome)


def play(
    world: AbstractWorld,
    learner: AbstractFastLearner[Any],
    evaluation: Evaluation,
    saved: SavedContexts | None = None,
    tasks: Sequence[int] | None = None,
) -> AdaptationOutcome:
    """Adapt a fast learner in a world, with the budgets of an evaluation; see `evaluate`."""
    budget = evaluation.budget
    return adapt(
        learner,
        Collector(world, budget.per_update),
        episodes=budget.episodes,
        deploy=Collector(world, budget.deploy) if budget.deploy else None,
        deploy_after=evaluation.deploy_after,
        seed=evaluation.seed,
        chunk_size=evaluation.tasks_at_once,
        saved=saved,
        tasks=range(evaluation.count(world.tasks)) if tasks is None else tasks,
    )


def _saved_contexts(path: Path, learner: AbstractFastLearner[Any], num_tasks: int) -> SavedContexts:
    # A start at the prior has no use for keys.
    state = learner.init(jax.random.split(jax.random.key(0), num_tasks))
    wanted = learner.agents(state).context
    if not (learner.capabilities.resumes and isinstance(wanted, Latent)):
        raise RunError(
            f"`{path}` cannot be a start: the latents in it are not all that this method learns in "
            "a task."
        )
    latents, updates = read_latents(path)
    if latents.mean.shape != wanted.mean.shape:
        raise RunError(
            f"`{path}` holds latents of the shape [task, z] = {list(latents.mean.shape)}, but "
            f"{list(wanted.mean.shape)} are to be adapted: give the task set and the run of before."
        )
    return SavedContexts(latents, updates)
