"""Hands a meta-learned policy to a robot: writes the file that `maesn.runtime` reads."""

import os
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from maesn._version import __version__
from maesn.context import Latent
from maesn.envs.base import AnyEnv
from maesn.learners import AbstractFastLearner
from maesn.runtime import Actuators, ExportedPolicy, Safeguards
from maesn.runtime import Latent as RuntimeLatent
from maesn.runtime.exported_search import ExportedSearch
from maesn.runtime.return_model import ReturnPrior
from maesn.runtime.search import SearchSettings
from maesn.runtime.storage import Snapshot, write_snapshot

# An action far outside of every range: the control that it leads to is a limit. What grows with
# the action to half that size has none.
_FAR = 1e6
_PROBE_STEP = 2.0**-10  # a power of two, so that the scale is exact in single precision
_NUM_PROBES = 256
_TOLERANCE = 1e-4  # for environments with an offset, where it is not


def write_policy(path: str | os.PathLike[str], policy: ExportedPolicy) -> None:
    """Write what `exported_policy` returns as an `.npz` file, in place of any that is there."""
    write_snapshot(path, Snapshot(policy, None, Safeguards(), None))


def exported_policy(
    learner: AbstractFastLearner[Any],
    env: AnyEnv,
    description: Mapping[str, str | int | float],
    start: tuple[Latent, int] | None = None,
    search: tuple[ReturnPrior, SearchSettings] | None = None,
) -> ExportedPolicy:
    """Return a fast learner, and the environment that it acts in, as arrays for the runtime.

    A robot starts from `start`, an adapted latent `[z]` and the number of updates behind it; None
    for the prior. It searches with this prior and these settings; None for the policy gradient.

    Raises:
        ValueError: the runtime cannot learn as this learner does.
    """
    policy, prior, rule = learner.exported()
    latent, update = prior, 0
    if start is not None:
        given, update = start
        latent = RuntimeLatent(_float64(given.mean), _float64(given.log_std))
    if latent.mean.shape != prior.mean.shape:
        raise ValueError(
            f"the latents have {latent.mean.size} components, but the policy's z has "
            f"{prior.mean.size}; give latents to which this run was adapted."
        )
    return ExportedPolicy(
        policy=policy,
        actuators=probe_actuators(env),
        start=latent,
        start_update=update,
        rule=rule,
        description={
            "family": env.name,
            "horizon": env.horizon,
            "control_period": env.control_period,
            "maesn_version": __version__,
            **description,
        },
        search=None if search is None else ExportedSearch(*search, env.horizon),
    )


def probe_actuators(env: AnyEnv) -> Actuators:
    """Return `env.control` as the numbers of clip(offset + scale * action, lower, upper).

    They are read off the function itself, and compared with it on random actions: `ValueError` if
    it has another form.
    """

    def control(action: np.ndarray | float) -> np.ndarray:
        return _float64(env.control(jnp.full(env.action_size, action, jnp.float32)))

    far, half = (np.stack([control(-x), control(x)]) for x in (_FAR, _FAR / 2))
    limits = np.where(far == half, far, np.copysign(np.inf, far))
    actuators = Actuators(
        offset=control(0.0),
        scale=(control(_PROBE_STEP) - control(-_PROBE_STEP)) / (2 * _PROBE_STEP),
        lower=limits.min(axis=0),
        upper=limits.max(axis=0),
    )
    for action in 2.0 * np.random.default_rng(0).standard_normal((_NUM_PROBES, env.action_size)):
        wanted = control(action)
        if not np.allclose(actuators.control(action), wanted, _TOLERANCE, _TOLERANCE):
            raise ValueError(
                f"`env.control` of `{env.name}` must be clip(offset + scale * action, lower, "
                f"upper) for each actuator, but the action {action} becomes {wanted}."
            )
    return actuators


def _float64(values: Any) -> np.ndarray:
    return np.asarray(values, np.float64)
