"""A trained run in new tasks: from what a user names to curves, and to the files of them.

Beside a table of curves stand the latents and a record, which says what decides the curves: two
that agree in it are the same curves. The prior of a search is the run's own unless its rule names
another file; how it was made is not in the record.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maesn.context import Latent
from maesn.envs import NAMED_SETS, describe_env
from maesn.evaluation.adapting import AdaptationCurves, AdaptationOutcome, adapt, as_rows
from maesn.evaluation.arguments import AnyFamily, AnyMethod, AnyRun
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import AbstractFastLearner
from maesn.reporting.reading import LATENTS, RECORD, TableName
from maesn.reporting.runs import Latents
from maesn.rules import Trained
from maesn.runs.checkpoint import digest_of_arrays
from maesn.runs.run import Run
from maesn.runs.sources import working_copy
from maesn.search.stored import find_prior
from maesn.storage import (
    read_arrays,
    write_arrays,
    write_json,
    write_rows,
)
from maesn.worlds import AbstractWorld, check_policy
from maesn.worlds.collector import Collector


def open_run(run: AnyRun, family: AnyFamily = None, method: AnyMethod = None) -> Run:
    """Open a run whose directory will be written to; of a policy with the library, a copy."""
    copy = working_copy(run.directory if isinstance(run, Run) else run)
    if isinstance(run, Run) and copy == run.directory:
        return run
    return Run.open(copy, family, method)


@contextmanager
def new_tasks(
    run: Run, evaluation: Evaluation, state: Any = None
) -> Iterator[tuple[AbstractWorld, AbstractFastLearner[Any]]]:
    """Open the world that a run is evaluated in, and say what learns there.

    `state` is one of the run's; None: the latest.
    """
    state = run.latest_state() if state is None else state
    world = run.world(
        run.task_set(evaluation.tasks),
        evaluation.reward,
        sparse_radius=evaluation.sparse_radius,
        num_threads=evaluation.num_threads,
    )
    with closing(world):
        check_policy(run.learner.player(state), world.env)
        of_run = partial(find_prior, run, state, world.env, evaluation.action_noise)
        trained = Trained(run.learner, state, of_run, evaluation.budget.per_update)
        yield world, evaluation.fast_learner(trained, run.settings.method, world.env)


def evaluate(
    run: Run, evaluation: Evaluation, tasks: Sequence[int] | None = None
) -> tuple[AdaptationOutcome, dict[str, Any]]:
    """Adapt a run to new tasks as `maesn.adapt` says; return the outcome, and its record.

    `tasks` are indices of some of them; None for all that `evaluation` says.
    """
    budget, known = evaluation.budget, {}
    state = run.latest_state()  # once: the run may be training
    with new_tasks(run, evaluation, state) as (world, learner):
        outcome = adapt(learner, Collector(world, budget.per_update), evaluation, tasks=tasks)
    if evaluation.tasks != "training" and world.tasks.digest() == run.config.task_digest:
        known = {"trained_on": True}
    return outcome, {
        **known,
        **run.identity(state),
        **evaluation.protocol_record,
        "rule": evaluation.rule_text,
        "label": evaluation.label,
        "world": describe_env(world.env),
        "task_digest": world.tasks.digest(),
        "episodes_per_update": budget.per_update,
        "deploy_episodes": budget.deploy,
        "deploy_after": list(evaluation.deploy_after),
        "action_noise": evaluation.action_noise,
        "seed": evaluation.seed,
        "num_tasks": evaluation.count(world.tasks),
        "episodes": budget.episodes,
        "trial_episodes": outcome.trial_episodes,
    }


def adaptation_file(directory: Path, evaluation: Evaluation) -> Path:
    """Return where a table of adaptation curves goes by default, `DIR/adaptation/TASKS-REWARD.csv`.

    TASKS is the name of a set, or `file-STEM-DIGEST` for a user's own file. Behind it stand number
    of tasks and sparse radius where they are not the usual ones: those never share a figure. Behind
    the reward stand rule and wrappers, then budgets, seed and noise where they are not the usual
    ones, as in `test-sparse-with-100-episodes-seed-1.csv`: other numbers have another name.
    """
    name = evaluation.tasks
    if name not in NAMED_SETS:
        held = read_arrays(Path(name), "give an .npz file of tasks")
        name = f"file-{Path(name).stem}-{digest_of_arrays(held)[:6]}"
    if evaluation.num_tasks:
        name += f"-first-{evaluation.num_tasks}"
    if evaluation.sparse_radius:
        name += f"-radius-{evaluation.sparse_radius}"
    budget = "-with-" + "-".join(_unusual(evaluation))
    named = TableName(name, evaluation.reward, evaluation.suffix, budget.removesuffix("-with-"))
    return named.path(directory)


def _unusual(evaluation: Evaluation) -> Iterator[str]:
    """Yield in words what budgets and seed are not the usual ones."""
    words = ("episodes", "per-update", "deployed")
    usual = evaluation.usual_budget
    for word, number, expected in zip(words, evaluation.budget, usual, strict=True):
        if number != expected:
            yield f"{number}-{word}"
    if evaluation.deploy_after:
        yield "-".join(map(str, ("after", *evaluation.deploy_after)))
    if evaluation.seed:
        yield f"seed-{evaluation.seed}"
    if evaluation.action_noise:
        yield "action-noise"


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
    """Write curves as the `.csv` file `table`; beside it the record, and the adapted latents.

    If the record names a protocol, each row does as well.
    """
    # In this order: a record never stands beside curves or latents that it does not belong to.
    table.with_suffix(RECORD).unlink(missing_ok=True)
    named = {name: record[name] for name in ("protocol",) if name in record}
    write_rows(table, ({**row, **named} for row in as_rows(outcome)))
    held, latents = held_latents(outcome), None
    if held is not None:
        latents = table.with_suffix(LATENTS)
        write_arrays(latents, vars(held))
    write_json(table.with_suffix(RECORD), dict(record))
    return Adapted(outcome, table, latents)


def held_latents(outcome: AdaptationOutcome) -> Latents | None:
    """Return the adapted latents as files hold them; None where none are adapted."""
    if not isinstance(outcome.contexts, Latent):
        return None
    mean, log_std = map(np.asarray, (outcome.contexts.mean, outcome.contexts.log_std))
    return Latents(mean, log_std, first_update=0)
