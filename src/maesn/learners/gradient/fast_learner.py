"""The fast learner of every gradient-based method: policy gradient on a new task."""

from dataclasses import replace
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
from maesn.learners.base import AbstractFastLearner
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
    learned_context: AbstractContext
    step_sizes: StepSizes
    statistics: ObservationStatistics | None = None
    """Of the observations in training; they stay as they are."""

    def init(self, keys: TaskKeys) -> GradientFastState:
        """Return the start in new tasks, one for each key. Nothing about it is random."""
        return self._start(self.context.start_new(self.learned_context, keys.shape[0]))

    def resume(self, context: AbstractContext, update: int = 0) -> GradientFastState:
        """See `AbstractFastLearner.resume`; the count of updates is for the step schedule."""
        if self.adaptation.policy is not None:
            raise ValueError(
                "this run's method adapts the policy as well, and the file holds latents alone."
            )
        return self._start(context, update)

    def paced(self, step_scale: float, full_steps: int | None) -> "GradientFastLearner":
        """See `AbstractFastLearner.paced`."""
        if not self.learns_from_reward:
            raise ValueError("it changes nothing in a task, so it takes no steps.")
        scale = self.schedule.scale * step_scale
        number = self.schedule.full_steps if full_steps is None else full_steps
        return replace(self, schedule=replace(self.schedule, scale=scale, full_steps=number))

    @property
    def is_recurrent(self) -> bool:
        return self.policy.initial_recurrent_state() is not None

    @property
    def learns_from_reward(self) -> bool:
        return self.adaptation.policy is not None or self.adaptation.context is not None

    def _start(self, context: AbstractContext, update: int = 0) -> GradientFastState:
        agents = Agents(self.policy, context, shares_policy=True, statistics=self.statistics)
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
            self.advantage.of_tasks(episodes),
            scale=self.schedule(state.update),
        )
        return GradientFastState(moved, state.update + 1)

    def contexts(self, state: GradientFastState) -> Any:
        """Return the tasks' present contexts, stacked."""
        return state.agents.context
