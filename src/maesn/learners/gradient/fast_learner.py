"""The fast learner of every gradient-based method: policy gradient on a new task."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from maesn.axes import TaskKeys
from maesn.context import (
    AbstractContext,
    AbstractContextSettings,
    Latent,
    LatentContext,
    held_at,
)
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.inner.adaptation import Adaptation, StepSchedule, StepSizes
from maesn.inner.advantage import AdvantageEstimator
from maesn.learners.fast import AbstractFastLearner, AbstractSettableLatent, Capabilities, Purpose
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy, GaussianMLPPolicy
from maesn.policies.feed_forward import MINIMUM_STD
from maesn.runtime import ExportedLearner, GaussianPolicy, LearningRule
from maesn.runtime import Latent as RuntimeLatent
from maesn.runtime.arrays import float64


class GradientFastState(eqx.Module):
    """State of a `GradientFastLearner`."""

    agents: Agents
    update: Int[Array, ""]
    """Number of updates so far."""


class GradientFastLearner(AbstractFastLearner[GradientFastState], AbstractSettableLatent):
    """Starts where meta-learning left off and follows the policy gradient.

    Section "Using the Latent Spaces for Exploration": latents start at the prior N(0, I) and move
    with the learned step sizes, while the policy's weights stay.
    """

    context: AbstractContextSettings[Any]
    adaptation: Adaptation
    advantage: AdvantageEstimator
    schedule: StepSchedule
    policy: AbstractPolicy
    context_table: AbstractContext
    step_sizes: StepSizes
    statistics: ObservationStatistics | None = None
    """Statistics of the observations in training. They do not change."""
    start_std: float = 1.0
    """Multiplies the standard deviation of the latents that new tasks start from."""

    def init(self, keys: TaskKeys) -> GradientFastState:
        """Nothing is random."""
        start = self.context.start_new(self.context_table, keys.shape[0]).widened(self.start_std)
        agents = Agents(self.policy, start, shares_policy=True, statistics=self.statistics)
        return GradientFastState(agents, jnp.asarray(0))

    def agents(self, state: GradientFastState, purpose: Purpose = "explore") -> Agents:
        """Return the adapted agents; to be judged, they play the means of their latents."""
        return state.agents.at_mean() if purpose == "deploy" else state.agents

    @property
    def capabilities(self) -> Capabilities:
        policy, context = self.adaptation.policy, self.adaptation.context
        return Capabilities(
            is_recurrent=self.policy.initial_recurrent_state() is not None,
            learns_from_reward=policy is not None or context is not None,
            least_episodes=self.adaptation.least_episodes(self.context),
        )

    @property
    def latent(self) -> "GradientFastLearner | None":
        start = self.context.start_new(self.context_table, 1)
        return self if isinstance(start, Latent) else None

    def rescheduled(
        self, step_scale: float, full_steps: int | None, start_std: float
    ) -> AbstractFastLearner[GradientFastState]:
        if not self.capabilities.learns_from_reward:
            return super().rescheduled(step_scale, full_steps, start_std)
        if start_std != 1 and self.latent is None:
            raise ValueError(
                "`start_std` needs a method with a latent, as `maesn`, `maesn_theta` or "
                "`latent_space`: leave it out."
            )
        before = self.schedule
        schedule = StepSchedule(
            before.full_steps if full_steps is None else full_steps,
            before.factor,
            before.scale * step_scale,
        )
        return replace(self, schedule=schedule, start_std=start_std)

    def exported(self) -> ExportedLearner:
        """Return the arrays of a learner whose own update is the runtime's in closed form."""
        if not (
            isinstance(self.policy, GaussianMLPPolicy)
            and isinstance(self.context, LatentContext)
            and self.context.gradient == "likelihood_ratio"
            and self.adaptation.policy is None
            and self.capabilities.learns_from_reward
            and not self.advantage.drifts
        ):
            raise ValueError(
                "`learner` must adapt a latent alone, by the likelihood-ratio gradient, without a "
                "bonus or `advantage.drifts`: train with the methods `maesn` and `latent_space`."
            )
        context: AbstractContextSettings[Any] = self.context
        start = context.start_new(self.context_table, 1).widened(self.start_std)
        latent = RuntimeLatent(float64(start.mean[0]), float64(start.log_std[0]))
        return ExportedLearner(_exported_policy(self), latent, _exported_rule(self))

    @eqx.filter_jit
    def update(self, state: GradientFastState, episodes: Episodes) -> GradientFastState:
        """Take one policy-gradient step in every task; none if there is nothing to move."""
        if not self.capabilities.learns_from_reward:
            return GradientFastState(state.agents, state.update + 1)
        self.capabilities.check_episodes(episodes.valid.shape[1])
        moved = self.adaptation(
            state.agents,
            self.step_sizes,
            self.context,
            episodes,
            self.advantage.of_tasks(episodes),
            scale=self.schedule(state.update),
        )
        return GradientFastState(moved, state.update + 1)

    @property
    def size(self) -> int:
        return self.context_table.size

    @property
    def spread(self) -> float:
        """Three standard deviations of the prior: adapted latents are that far out."""
        return 3.0

    def holding(self, latents: Float[ArrayLike, "task *episode z"]) -> Agents:
        held = held_at(latents)
        return Agents(self.policy, held, shares_policy=True, statistics=self.statistics)

    def of_tasks(
        self, collect: Collect, keys: TaskKeys, task_index: Int[Array, " task"]
    ) -> Float[np.ndarray, "task z"]:
        """Return the means of the trained latents after one more update."""
        state = self.init(keys)
        trained = self.context.start(self.context_table, task_index)
        state = eqx.tree_at(lambda state: state.agents.context, state, trained)
        episodes = collect(keys, self.agents(state), task_index)
        adapted = self.update(state, episodes).agents.context
        assert isinstance(adapted, Latent)
        return np.asarray(adapted.mean, np.float64)


def _exported_policy(learner: GradientFastLearner) -> GaussianPolicy:
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


def _exported_rule(learner: GradientFastLearner) -> LearningRule:
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
