"""Rules: what happens in a new task.

A rule turns what meta-training has made into a fast learner. Wrappers add to any rule: fine-tuning
of the policy's weights, or a bonus on the rewards. Both are frozen settings, and both are open: a
class of your own takes part like those below, given as an object or as `module:name`.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from maesn.axes import TaskKeys
from maesn.envs import AnyEnv
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import (
    AbstractFastLearner,
    AbstractMetaLearner,
    BonusFastLearner,
    Capabilities,
    FineTuning,
    GradientFastLearner,
    GradientStep,
    PolicyImprovement,
    Purpose,
    SavedContexts,
    inside,
)
from maesn.learners.scratch.policy_gradient import TRPO
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.runtime.return_model import ReturnPrior


class Trained(NamedTuple):
    """What meta-training has made."""

    learner: AbstractMetaLearner[Any, Any]
    """The method and its settings."""
    state: Any
    """What it has learned."""
    return_prior: Callable[[str, bool], ReturnPrior] | None = None
    """Returns the prior of a search: that of a file, or the run's own for an empty name; and
    whether it may have been made for another reward. None where there is no run."""

    def fast_learner(self) -> AbstractFastLearner[Any]:
        """Return the learner of new tasks that the method itself prescribes."""
        return self.learner.fast_learner(self.state)


class Budget(NamedTuple):
    """Numbers of episodes of each task."""

    episodes: int
    """That are learned from, in all."""
    per_update: int
    """That an update learns from."""
    deploy: int
    """That judge the deployed agent at a time."""


GRADIENT_BUDGET = Budget(500, 50, 0)  # the paper's: ten updates of fifty episodes


class AbstractRule(eqx.Module):
    """What happens in a new task."""

    budget: ClassVar[Budget] = GRADIENT_BUDGET
    """What is usual where an evaluation leaves numbers of episodes out."""

    @abstractmethod
    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        """Return what learns in new tasks.

        Args:
            trained: what meta-training has made.
            env: of the new tasks, for its sizes.

        Raises:
            ValueError: the rule needs something that was not trained.
        """

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        """Refuse numbers of episodes with which the rule can do nothing, by a ValueError."""

    @property
    def label(self) -> str:
        """What figures add to the method's name; empty for the method as it is."""
        return type(self).__name__


class AbstractWrapper(eqx.Module):
    """What is added to a rule."""

    @abstractmethod
    def wrap(self, learner: AbstractFastLearner[Any], env: AnyEnv) -> AbstractFastLearner[Any]:
        """Return the learner with the addition.

        Args:
            learner: of the rule, perhaps with other additions.
            env: of the new tasks, for its sizes.

        Raises:
            ValueError: the learner cannot be given it.
        """

    @property
    def label(self) -> str:
        """What figures add to the method's name."""
        return type(self).__name__

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        """Refuse a number of episodes with which the addition would never show.

        Args:
            episodes: per task, in all.
            episodes_per_update: per task.

        Raises:
            ValueError: it would not.
        """


class GradientRule(AbstractRule):
    """The method's own policy gradient, with its own schedule of steps.

    Section "Using the Latent Spaces for Exploration". In a new task latents start at the prior.
    """

    step_scale: float = 1.0
    """Multiplies the sizes of all steps."""
    full_steps: int | None = None
    """Updates with the whole step size, before the sizes begin to shrink (by `schedule.factor`,
    usually 1/2); None: as the run's settings say."""

    def __check_init__(self) -> None:
        if not 0 < self.step_scale < math.inf:
            raise ValueError(f"`step_scale` must be positive and finite, got {self.step_scale}.")
        if self.full_steps is not None and self.full_steps < 1:
            raise ValueError(f"`full_steps` must be at least 1, got {self.full_steps}.")

    @property
    def label(self) -> str:
        parts = {
            f"steps × {self.step_scale:g}": self.step_scale != 1,
            f"{self.full_steps} full steps": self.full_steps is not None,
        }
        return "; ".join(text for text, is_so in parts.items() if is_so)

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        return inside(trained.fast_learner(), self._paced)

    def _paced(self, learner: AbstractFastLearner[Any]) -> GradientFastLearner:
        if not isinstance(learner, GradientFastLearner):
            raise ValueError(
                f"the rule `gradient` needs a method that follows a gradient in new tasks, but "
                f"this one has a `{type(learner).__name__}`: leave the rule out."
            )
        if not learner.capabilities.learns_from_reward:
            raise ValueError(
                "the rule `gradient` needs a method that changes something in a new task, but this "
                "one does not: leave the rule out."
            )
        schedule = learner.schedule
        number = schedule.full_steps if self.full_steps is None else self.full_steps
        scale = schedule.scale * self.step_scale
        return replace(learner, schedule=replace(schedule, scale=scale, full_steps=number))


class MemoryRule(AbstractRule):
    """Go on remembering: what RL2 does in a new task."""

    @property
    def label(self) -> str:
        return ""

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        learner = trained.fast_learner()
        if learner.capabilities.trial_episodes is None:
            raise ValueError(
                "the rule `memory` needs a policy that remembers earlier episodes, such as that of "
                "`rl2`: leave the rule out."
            )
        return learner


class NoAdaptation(AbstractRule):
    """Learn nothing: the agents play on as they started."""

    @property
    def label(self) -> str:
        return "no adaptation"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        return FixedAgents(trained.fast_learner())


class FixedAgents(AbstractFastLearner[Any]):
    """The agents of a learner before its first update, for ever."""

    learner: AbstractFastLearner[Any]

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(learns_from_reward=False)

    def init(self, keys: TaskKeys, saved: SavedContexts | None = None) -> Any:
        return self.learner.init(keys, saved)

    def agents(self, state: Any, purpose: Purpose = "explore") -> Agents:
        return self.learner.agents(state, purpose)

    def update(self, state: Any, episodes: Episodes) -> Any:
        """Learn nothing."""
        return state


class AbstractThen(AbstractWrapper):
    """After some episodes the contexts stay, and the policy's weights follow their gradient.

    This is what the paper's claim about asymptotic performance compares: MAESN, then TRPO.
    """

    after: eqx.AbstractVar[int]
    """Episodes per task that the rule itself learns from."""

    @property
    @abstractmethod
    def improvement(self) -> PolicyImprovement:
        """How the weights follow their experience."""

    def __check_init__(self) -> None:
        if self.after < 0:
            raise ValueError(f"`after` must be at least 0, got {self.after}.")

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        if self.after >= episodes:
            raise ValueError(
                f"`episodes` must be more than `after`, got {episodes} and {self.after}: no "
                "episode would be left to fine-tune the policy with."
            )
        if self.after % episodes_per_update:
            raise ValueError(
                "`after` must be a multiple of `episodes_per_update`, got "
                f"{self.after} and {episodes_per_update}."
            )

    def wrap(self, learner: AbstractFastLearner[Any], env: AnyEnv) -> AbstractFastLearner[Any]:
        # Inside of a bonus, so that the weights learn from the bonus as well.
        return inside(learner, lambda one: FineTuning(one, self.improvement, self.after))


class ThenTrpo(AbstractThen):
    """Fine-tuning by TRPO."""

    max_kl: float = TRPO.trust_region.max_kl
    """Bound on the mean KL divergence of an update."""
    after: int = 500

    @property
    def improvement(self) -> PolicyImprovement:
        return PolicyImprovement(TRPO.sized(self.max_kl))

    @property
    def label(self) -> str:
        return f"{self.after} episodes, then TRPO"


class ThenReinforce(AbstractThen):
    """Fine-tuning by REINFORCE."""

    step_size: float = GradientStep().step_size
    """Of every update."""
    after: int = 500

    @property
    def improvement(self) -> PolicyImprovement:
        return PolicyImprovement(GradientStep().sized(self.step_size))

    @property
    def label(self) -> str:
        return f"{self.after} episodes, then REINFORCE"


class VimeBonus(AbstractWrapper):
    """A bonus for what is found out of the dynamics, by VIME."""

    curiosity: CuriosityBonus = CuriosityBonus()
    """How large it is, and how it is computed."""

    @property
    def label(self) -> str:
        return "bonus by VIME"

    def wrap(self, learner: AbstractFastLearner[Any], env: AnyEnv) -> AbstractFastLearner[Any]:
        if learner.capabilities.has_bonus:
            raise ValueError("it has a curiosity bonus already: leave `bonus` out.")
        return BonusFastLearner(learner, self.curiosity, env.observation_size, env.action_size)


def default_rule(trained: Trained) -> AbstractRule:
    """Return the rule that the method itself prescribes."""
    capabilities = trained.fast_learner().capabilities
    if capabilities.trial_episodes is not None:
        return MemoryRule()
    return GradientRule() if capabilities.learns_from_reward else NoAdaptation()
