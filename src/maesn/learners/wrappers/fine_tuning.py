"""Fine-tuning: after a fast learner has settled, its policy's weights follow the task's gradient.

A rule for test time, which any fast learner without memory can be given; nothing is trained for it.
It is what the paper's claim about asymptotic performance means: what the latents cannot reach, the
weights can.
"""

from dataclasses import replace
from typing import Any, Generic

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import TaskKeys
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes, TrialState
from maesn.learners.base import AbstractFastLearner, FastState
from maesn.learners.scratch.policy_gradient import (
    PolicyGradientState,
    PolicyImprovement,
    refuse_recurrent,
)


class FineTuningState(eqx.Module, Generic[FastState]):
    """State of `FineTuning`: of the learner, and of what goes on from it."""

    learner: FastState
    tuning: PolicyGradientState | None
    """None until the learner has done its updates."""
    keys: TaskKeys
    update: Int[Array, ""]
    """Number of updates so far, both kinds together."""


class FineTuning(AbstractFastLearner[FineTuningState[Any]]):
    """`after` updates of a fast learner, then policy gradient on its agents' weights.

    The contexts stay as the learner has left them: z is drawn from the adapted latent in every
    episode, and π(a | o, z) is improved.
    """

    learner: AbstractFastLearner[Any]
    """Adapts first."""
    improvement: PolicyImprovement = PolicyImprovement()
    """How the weights follow their experience afterwards."""
    after: int = 10
    """Updates of the learner. The reference's steps are halved from the third update on: after ten
    of them the latents stand still."""

    def __check_init__(self) -> None:
        if self.after < 0:
            raise ValueError(f"`after` must be at least 0, got {self.after}.")
        refuse_recurrent("learner", self.learner)
        if self.learner.has_bonus:
            raise ValueError(
                "`learner` must not be curious, because the updates after its own would not be "
                "paid: fine-tune who is paid, by `learner.inside`."
            )

    def init(self, keys: TaskKeys) -> FineTuningState[Any]:
        state = FineTuningState(self.learner.init(keys), None, keys, jnp.zeros((), int))
        return state if self.after else replace(state, tuning=self._begin(state))

    def agents(self, state: FineTuningState[Any]) -> Agents:
        return self.learner.agents(state.learner) if state.tuning is None else state.tuning.agents

    def memory(self, state: FineTuningState[Any]) -> TrialState | None:
        return self.learner.memory(state.learner) if state.tuning is None else None

    def update(self, state: FineTuningState[Any], episodes: Episodes) -> FineTuningState[Any]:
        """Let the learner learn, or go on from where it stands."""
        learner, tuning, done = state.learner, state.tuning, state.update + 1
        if tuning is not None:
            tuned = self.improvement(tuning, episodes)
            return FineTuningState(learner, tuned, state.keys, done)
        learned = FineTuningState(self.learner.update(learner, episodes), None, state.keys, done)
        if int(done) < self.after:
            return learned
        return FineTuningState(learned.learner, self._begin(learned), state.keys, done)

    def _begin(self, state: FineTuningState[Any]) -> PolicyGradientState:
        return self.improvement.begin(state.keys, self.learner.agents(state.learner))
