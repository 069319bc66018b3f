"""The fast learner of every gradient-based method: policy gradient on a new task."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import TaskKeys
from maesn.context import AbstractContext, AbstractContextSettings
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.inner.adaptation import Adaptation, StepSchedule, StepSizes
from maesn.inner.advantage import AdvantageEstimator
from maesn.learners.base import AbstractFastLearner, Capabilities, Purpose
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy


class GradientFastState(eqx.Module):
    """State of a `GradientFastLearner`."""

    agents: Agents
    update: Int[Array, ""]
    """Number of updates so far."""


class GradientFastLearner(AbstractFastLearner[GradientFastState]):
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
        """See `AbstractFastLearner.init`. Nothing is random."""
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

    @eqx.filter_jit
    def update(self, state: GradientFastState, episodes: Episodes) -> GradientFastState:
        """Take one policy-gradient step in every task."""
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
