"""How a trained method learns in a new task: the interfaces of rules and wrappers.

A rule turns the result of meta-training into a fast learner. A wrapper adds to any rule. Both are
frozen settings. You can write your own, and give it as an object or as `module:name`.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from maesn.envs import AnyEnv
from maesn.learners import AbstractFastLearner, AbstractMetaLearner
from maesn.runtime.return_model import ReturnPrior


class Trained(NamedTuple):
    """The result of meta-training."""

    learner: AbstractMetaLearner[Any, Any]
    """The method and its settings."""
    state: Any
    """The learner's final state."""
    return_prior: Callable[[str, bool], ReturnPrior] | None = None
    """Loads the prior of a search. Its arguments are the file's path, empty for the run's own
    prior, and whether a prior that was made for another reward will do. None without a run."""

    per_update: int = 1
    """Episodes of each task that one update will learn from."""

    def fast_learner(self) -> AbstractFastLearner[Any]:
        """Return the learner of new tasks that the method itself prescribes."""
        return self.learner.fast_learner(self.state)


class Budget(NamedTuple):
    """Numbers of episodes per task."""

    episodes: int
    """Episodes to learn from, in all."""
    per_update: int
    """Episodes that one update learns from."""
    deploy: int
    """Fresh episodes that judge the deployed agent each time."""


class _AbstractChoice(eqx.Module):
    """What rules and wrappers have in common."""

    @property
    def label(self) -> str:
        """Suffix of the method's name in figures; empty for the method's own rule."""
        return type(self).__name__

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        """Raise ValueError if it could do nothing with so many episodes of each task."""


class AbstractRule(_AbstractChoice):
    """How a trained method learns in a new task."""

    budget: ClassVar[Budget] = Budget(500, 50, 0)
    """Default numbers of episodes of an evaluation. The paper's: ten updates of fifty episodes."""
    needs_return_prior: ClassVar[bool] = False
    """Whether the rule calls `Trained.return_prior`. A study then makes the prior beforehand."""

    @abstractmethod
    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        """Return the learner for new tasks in such an environment.

        Raises:
            ValueError: the trained method lacks something that the rule needs.
        """


class AbstractWrapper(_AbstractChoice):
    """An addition to a rule."""

    @abstractmethod
    def wrap(self, learner: AbstractFastLearner[Any], env: AnyEnv) -> AbstractFastLearner[Any]:
        """Return the learner, perhaps with other additions already, with this addition.

        Raises:
            ValueError: the addition does not fit the learner.
        """
