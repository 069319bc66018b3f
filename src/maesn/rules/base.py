"""What happens in a new task: the interface of rules and of what is added to them.

A rule turns what meta-training has made into a fast learner. Wrappers add to any rule. Both are
frozen settings, and both are open: a class of your own takes part like those of the library, given
as an object or as `module:name`.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from maesn.envs import AnyEnv
from maesn.learners import AbstractFastLearner, AbstractMetaLearner
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
    needs_return_prior: ClassVar[bool] = False
    """Whether the rule asks for `Trained.return_prior`, so that a study makes it before."""

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
        """Refuse numbers of episodes with which the addition would never show, by a ValueError."""
