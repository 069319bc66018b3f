"""Hands a trained policy to a robot: what it starts from, what it is sent, the file it reads."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maesn._version import __version__
from maesn.context import Latent
from maesn.envs.base import AbstractMujocoEnv, AnyEnv
from maesn.learners import AbstractFastLearner
from maesn.reporting.reading import RECORD
from maesn.reporting.runs import Latents, read_record
from maesn.rules import AbstractRule, GradientRule, SearchRule, Trained
from maesn.runs.probing import probe_actuators, probe_sensors
from maesn.runs.run import Run
from maesn.runtime import Actuators, ExportedPolicy, Safeguards
from maesn.runtime import Latent as RuntimeLatent
from maesn.runtime.arrays import float64
from maesn.runtime.exported import ExportedSearch
from maesn.runtime.record import decoded, encoded
from maesn.runtime.return_model import ReturnPrior
from maesn.runtime.safeguards import Limit
from maesn.runtime.search import SearchSettings
from maesn.runtime.storage import Snapshot, write_snapshot
from maesn.search.stored import find_prior
from maesn.settings import check_number
from maesn.storage import RunError, read_json, refusals

# Fields of a model that decide what a robot is sent. Where tasks change them, nobody but the user
# knows which task the robot is in.
_LIMITS = {"actuator_ctrlrange", "actuator_ctrllimited", "opt.disableflags"}
_PERIOD = {"opt.timestep"}


class Stated(NamedTuple):
    """What the user says of the robot, where the simulation does not say it."""

    lower: Limit | None = None  # smallest control of all actuators, or of each; -inf for no limit
    upper: Limit | None = None  # largest control; inf for no limit
    control_period: float | None = None  # seconds between two controls


_NOTHING = Stated()


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
        raise RunError(
            "`rule` must be `gradient`, or `search` without `latents` and `task`; in Python "
            f"`maesn.GradientRule()` or `maesn.SearchRule()`. It is {rule!r}."
        )
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


def write_policy(path: str | os.PathLike[str], policy: ExportedPolicy) -> None:
    """Write what `exported_policy` returns as an `.npz` file; an old one is replaced.

    `ValueError` says that the runtime could not read it, as of damaged latents or a damaged prior.
    """
    decoded(ExportedPolicy, *encoded(policy))
    write_snapshot(path, Snapshot(policy))


def exported_policy(
    learner: AbstractFastLearner[Any],
    env: AnyEnv,
    description: Mapping[str, str | int | float],
    start: tuple[Latent, int] | None = None,
    search: tuple[ReturnPrior, SearchSettings] | None = None,
    *,
    task: Any = None,
    stated: Stated = _NOTHING,
) -> ExportedPolicy:
    """Return a fast learner, and the environment that it acts in, as arrays for the runtime.

    Args:
        learner: the fast learner.
        env: the environment that it was trained in.
        description: what else people should know of the policy.
        start: an adapted latent `[z]` to start from, and the number of updates behind it; None for
            the prior.
        search: the prior and the settings of a search; None for the policy gradient.
        task: one of the training tasks, for what tasks change; None where they change nothing.
        stated: what the user says of the robot.

    Raises:
        ValueError: the runtime cannot learn as this learner does, or the simulation does not say
            what the robot may be sent.
    """
    policy, prior, rule = learner.exported()
    state = learner.init(jax.random.split(jax.random.key(0), 1))
    changed = _changed_by_tasks(env, task)
    latent, update = prior, 0
    if start is not None:
        given, update = start
        latent = RuntimeLatent(float64(given.mean), float64(given.log_std))
    if latent.mean.shape != prior.mean.shape:
        raise ValueError(
            f"the latents have {latent.mean.size} components, but the policy's z has "
            f"{prior.mean.size}; give latents to which this run was adapted."
        )
    return ExportedPolicy(
        policy=policy,
        actuators=_actuators(env, changed, stated),
        sensors=probe_sensors(env, task),
        start=latent,
        start_update=update,
        rule=rule,
        description={
            "family": env.name,
            "horizon": env.horizon,
            "control_period": _control_period(env, changed, stated.control_period),
            "maesn_version": __version__,
            **description,
        },
        search=None if search is None else ExportedSearch(*search, env.horizon),
        # As in an evaluation: where the latent explores, and in deployed episodes, there is none.
        is_noisy={"explore": search is None and learner.agents(state).is_noisy, "deploy": False},
    )


def _changed_by_tasks(env: AnyEnv, task: Any) -> set[str]:
    """Return the names of the model's fields that tasks change."""
    if task is None or not isinstance(env, AbstractMujocoEnv):
        return set()
    return set(env.model_fields(jax.tree.map(jnp.asarray, task)))


def _actuators(env: AnyEnv, changed: set[str], stated: Stated) -> Actuators:
    """Return the map to controls under the tightest limits of environment, model and user."""
    actuators, size = probe_actuators(env), env.action_size
    limits = Safeguards(stated.lower, stated.upper)
    actuators = actuators.narrowed(
        limits.limit("lower", size, -np.inf), limits.limit("upper", size, np.inf)
    )
    if stated.lower is not None and stated.upper is not None:
        return actuators
    how = "say what the robot may be sent: --lower=-1 --upper=1, a number or one for each actuator."
    if changed & _LIMITS:
        raise ValueError(f"the limits of the actuators differ between the tasks: {how}")
    free = (stated.lower is None) & np.isinf(actuators.lower)
    free |= (stated.upper is None) & np.isinf(actuators.upper)
    if free.any():
        index = int(np.argmax(free))
        raise ValueError(
            f"in the simulation, the control of actuator {index} may be anything from "
            f"{actuators.lower[index]:g} to {actuators.upper[index]:g}: {how} Where there is no "
            "limit, say inf."
        )
    return actuators


def _control_period(env: AnyEnv, changed: set[str], stated: float | None) -> float:
    if stated is not None and not 0 < stated < np.inf:
        raise ValueError(f"`control_period` must be positive, got {stated:g}.")
    if changed & _PERIOD:
        if stated is None:
            raise ValueError(
                "the time step differs between the tasks: say how many seconds the robot holds a "
                "control, as in --control-period 0.02."
            )
        return stated
    if stated is not None and not np.isclose(stated, env.control_period):
        raise ValueError(
            f"the policy was trained with a control period of {env.control_period:g} s, not "
            f"{stated:g} s: leave out `control_period`."
        )
    return env.control_period
