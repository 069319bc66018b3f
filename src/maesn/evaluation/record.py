"""What decides the curves of an adaptation: two that agree in it are the same curves."""

from typing import Any, NamedTuple

from maesn.envs import describe_env
from maesn.evaluation.evaluation import Evaluation
from maesn.runs.checkpoint import digest_of_arrays
from maesn.runs.run import Run
from maesn.runs.serialization import digest
from maesn.worlds import AbstractWorld, EngineName, engine_of


class Identity(NamedTuple):
    """What a fast learner is."""

    learner: str
    """Which one, with its settings."""
    weights: str = ""
    """Digest of what it has learned before; empty for nothing."""


def identity_of_run(run: Run) -> Identity:
    """Return what the latest checkpoint of a run is."""
    learner = f"{run.settings.method} {digest(run.learner)}"
    return Identity(learner, digest_of_arrays(run.latest_state()))


def adaptation_record(
    who: Identity,
    world: AbstractWorld,
    engine: EngineName,
    evaluation: Evaluation,
    first_update: int = 0,
) -> dict[str, Any]:
    """Return all that decides the curves of an adaptation, as JSON values.

    Args:
        who: adapts.
        world: where, to all of its tasks.
        engine: by which name the world's engine was asked for.
        evaluation: rule and budgets.
        first_update: number of updates that lay before.
    """
    return {
        "learner": who.learner,
        "weights": who.weights,
        "rule": evaluation.rule_text,
        "world": describe_env(world.env),
        "engine": engine_of(world.env, engine),
        "task_digest": world.tasks.digest(),
        "episodes_per_update": evaluation.budget.per_update,
        "deploy_episodes": evaluation.budget.deploy,
        "deploy_after": list(evaluation.deploy_after),
        "seed": evaluation.seed,
        "num_tasks": evaluation.count(world.tasks),
        "episodes": evaluation.budget.episodes,
        "first_update": first_update,
    }
