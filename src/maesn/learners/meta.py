"""The interface of learning across tasks.

A *meta-learner* makes a fast learner of many tasks. It is settings, as a fast learner is, and has
abilities of the same kind (`maesn.learners.fast`).
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from maesn.axes import ActionKind, Key
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.fast import AbstractFastLearner
from maesn.policies import AbstractPolicy

MetaState = TypeVar("MetaState")
Info = TypeVar("Info")


class Problem(NamedTuple):
    """What a meta-learner must know of the tasks before it has seen any."""

    observation_size: int
    """Components of an observation."""
    action_size: int
    """Components of an action, or number of choices."""
    num_tasks: int
    """Number of training tasks."""
    description_size: int = 0
    """Components of the description of a task, for an oracle."""
    action_kind: ActionKind = "continuous"
    """Whether actions are vectors of real numbers, or choices."""
    horizon: int = 1
    """Control steps of an episode, at most."""
    episodes_per_task: int = 1
    """Number of episodes of each task that one call of `collect` plays."""


class TaskBelief(NamedTuple):
    """A Gaussian belief about the tasks of some trials, before any step and after each."""

    mean: Float[Array, "trial time_plus_1 z"]
    std: Float[Array, "trial time_plus_1 z"]
    predicted: Float[Array, "trial time_plus_1 place"]
    """Rewards that it expects at some places, or the chances of any."""


class AbstractMetaLearner(eqx.Module, Generic[MetaState, Info]):
    """Learns across tasks how to learn inside one."""

    @abstractmethod
    def init(self, key: Key, problem: Problem) -> MetaState:
        """Return the state before any training.

        Raises:
            ValueError: the method cannot learn from such tasks.
        """

    @abstractmethod
    def step(self, key: Key, state: MetaState, collect: Collect) -> tuple[MetaState, Info]:
        """Do one meta-iteration: draw tasks, play, improve."""

    @abstractmethod
    def fast_learner(self, state: MetaState) -> AbstractFastLearner[Any]:
        """Return the trained learner for new tasks."""

    def player(self, state: MetaState) -> AbstractPolicy:
        """Return the policy that plays first in a new task."""
        learner, one_task = self.fast_learner(state), jax.random.split(jax.random.key(0), 1)
        return learner.agents(learner.init(one_task)).policy

    def weights(self, state: MetaState) -> Any:
        """Return the part of a state that *is* the policy.

        It identifies the policy, binds the prior of a search to it, and is what another run may
        start from. Optimisers, replay and statistics that only training needs are no part of it.
        By default all of the state.
        """
        return state

    def replay(self, state: MetaState) -> Any:
        """Return the part of a state that only more training needs, and that is large.

        The newest checkpoint alone holds it. By default nothing.
        """
        return None

    def belief(
        self,
        state: MetaState,
        episodes: Sequence[Episodes],
        places: Float[ArrayLike, "place observation"],
    ) -> TaskBelief | None:
        """Ability: return the belief after each step of trials; None where it holds none.

        Args:
            state: after training.
            episodes: first, second, ... of every trial, as the fast learner has played them.
            places: observations, whose rewards the belief predicts.
        """
        return None

    @property
    def tasks_for_cores(self) -> int:
        """The number of tasks that cores of a CPU should share in a step; 1 if one core will do.

        Their exchange takes time too, so sharing helps where most of a step is learning.
        """
        return 1

    def effort(self, steps: int, iterations: int) -> int:
        """Return the work of a training, for estimates of time: by default, its steps.

        A method that takes longer on a step than most returns more.

        Args:
            steps: environment steps that the training plays.
            iterations: number of its meta-iterations.
        """
        return steps

    @abstractmethod
    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        """Return the number of episodes that the first so many meta-iterations play, in all.

        Args:
            episodes_per_task: the number that one call of `collect` plays of each task.
            iterations: number of meta-iterations. A first one may play more than the others.
        """

    def for_actions(self, kind: ActionKind) -> "AbstractMetaLearner[MetaState, Info]":
        """Return this learner with its policy made for actions of a kind.

        See `AbstractPolicySettings.for_actions`. A learner that holds no settings of a policy is
        returned as it is.
        """
        return self

    def check_batch(self, episodes_per_task: int) -> None:
        """Refuse a number of episodes per task that meta-iterations cannot learn from.

        Raises:
            ValueError: there are too few.
        """

    def iteration(self, state: MetaState) -> Int[Array, ""]:
        """Return the number of meta-iterations that led to a state: by default, its `iteration`."""
        number: Int[Array, ""] = state.iteration  # type: ignore[attr-defined]
        return number

    def metrics(self, info: Info) -> Any:
        """Return the scalars to log of a meta-iteration, named by their path in the tree."""
        return info

    def slots(self) -> tuple[Any, ...]:
        """Return the settings that define the method; all others are free."""
        return (type(self),)
