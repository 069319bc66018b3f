"""Fine-tuning: after a fast learner has settled, its policy's weights follow the task's gradient.

A rule for new tasks; nothing is trained for it. Any fast learner can be fine-tuned whose policy is
not recurrent. The paper's claim about asymptotic performance rests on it: what the latents cannot
reach, the weights can.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes, concatenate
from maesn.learners.fast import AbstractFastLearner, Capabilities, Purpose
from maesn.learners.scratch.policy_gradient import (
    EVERY_STEP,
    PolicyGradientState,
    PolicyImprovement,
)

LEAST_BATCH = 20
"""Episodes that a step of the weights usually learns from, at least."""


class FineTuningState(eqx.Module):
    """State of `FineTuning`."""

    learner: Any
    tuning: PolicyGradientState | None
    """State of the fine-tuning; None until the learner has had its episodes."""
    keys: TaskKeys
    episodes: Int[Array, ""]
    """Episodes of each task so far."""
    saved: tuple[Episodes, ...] = ()
    """Episodes that the weights have yet to learn from."""


class FineTuning(AbstractFastLearner[FineTuningState]):
    """`after` episodes for a fast learner, then policy gradient on its agents' weights.

    The contexts stay as the learner has left them: z is drawn from the adapted latent in every
    episode, and π(a | o, z) is improved.
    """

    learner: AbstractFastLearner[Any]
    """The learner that adapts first."""
    improvement: PolicyImprovement = PolicyImprovement()
    """The policy gradient method that fine-tunes the weights."""
    after: int = 500
    """Episodes of each task that the learner has before. The update that reaches them is its last
    one. With 50 episodes per update this is ten updates, after which the latents hardly move: the
    reference's steps are halved from the third update on."""
    least_batch: int = LEAST_BATCH
    """Episodes that a step of the weights learns from, at least. Those of smaller updates, as a
    search has them, are saved until there are as many."""

    def __check_init__(self) -> None:
        if self.after < 0:
            raise ValueError(f"`after` must be at least 0 episodes, got {self.after}.")
        can = self.learner.capabilities
        if can.is_recurrent:
            raise ValueError(f"`learner` must not be recurrent: {EVERY_STEP}")
        if can.has_bonus:
            raise ValueError(
                "`learner` must not have a bonus, which the updates after its own would not get: "
                "fine-tune the learner inside of the bonus, by its method `inside`."
            )

    def init(self, keys: TaskKeys) -> FineTuningState:
        return self._next(self.learner.init(keys), keys, jnp.zeros((), int))

    def agents(self, state: FineTuningState, purpose: Purpose = "explore") -> Agents:
        """Return the learner's agents, or those of its contexts and the tuned weights."""
        if state.tuning is None:
            return self.learner.agents(state.learner, purpose)
        agents = state.tuning.agents
        return agents.at_mean() if purpose == "deploy" else agents

    def update(self, state: FineTuningState, episodes: Episodes) -> FineTuningState:
        """Update the learner, or the weights once the learner has had its episodes."""
        count = state.episodes + episodes.valid.shape[1]
        if state.tuning is None:
            return self._next(self.learner.update(state.learner, episodes), state.keys, count)
        saved = (*state.saved, episodes)
        if sum(one.valid.shape[1] for one in saved) < self.least_batch:
            return replace(state, episodes=count, saved=saved)
        tuned = self.improvement(state.tuning, concatenate(*saved))
        return replace(state, tuning=tuned, episodes=count, saved=())

    def adapted(self, state: FineTuningState) -> AbstractContext:
        return self.learner.adapted(state.learner)

    @property
    def capabilities(self) -> Capabilities:
        return self.learner.capabilities._replace(learns_from_reward=True)

    def _next(self, learned: Any, keys: TaskKeys, count: Int[Array, ""]) -> FineTuningState:
        """Return the state after an update of the learner. After its last one, tuning begins."""
        tuning = None
        if int(count) >= self.after:
            # The latents to deploy, not those that a search would try next.
            agents = replace(
                self.learner.agents(learned),
                context=self.learner.adapted(learned),
                is_noisy=True,  # policy gradient learns from the noise, which a search does without
            )
            tuning = self.improvement.begin(keys, agents)
        return FineTuningState(learned, tuning, keys, count)
