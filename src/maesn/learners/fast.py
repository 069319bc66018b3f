"""The interface of learning inside a task.

A *fast learner* acts and improves in a new task. It is settings; what changes while it runs is a
separate pytree of arrays that its methods take and return.

Nobody asks for a learner's class. What only some learners can do is an *ability*: a property that
is None, or a method that refuses with a sentence, where a learner lacks it.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from maesn.axes import TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.runtime import ExportedLearner
from maesn.runtime.episode import Purpose as Purpose

FastState = TypeVar("FastState")


class Capabilities(NamedTuple):
    """Abilities and needs of a fast learner. The defaults are those of most learners."""

    is_recurrent: bool = False
    """Whether an action depends on earlier steps: a step cannot then be judged by itself."""
    trial_episodes: int | None = None
    """Episodes of a trial in meta-training; None for a learner that was not trained on trials.

    A learner of trials learns one episode per update: the episodes that are played side by side
    belong to trials of their own. Beyond `trial_episodes` it does what it was not trained for."""
    learns_from_reward: bool = True
    """Whether updates depend on `Episodes.reward`. Those of a recurrent policy, of PEARL and of an
    oracle do not: they read the received reward, which has no bonus, or none."""
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


class AbstractSettableLatent(eqx.Module):
    """The latent of a policy, for those who choose it themselves: a search, or a person."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of components of z."""

    @property
    @abstractmethod
    def spread(self) -> float:
        """Standard deviation, per component, of latents that are worth trying."""

    @abstractmethod
    def holding(self, latents: Float[ArrayLike, "task *episode z"]) -> Agents:
        """Return one agent per task, whose z is its latent in every episode.

        With an axis `episode`, z is another latent in each of the episodes that are played side by
        side.
        """

    @abstractmethod
    def of_tasks(
        self, collect: Collect, keys: TaskKeys, task_index: Int[Array, " task"]
    ) -> Float[np.ndarray, "task z"]:
        """Return one latent for each of some training tasks, found with one batch of episodes.

        Args:
            collect: plays the training tasks, on the reward of training.
            keys: one random key per task.
            task_index: the tasks.
        """


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

    @property
    def latent(self) -> "AbstractSettableLatent | None":
        """Ability: its policy is steered by a latent that others may set; None without one."""
        return None

    def rescheduled(
        self, step_scale: float, full_steps: int | None, start_std: float
    ) -> "AbstractFastLearner[FastState]":
        """Ability: return this learner with other steps along its gradient inside a task.

        Args:
            step_scale: factor on all step sizes.
            full_steps: updates before the sizes shrink; None: as it is.
            start_std: factor on the standard deviation of the latents that new tasks start from.

        Raises:
            ValueError: it follows no gradient, or has no latent to start from.
        """
        raise ValueError(
            "the rule `gradient` needs a method that follows a gradient in new tasks, but this one "
            f"has a `{type(self).__name__}` that does not: leave the rule out."
        )

    def inside(
        self, change: "Callable[[AbstractFastLearner[Any]], AbstractFastLearner[Any]]"
    ) -> "AbstractFastLearner[Any]":
        """Return what a change makes of this learner; a bonus around a learner stays outside."""
        return change(self)

    def exported(self) -> ExportedLearner:
        """Ability: return the learner as the arrays that a robot's NumPy runtime acts with.

        Raises:
            ValueError: a sentence that says why the runtime cannot act or learn as it does.
        """
        raise ValueError(f"`{type(self).__name__}` has no form that the runtime can act with.")
