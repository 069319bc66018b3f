"""A latent that follows the policy gradient, in the form of the NumPy runtime."""

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from maesn.context import AbstractContextSettings, LatentContext
from maesn.policies import GaussianMLPPolicy
from maesn.policies.heads import MINIMUM_STD
from maesn.runtime import ExportedLearner, GaussianPolicy, LearningRule
from maesn.runtime import Latent as RuntimeLatent
from maesn.runtime.arrays import float64

if TYPE_CHECKING:
    from maesn.learners.gradient.fast_learner import GradientFastLearner


def exported_learner(learner: "GradientFastLearner") -> ExportedLearner:
    """Return the arrays of a learner whose own update is the runtime's in closed form.

    Raises:
        ValueError: it is another one.
    """
    if not (
        isinstance(learner.policy, GaussianMLPPolicy)
        and isinstance(learner.context, LatentContext)
        and learner.context.gradient == "likelihood_ratio"
        and learner.adaptation.policy is None
        and learner.capabilities.learns_from_reward
        and not learner.advantage.drifts
    ):
        raise ValueError(
            "`learner` must adapt a latent alone, by the likelihood-ratio gradient, without a "
            "bonus or `advantage.drifts`: train with the methods `maesn` and `latent_space`."
        )
    context: AbstractContextSettings[Any] = learner.context
    start = context.start_new(learner.context_table, 1).widened(learner.start_std)
    prior = jax.tree.map(lambda x: x[0], start)
    latent = RuntimeLatent(float64(prior.mean), float64(prior.log_std))
    return ExportedLearner(_policy(learner), latent, _rule(learner))


def _policy(learner: "GradientFastLearner") -> GaussianPolicy:
    assert isinstance(learner.policy, GaussianMLPPolicy)
    weights = [np.asarray(layer.weight) for layer in learner.policy.mlp.layers]
    biases = [np.asarray(layer.bias) for layer in learner.policy.mlp.layers]
    if learner.statistics is not None:
        # Observations are normalised by the first layer. With D = diag(1 / scale):
        # ((o - mean) D) W + b = o (D W) + (b - mean D W).
        # In double precision, because the two parts may cancel.
        mean, scaled = float64(learner.statistics.mean), float64(weights[0]).copy()
        scaled[: len(mean)] /= float64(learner.statistics.scale)[:, None]
        weights[0], biases[0] = scaled, biases[0] - mean @ scaled[: len(mean)]
    return GaussianPolicy(
        weights=tuple(weight.astype(np.float32) for weight in weights),
        biases=tuple(bias.astype(np.float32) for bias in biases),
        std=np.maximum(np.exp(float64(learner.policy.log_std)), MINIMUM_STD),
    )


def _rule(learner: "GradientFastLearner") -> LearningRule:
    step = learner.adaptation.context
    assert step is not None
    fixed, learned = float(step.initial_size), learner.step_sizes.context
    mean, log_std = (learned.mean, learned.log_std) if step.learned else (fixed, fixed)
    size, scale = learner.context_table.size, float(learner.schedule.scale)
    return LearningRule(
        mean_step=scale * np.full(size, float64(mean)),
        log_std_step=scale * np.full(size, float64(log_std)),
        full_steps=learner.schedule.full_steps,
        factor=float(learner.schedule.factor),
        discount=float(learner.advantage.discount),
        ridge=float(learner.advantage.ridge),
    )
