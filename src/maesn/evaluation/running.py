"""A trained run in new tasks: from its directory and an `Evaluation` to curves and their record."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import jax

from maesn.envs import TaskFamily
from maesn.evaluation.evaluate import AdaptationOutcome, adapt, tasks_at_once
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.record import adaptation_record, identity_of_run
from maesn.evaluation.rules import Trained
from maesn.evaluation.tables import read_latents
from maesn.learners import AbstractFastLearner, SavedContexts
from maesn.runs.run import Run
from maesn.runs.shipped import working_copy
from maesn.runs.starting import check_policy
from maesn.storage import RunError
from maesn.worlds import AbstractWorld
from maesn.worlds.collector import Collector


def open_run(run: str | Path | Run, family: str | TaskFamily | None = None) -> Run:
    """Open a run whose directory will be written to.

    Args:
        run: itself, its directory, or the name of a policy that comes with the library, of which a
            copy is made: `maesn-NAME` in the current folder.
        family: the run's family, if it is your own: itself, or `module:name`.
    """
    return run if isinstance(run, Run) else Run.open(working_copy(run), family=family)


@contextmanager
def new_tasks(run: Run, evaluation: Evaluation) -> Iterator[AbstractWorld]:
    """Open the world that a run is evaluated in.

    Raises:
        RunError: there are no such tasks, or the policy cannot play there.
    """
    world = run.world(
        run.task_set(evaluation.tasks),
        evaluation.reward,
        evaluation.engine,
        sparse_radius=evaluation.sparse_radius,
        num_threads=evaluation.num_threads,
    )
    with closing(world):
        check_policy(run.learner, run.latest_state(), world.env)
        yield world


def fast_learner(
    run: Run, evaluation: Evaluation, world: AbstractWorld
) -> AbstractFastLearner[Any]:
    """Return what a run learns with in new tasks; `RunError` if rule and method do not fit."""
    trained = Trained(run.learner, run.latest_state())
    return evaluation.fast_learner(trained, run.settings.method, world.env)


def evaluate(
    run: Run, evaluation: Evaluation, start: Path | None = None
) -> tuple[AdaptationOutcome, dict[str, Any]]:
    """Adapt the latest checkpoint of a run to new tasks.

    Args:
        run: whose.
        evaluation: to what, and how.
        start: latents of an earlier adaptation to the same tasks to go on from.

    Returns:
        The outcome, and the record of what decides it.

    Raises:
        RunError: a setting cannot be used, or not together with another one.
        EpisodeError: an episode went wrong.
    """
    judged = evaluation.deploy_episodes
    with new_tasks(run, evaluation) as world:
        learner = fast_learner(run, evaluation, world)
        outcome = adapt(
            learner,
            Collector(world, evaluation.episodes_per_update),
            episodes=evaluation.episodes,
            deploy=Collector(world, judged) if judged else None,
            seed=evaluation.seed,
            chunk_size=tasks_at_once(
                world.max_simulations,
                max(evaluation.episodes_per_update, judged),
                evaluation.tasks_at_once,
            ),
            saved=None if start is None else _saved_contexts(start, learner, len(world.tasks)),
            tasks=range(evaluation.count(world.tasks)),
        )
        engine = evaluation.engine or run.settings.engine
        first = outcome.first_update
        record = adaptation_record(identity_of_run(run), world, engine, evaluation, first)
    return outcome, record | {"trial_episodes": outcome.trial_episodes}


def _saved_contexts(path: Path, learner: AbstractFastLearner[Any], num_tasks: int) -> SavedContexts:
    if not learner.capabilities.resumes:
        raise RunError(
            f"`{path}` cannot be a start: the latents in it are not all that this method learns in "
            "a task."
        )
    # A start at the prior has no use for keys.
    state = learner.init(jax.random.split(jax.random.key(0), num_tasks))
    latents, updates = read_latents(path, learner.agents(state).context)
    return SavedContexts(latents, updates)
