"""What decides the curves of an adaptation: two that agree in it are the same curves."""

import dataclasses
from typing import Any, NamedTuple

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


def adaptation_record(
    who: Identity,
    world: AbstractWorld,
    engine: EngineName,
    episodes_per_task: int,
    seed: int,
    updates: int,
    first_update: int = 0,
) -> dict[str, Any]:
    """Return all that decides the curves of an adaptation, as JSON values.

    Args:
        who: adapts.
        world: where, to all of its tasks.
        engine: by which name the world's engine was asked for.
        episodes_per_task: episodes per task and update.
        seed: of the episodes.
        updates: number of updates.
        first_update: number of updates that lay before.
    """
    env = world.env
    return {
        "learner": who.learner,
        "weights": who.weights,
        "family": env.name,
        "variant": env.variant,
        "reward": env.reward_kind,
        "sparse_radius": float(env.sparse_radius),
        "engine": engine_of(env, engine),
        "task_digest": world.tasks.digest(),
        "episodes_per_task": episodes_per_task,
        "seed": seed,
        "updates": updates,
        "first_update": first_update,
    }


def identity_of_run(run: Run, added: str = "") -> Identity:
    """Return what the latest checkpoint of a run is.

    Args:
        run: whose.
        added: what is added to its learner in new tasks.
    """
    learner = f"{run.settings.method} {digest(run.learner)}{added}"
    return Identity(learner, digest_of_arrays(run.latest_state()))


def written_out(settings: Any) -> str:
    """Write settings out in full: defaults as well, which may be others in a later version."""
    if not dataclasses.is_dataclass(settings):
        return repr(settings)
    fields = [(field, getattr(settings, field.name)) for field in dataclasses.fields(settings)]
    values = (f"{field.name}={written_out(value)}" for field, value in fields)
    return f"{type(settings).__name__}({', '.join(values)})"
