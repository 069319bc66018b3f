"""The files that adaptation leaves: tables of curves, and beside them latents and a record.

The record says what decides the curves: two that agree in it are the same curves.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from maesn.context import Latent
from maesn.envs import NAMED_SETS, describe_env
from maesn.evaluation.evaluate import AdaptationCurves, AdaptationOutcome, as_rows
from maesn.evaluation.evaluation import Evaluation
from maesn.reporting.reading import LATENTS, RECORD, TableName
from maesn.reporting.runs import Latents, read_record
from maesn.runs.checkpoint import digest_of_arrays
from maesn.runs.run import Run
from maesn.runs.serialization import digest
from maesn.storage import explained, read_arrays, write_arrays, write_json, write_rows
from maesn.worlds import AbstractWorld, EngineName, engine_of


def identity_of_run(run: Run) -> dict[str, str]:
    """Return which learner the latest checkpoint of a run is, and a digest of its weights."""
    learner = f"{run.settings.method} {digest(run.learner)}"
    return {"learner": learner, "weights": digest_of_arrays(run.latest_state())}


def adaptation_record(
    who: Mapping[str, str],
    world: AbstractWorld,
    engine: EngineName,
    evaluation: Evaluation,
    first_update: int = 0,
) -> dict[str, Any]:
    """Return all that decides the curves of an adaptation, as JSON values.

    `who` has the texts `learner` and `weights`, empty for a learner that was not trained before;
    `engine` is the name by which the world's engine was asked for, and `first_update` the number of
    updates that lay before.
    """
    return {
        **who,
        "rule": evaluation.rule_text,
        "label": evaluation.label,
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


def adaptation_file(directory: Path, evaluation: Evaluation, first_update: int = 0) -> Path:
    """Return where a table of adaptation curves goes by default.

    `DIR/adaptation/TASKS-REWARD.csv`, where TASKS is the name of a set, or `file-STEM-DIGEST` for a
    user's own file with a digest of the tasks in it. Before it stands `from-UPDATE-` if an earlier
    adaptation goes on; behind it number of tasks, sparse radius and engine, each where it is not
    the usual one, so that what cannot be compared never shares a figure. Behind the reward stand
    rule and wrappers.
    """
    name = evaluation.tasks
    if name not in NAMED_SETS:
        held = read_arrays(Path(name), "give an .npz file of tasks")
        name = f"file-{Path(name).stem}-{digest_of_arrays(held)[:6]}"
    parts = {
        f"from-{first_update}-{name}" if first_update else name: True,
        f"-first-{evaluation.num_tasks}": evaluation.num_tasks,
        f"-radius-{evaluation.sparse_radius}": evaluation.sparse_radius,
        f"-on-{evaluation.engine}": evaluation.engine,
    }
    tasks = "".join(part for part, given in parts.items() if given)
    return TableName(tasks, evaluation.reward, evaluation.suffix).path(directory)


class Adapted(NamedTuple):
    """What `maesn.adapt` has done."""

    outcome: AdaptationOutcome
    table: Path
    """The curves, a `.csv` file."""
    latents: Path | None
    """The adapted latents, an `.npz` file, `[task, update, z]`; None where none are adapted."""

    @property
    def curves(self) -> AdaptationCurves:
        """The curves that judge the method, `[task, update]` each."""
        return self.outcome.curves


def write_outcome(table: Path, outcome: AdaptationOutcome, record: Mapping[str, Any]) -> Adapted:
    """Write curves as the `.csv` file `table`; beside it the record, and the adapted latents."""
    # In this order: a record never stands beside curves that it does not belong to.
    with explained("replace", table.with_suffix(RECORD)):
        table.with_suffix(RECORD).unlink(missing_ok=True)
    write_rows(table, as_rows(outcome))
    write_json(table.with_suffix(RECORD), dict(record))
    if not isinstance(outcome.contexts, Latent):
        return Adapted(outcome, table, None)
    mean, log_std = map(np.asarray, (outcome.contexts.mean, outcome.contexts.log_std))
    held = Latents(mean, log_std, outcome.first_update)
    write_arrays(table.with_suffix(LATENTS), vars(held))
    return Adapted(outcome, table, table.with_suffix(LATENTS))


def read_latents(path: Path) -> tuple[Latent, int]:
    """Read the last latents of an adaptation, `[task, z]`, and the number of updates behind them.

    A file that cannot be read or is something else is a `RunError`.
    """
    read = read_record(Latents, path, "give a file of latents that `maesn adapt` wrote")
    mean, log_std = (jnp.asarray(x[:, -1], jnp.float32) for x in (read.mean, read.log_std))
    return Latent(mean, log_std), read.first_update + read.mean.shape[1] - 1
