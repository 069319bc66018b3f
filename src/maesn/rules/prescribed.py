"""The rules of the methods themselves: policy gradient, or no learning at all."""

from typing import Any

from maesn.axes import TaskKeys
from maesn.envs import AnyEnv
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, Capabilities, Purpose
from maesn.rules.base import AbstractRule, Budget, Trained
from maesn.settings import check_number, check_positive


class GradientRule(AbstractRule):
    """The method's own policy gradient, with its own schedule of steps.

    Section "Using the Latent Spaces for Exploration". In a new task latents start at the prior.
    """

    step_scale: float = 1.0
    """Multiplies the sizes of all steps."""
    full_steps: int | None = None
    """Updates with the whole step size, before the sizes shrink (by `schedule.factor`, usually
    1/2); None: as in the run's settings."""
    start_std: float = 1.0
    """Standard deviation of the latent that a new task starts from; 1 is the paper's prior."""

    def __check_init__(self) -> None:
        check_positive(self, "step_scale", "start_std")
        check_number("full_steps", self.full_steps, 1)

    @property
    def label(self) -> str:
        parts = {
            f"steps × {self.step_scale:g}": self.step_scale != 1,
            f"{self.full_steps} full steps": self.full_steps is not None,
            f"start N(0, {self.start_std:g}² I)": self.start_std != 1,
        }
        return "; ".join(text for text, is_so in parts.items() if is_so)

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        changes = self.step_scale, self.full_steps, self.start_std
        return trained.fast_learner().inside(lambda learner: learner.rescheduled(*changes))


class NoAdaptation(AbstractRule):
    """Learn nothing: fresh episodes judge the agents as they started."""

    budget = Budget(episodes=0, per_update=50, deploy=50)
    label = "no adaptation"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        return FixedAgents(trained.fast_learner())


class FixedAgents(AbstractFastLearner[Any]):
    """The agents of a learner before its first update, without any updates."""

    learner: AbstractFastLearner[Any]

    @property
    def capabilities(self) -> Capabilities:
        is_recurrent = self.learner.capabilities.is_recurrent
        return Capabilities(is_recurrent=is_recurrent, learns_from_reward=False)

    def init(self, keys: TaskKeys) -> Any:
        return self.learner.init(keys)

    def agents(self, state: Any, purpose: Purpose = "explore") -> Agents:
        return self.learner.agents(state, purpose)

    def update(self, state: Any, episodes: Episodes) -> Any:
        """Learn nothing."""
        return state
