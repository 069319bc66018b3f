"""A trained run as the file of a robot: which latent it starts from, and how it adapts."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp

from maesn.context import Latent
from maesn.reporting.reading import RECORD
from maesn.reporting.runs import Latents, read_record
from maesn.rules import AbstractRule, GradientRule, SearchRule, Trained
from maesn.runs.export import Stated, exported_policy, write_policy
from maesn.runs.run import Run
from maesn.search.stored import find_prior
from maesn.settings import check_number
from maesn.storage import RunError, read_json, refusals


def export_run(
    run: Run,
    path: Path,
    rule: AbstractRule | None,
    latents: Path | None,
    task: int | None,
    stated: Stated,
) -> None:
    """Write the last checkpoint of a run as `maesn.export` says, whose arguments these are."""
    if path.suffix == ".onnx":
        raise RunError(
            f"`{path}` would be no ONNX file: export an .npz file, and convert it by "
            "examples/policy_to_onnx.py."
        )
    checkpoint, env = run.latest(), run.env()
    about: dict[str, Any] = {"method": run.settings.method, "iteration": checkpoint.iteration}
    start = search = None
    if latents is not None and task is not None:
        start = adapted_latent(run, latents, task)
        about["task"] = task
    elif latents is not None or task is not None:
        raise RunError("`latents` and `task` belong together: give both of them, or none.")
    if type(rule) is SearchRule and start is None:  # a subclass may have another model of returns
        found = find_prior(
            run,
            checkpoint.state,
            run.env("sparse"),
            action_noise=False,
            name=rule.prior,
            any_reward=rule.any_reward,
        )
        search = found, rule.settings
        if not rule.any_reward:
            radius = env.sparse_radius  # 0 where it is not known, as in environments of others
            about["reward"] = "sparse" + (f", within {radius:g} of the goal" if radius else "")
    elif not isinstance(rule, GradientRule | None):
        raise RunError("`rule` must be `gradient`, or `search` without `latents` and `task`.")
    try:
        learner = run.learner.fast_learner(checkpoint.state)
        if isinstance(rule, GradientRule):
            learner = rule.fast_learner(Trained(run.learner, checkpoint.state), env)
        first = run.training_tasks[0]
        exported = exported_policy(learner, env, about, start, search, task=first, stated=stated)
        write_policy(path, exported)
    except (ValueError, OSError) as error:
        raise RunError(f"`{run.directory}` cannot be exported to `{path}`: {error}") from error


def adapted_latent(run: Run, path: Path, task: int) -> tuple[Latent, int]:
    """Return the latent `[z]` that an adaptation found for a task, and the updates behind it.

    `RunError` says that the file is no latents, of other weights than the run's, or lacks the task.
    """
    record = path.with_suffix("").with_suffix(RECORD)
    if record.exists() and read_json(record).get("weights") != run.identity()["weights"]:
        raise RunError(
            f"`{path}` was adapted with other weights than the latest checkpoint of "
            f"`{run.directory}` has: adapt this run, and give the latents that this writes."
        )
    read = read_record(Latents, path, "give a file of latents that `maesn adapt` wrote")
    with refusals():
        check_number("task", task, 0, len(read.mean) - 1)
    mean, log_std = (jnp.asarray(x[task, -1], jnp.float32) for x in (read.mean, read.log_std))
    if (log_std <= Latent.fixed(mean).log_std).all():
        return Latent(mean, jnp.zeros_like(mean)), 0  # a search's point: as from the prior
    return Latent(mean, log_std), read.first_update + read.mean.shape[1] - 1
