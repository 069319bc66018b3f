"""Hands a meta-learned policy to a robot: writes the file that `maesn.runtime` reads."""

import os
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from maesn._version import __version__
from maesn.context import Latent, LatentContext
from maesn.envs.base import AnyEnv
from maesn.learners import AbstractFastLearner, BonusFastLearner, GradientFastLearner
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import GaussianMLPPolicy
from maesn.policies.heads import MINIMUM_STD
from maesn.runtime import Actuators, ExportedPolicy, GaussianPolicy, LearningRule, Safeguards
from maesn.runtime import Latent as RuntimeLatent
from maesn.runtime.storage import Snapshot, write_snapshot

# An action far outside of every range: the control that it leads to is a limit. What grows with
# the action to half that size has none.
_FAR = 1e6
_PROBE_STEP = 2.0**-10  # a power of two, so that the scale is exact in single precision
_NUM_PROBES = 256
_TOLERANCE = 1e-4  # for environments with an offset, where it is not


def export_policy(
    learner: AbstractFastLearner[Any],
    env: AnyEnv,
    path: str | os.PathLike[str],
    description: Mapping[str, str | int | float] | None = None,
    start: tuple[Latent, int] | None = None,
) -> None:
    """Write a fast learner as an `.npz` file of plain arrays.

    Args:
        learner: of a method that adapts a latent alone: `maesn` and `latent_space`.
        env: the environment that it acts in, for the sizes and the map from actions to controls.
        path: of the file; one that exists is replaced.
        description: whatever should be known of the policy on the robot, such as the run and its
            iteration. Family, horizon and control period are added.
        start: adapted latent, `[z]`, that a robot starts from, and the number of updates behind
            it, which the step sizes go on from; None for the prior.

    Raises:
        ValueError: the runtime cannot learn as this learner does, or a number is not finite.
        OSError: the file cannot be written.
    """
    exported = exported_policy(learner, env, description or {}, start)
    write_snapshot(path, Snapshot(exported, None, Safeguards(), None))


def exported_policy(
    learner: AbstractFastLearner[Any],
    env: AnyEnv,
    description: Mapping[str, str | int | float],
    start: tuple[Latent, int] | None = None,
) -> ExportedPolicy:
    """Return what `export_policy` writes; see there."""
    supported = _supported(learner)
    policy, begun = _policy(supported), _start(supported)
    if start is not None:
        begun = _adapted(start[0], begun)
    size = policy.input_size - begun.mean.shape[0]
    if (size, policy.action_size) != (env.observation_size, env.action_size):
        raise ValueError(
            f"`env` must have {size} observations and {policy.action_size} actions as the policy "
            f"has, but `{env.name}` has {env.observation_size} and {env.action_size}; give the "
            "environment that the policy was trained in."
        )
    exported = ExportedPolicy(
        policy=policy,
        actuators=probe_actuators(env),
        start=begun,
        start_update=0 if start is None else start[1],
        rule=_rule(supported),
        description={
            "family": env.name,
            "horizon": env.horizon,
            "control_period": env.control_period,
            "maesn_version": __version__,
            **description,
        },
    )
    _refuse_nonfinite(exported)
    return exported


def probe_actuators(env: AnyEnv) -> Actuators:
    """Return `env.control` as the numbers of clip(offset + scale * action, lower, upper).

    The numbers are read off the function itself, so that no environment states them twice, and
    compared with it on random actions.

    Raises:
        ValueError: the function has another form.
    """
    size = env.action_size
    zeros, step = np.zeros(size), np.full(size, _PROBE_STEP)
    ends = np.stack([_control(env, np.full(size, sign * _FAR)) for sign in (-1.0, 1.0)])
    halves = np.stack([_control(env, np.full(size, sign * _FAR / 2)) for sign in (-1.0, 1.0)])
    limits = np.where(ends == halves, ends, np.copysign(np.inf, ends))
    actuators = Actuators(
        offset=_control(env, zeros),
        scale=(_control(env, step) - _control(env, -step)) / (2 * _PROBE_STEP),
        lower=limits.min(axis=0),
        upper=limits.max(axis=0),
    )
    for action in 2.0 * np.random.default_rng(0).standard_normal((_NUM_PROBES, size)):
        wanted = _control(env, action)
        if not np.allclose(actuators.control(action), wanted, _TOLERANCE, _TOLERANCE):
            raise ValueError(
                f"`env.control` of `{env.name}` must be clip(offset + scale * action, lower, "
                f"upper) for each actuator, but the action {action} becomes {wanted}, where that "
                f"gives {actuators.control(action)}."
            )
    return actuators


def _supported(learner: AbstractFastLearner[Any]) -> GradientFastLearner:
    """Return the learner if the runtime's closed-form update is the learner's own."""
    advice = (
        "a policy can be exported if its latent alone adapts, by the likelihood-ratio gradient: "
        "the methods `maesn` and `latent_space`"
    )
    if isinstance(learner, BonusFastLearner):
        raise ValueError(f"`learner` has a curiosity bonus, which needs a model; {advice}.")
    if not isinstance(learner, GradientFastLearner):
        raise ValueError(f"`learner` is a {type(learner).__name__}; {advice}.")
    if not learner.capabilities.learns_from_reward:
        raise ValueError(f"`learner` adapts nothing in a new task; {advice}.")
    if learner.advantage.drifts:
        raise ValueError(
            "`learner` drifts where all episodes have the same rewards, which the runtime does "
            "not: train it without `advantage.drifts`."
        )
    if not isinstance(learner.context, LatentContext):
        raise ValueError(
            f"`learner` has the context {type(learner.context).__name__}, whose update needs the "
            f"derivative of the policy; {advice}."
        )
    if learner.context.gradient != "likelihood_ratio":
        raise ValueError(
            f"`learner` adapts its latent by the {learner.context.gradient} gradient, which needs "
            f"the derivative of the policy; {advice}."
        )
    if learner.adaptation.policy is not None:
        raise ValueError(f"`learner` adapts the policy's weights in a new task; {advice}.")
    if not isinstance(learner.policy, GaussianMLPPolicy):
        raise ValueError(
            f"`learner` has the policy {type(learner.policy).__name__}; the runtime computes "
            "`GaussianMLPPolicy` alone."
        )
    return learner


def _policy(learner: GradientFastLearner) -> GaussianPolicy:
    assert isinstance(learner.policy, GaussianMLPPolicy)
    weights = [np.asarray(layer.weight, np.float32) for layer in learner.policy.mlp.layers]
    biases = [np.asarray(layer.bias, np.float32) for layer in learner.policy.mlp.layers]
    if learner.statistics is not None:
        weights[0], biases[0] = _with_normalization(learner.statistics, weights[0], biases[0])
    std = np.maximum(np.exp(np.asarray(learner.policy.log_std, np.float64)), MINIMUM_STD)
    return GaussianPolicy(
        weights=tuple(weights),
        biases=tuple(biases),
        std=std,
    )


def _with_normalization(
    statistics: ObservationStatistics, weight: np.ndarray, bias: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fold the normalisation of observations into the first layer.

    With D = diag(1 / scale): ((o - mean) D) W + b = o (D W) + (b - mean D W). So the robot computes
    the same policy without knowing of it. In double precision, because the two parts may cancel.
    """
    mean = np.asarray(statistics.mean, np.float64)
    scaled = weight.astype(np.float64)
    scaled[: len(mean)] /= np.asarray(statistics.scale, np.float64)[:, None]
    shifted = bias - mean @ scaled[: len(mean)]
    return scaled.astype(np.float32), shifted.astype(np.float32)


def _adapted(start: Latent, prior: RuntimeLatent) -> RuntimeLatent:
    found = _latent(start)
    if found.mean.shape != prior.mean.shape:
        raise ValueError(
            f"the latents have {found.mean.size} components, but the policy's z has "
            f"{prior.mean.size}; give latents to which this run was adapted."
        )
    return found


def _start(learner: GradientFastLearner) -> RuntimeLatent:
    """Return the latent that the learner starts a new task from."""
    start = _latent(learner.context.start_new(learner.context_table, 1))
    return RuntimeLatent(start.mean[0], start.log_std[0])


def _latent(value: object) -> RuntimeLatent:
    assert isinstance(value, Latent)
    return RuntimeLatent(np.asarray(value.mean, np.float64), np.asarray(value.log_std, np.float64))


def _rule(learner: GradientFastLearner) -> LearningRule:
    assert learner.adaptation.context is not None
    step = learner.adaptation.context
    if step.learned:
        sizes = _latent(learner.step_sizes.context)
    else:
        fixed = np.full(learner.context_table.size, float(step.initial_size))
        sizes = RuntimeLatent(fixed, fixed)
    scale = float(learner.schedule.scale)
    return LearningRule(
        mean_step=scale * sizes.mean,
        log_std_step=scale * sizes.log_std,
        full_steps=learner.schedule.full_steps,
        factor=float(learner.schedule.factor),
        discount=float(learner.advantage.discount),
        ridge=float(learner.advantage.ridge),
    )


def _control(env: AnyEnv, action: np.ndarray) -> np.ndarray:
    return np.asarray(env.control(jnp.asarray(action, jnp.float32)), np.float64)


def _refuse_nonfinite(exported: ExportedPolicy) -> None:
    limits = ("actuators.lower", "actuators.upper")
    for name, array in exported.arrays().items():
        if name not in limits and not np.isfinite(array).all():
            raise ValueError(
                f"`learner` must hold finite numbers to be exported, but `{name}` does not; "
                "export an earlier checkpoint."
            )
