"""The two interfaces of learning: inside a task, and across tasks.

A *fast learner* acts and improves in a new task. A *meta-learner* produces one from many tasks.
Both are settings; what changes while they run is a separate pytree of arrays that their methods
take and return.
"""

from abc import abstractmethod
from typing import Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
from jaxtyping import Array, Int

from maesn.axes import ActionKind, Key, TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.policies import AbstractPolicy

FastState = TypeVar("FastState")
MetaState = TypeVar("MetaState")
Info = TypeVar("Info")

# What episodes are for: `explore`, to learn from; `deploy`, to be judged, and not learned from.
Purpose: TypeAlias = Literal["explore", "deploy"]


class Capabilities(NamedTuple):
    """Abilities and needs of a fast learner. The defaults are those of most learners."""

    is_recurrent: bool = False
    """Whether an action depends on earlier steps: a step cannot then be judged by itself."""
    trial_episodes: int | None = None
    """Episodes of a trial in meta-training; None for a learner that was not trained on trials.

    A learner of trials learns one episode per update: the episodes that are played side by side
    belong to trials of their own. Beyond `trial_episodes` it does what it was not trained for."""
    learns_from_reward: bool = True
    """Whether updates depend on the rewards of the episodes. Those of a recurrent policy and of an
    oracle do not."""
    has_bonus: bool = False
    """Whether a bonus is added to the rewards before updates see them."""
    least_episodes: int = 1
    """Episodes of a task that an update needs at least."""

    def check_episodes(self, episodes_per_update: int) -> None:
        """Refuse updates that could not change anything.

        Raises:
            ValueError: there are fewer episodes than `least_episodes`.
        """
        if episodes_per_update < self.least_episodes:
            raise ValueError(
                f"an update needs at least {self.least_episodes} episodes of a task, got "
                f"{episodes_per_update}: the latent moves by the differences between the returns "
                "of episodes. Play more episodes per update."
            )


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
    def agents(self, state: FastState, purpose: Purpose = "explore") -> Agents:
        """Return the agents that play the next episodes, one per task.

        Args:
            state: the learner's state.
            purpose: purpose of the episodes. `update` takes those of `explore` alone.
        """

    @abstractmethod
    def update(self, state: FastState, episodes: Episodes) -> FastState:
        """Learn from episodes `[task, episode, ...]` that `agents(state)` has played.

        Raises:
            ValueError: there are fewer than `capabilities.least_episodes` of each task.
        """

    def adapted(self, state: FastState) -> AbstractContext:
        """Return the contexts so far, one per task, stacked: those of the exploring agents."""
        return self.agents(state).context

    @property
    def capabilities(self) -> Capabilities:
        """The abilities and needs of this learner."""
        return Capabilities()


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
            description_size: components of the description of a task, for an oracle.
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
        """Return the number of meta-iterations that led to a state."""

    def metrics(self, info: Info) -> Any:
        """Return the scalars to log of a meta-iteration, named by their path in the tree."""
        return info

    def slots(self) -> tuple[Any, ...]:
        """Return the settings that define the method; all others are free."""
        return (type(self),)
