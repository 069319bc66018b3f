"""The fast learner of every gradient-based method: policy gradient on a new task."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.adaptation import Adaptation, StepSchedule, StepSizes
from maesn.advantage import AdvantageEstimator
from maesn.agent import Agents
from maesn.context import AbstractContext, AbstractContextValue
from maesn.episodes import Episodes
from maesn.learners.base import AbstractFastLearner
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

    context: AbstractContext[Any]
    adaptation: Adaptation
    advantage: AdvantageEstimator
    schedule: StepSchedule
    policy: AbstractPolicy
    learned_context: AbstractContextValue
    step_sizes: StepSizes

    def init(self, num_tasks: int) -> GradientFastState:
        """Return the start in that many new tasks."""
        return self.resume(self.context.start_new(self.learned_context, num_tasks))

    def resume(self, context: AbstractContextValue, update: int = 0) -> GradientFastState:
        """Return a start from given contexts, such as those of an earlier adaptation.

        Args:
            context: one context per task, stacked.
            update: number of updates that led to it, for the step schedule.
        """
        agents = Agents(self.policy, context, shares_policy=True)
        return GradientFastState(agents, jnp.asarray(update))

    def agents(self, state: GradientFastState) -> Agents:
        return state.agents

    @eqx.filter_jit
    def update(self, state: GradientFastState, episodes: Episodes) -> GradientFastState:
        """Take one policy-gradient step in every task."""
        moved = self.adaptation(
            state.agents,
            self.step_sizes,
            self.context,
            episodes,
            jax.vmap(self.advantage)(episodes),
            scale=self.schedule(state.update),
        )
        return GradientFastState(moved, state.update + 1)

    def contexts(self, state: GradientFastState) -> Any:
        """Return the tasks' present contexts, stacked."""
        return state.agents.context
