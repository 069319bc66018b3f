"""The two interfaces of learning: inside a task, and across tasks.

A *fast learner* acts and improves in a new task. A *meta-learner* produces one from many tasks.
Both are settings; what changes while they run is a separate pytree of arrays that their methods
take and return.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
from jaxtyping import Array, Int

from maesn.axes import ActionKind, Key, TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes, TrialState
from maesn.policies import AbstractPolicy

FastState = TypeVar("FastState")
MetaState = TypeVar("MetaState")
Info = TypeVar("Info")


class AbstractFastLearner(eqx.Module, Generic[FastState]):
    """Acts and improves in new tasks, all of them at once."""

    @abstractmethod
    def init(self, keys: TaskKeys) -> FastState:
        """Return the state before any experience.

        Args:
            keys: one key per task slot. All that is random in slot i, now and in later updates,
                comes from `keys[i]`, so it does not depend on how many slots there are.
        """

    @abstractmethod
    def agents(self, state: FastState) -> Agents:
        """Return who plays the next episodes, one agent per task."""

    @abstractmethod
    def update(self, state: FastState, episodes: Episodes) -> FastState:
        """Learn from the episodes that `agents(state)` has played, `[task, episode, ...]`."""

    def memory(self, state: FastState) -> TrialState | None:
        """Return what the policies remember when the next episodes begin; None for nothing."""
        return None

    def episodes_per_update(self, episodes_per_task: int) -> int:
        """Return how many episodes of a task an update learns from.

        Args:
            episodes_per_task: number of episodes that are played of each task at a time.
        """
        return episodes_per_task

    @property
    def trial_episodes(self) -> int | None:
        """Number of episodes that meta-training has prepared for; None if there is no such limit.

        What a policy with memory does later than that in a new task, it has never been trained for.
        """
        return None

    @property
    def is_recurrent(self) -> bool:
        """Whether the policies remember earlier steps: a step then cannot be judged by itself."""
        return False

    @property
    def learns_from_reward(self) -> bool:
        """Whether updates depend on the rewards of the episodes that they are given.

        Not those of a policy that remembers what it was shown, or that was told its task.
        """
        return True

    @property
    def has_bonus(self) -> bool:
        """Whether a bonus is added to the rewards before updates see them."""
        return False

    def paced(self, step_scale: float, full_steps: int | None) -> "AbstractFastLearner[FastState]":
        """Return the same learner with other sizes of its steps.

        Args:
            step_scale: multiplies all of them.
            full_steps: updates with the whole step size, before the sizes begin to shrink; None for
                as many as now.

        Raises:
            ValueError: this learner takes no steps of that kind, or a number is out of range.
        """
        raise ValueError(f"`{type(self).__name__}` follows no schedule of step sizes.")

    def inside(
        self, change: Callable[["AbstractFastLearner[Any]"], "AbstractFastLearner[Any]"]
    ) -> "AbstractFastLearner[Any]":
        """Return what `change` makes of this learner.

        Where a bonus is added to the episodes, that stays, and whoever is handed them is changed.
        """
        return change(self)

    def resume(self, context: AbstractContext, update: int = 0) -> FastState:
        """Return the state of an earlier adaptation of which the contexts were kept.

        Args:
            context: one context per task, stacked.
            update: number of updates that led to it.

        Raises:
            ValueError: contexts are not what this learner changes in a task, or not all of it.
        """
        raise ValueError(
            f"`{type(self).__name__}` cannot go on from latents: they are not all that it learns "
            "in a task."
        )


class AbstractMetaLearner(eqx.Module, Generic[MetaState, Info]):
    """Learns across tasks how to learn inside one."""

    @abstractmethod
    def init(
        self,
        key: Key,
        observation_size: int,
        action_size: int,
        num_tasks: int,
        description_size: int = 0,
    ) -> MetaState:
        """Return the state before any training.

        Args:
            key: random key.
            observation_size: components of an observation.
            action_size: components of an action, or number of choices.
            num_tasks: number of training tasks.
            description_size: components of the description of a task, for a policy that is told.
        """

    @abstractmethod
    def step(self, key: Key, state: MetaState, collect: Collect) -> tuple[MetaState, Info]:
        """Do one meta-iteration: draw tasks, play, improve."""

    @abstractmethod
    def fast_learner(self, state: MetaState) -> AbstractFastLearner[Any]:
        """Return what has been learned, as a learner for new tasks."""

    def player(self, state: MetaState) -> AbstractPolicy:
        """Return the policy that plays first in a new task."""
        learner, one_task = self.fast_learner(state), jax.random.split(jax.random.key(0), 1)
        return learner.agents(learner.init(one_task)).policy

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

    @abstractmethod
    def iteration(self, state: MetaState) -> Int[Array, ""]:
        """Return the number of meta-iterations that lie behind a state."""

    def slots(self) -> tuple[Any, ...]:
        """Return what tells this method from others; all other settings are free."""
        return (type(self),)
