"""The two interfaces of learning: inside a task, and across tasks.

A *fast learner* acts and improves in a new task. A *meta-learner* produces one from many tasks.
Both are settings; what changes while they run is a separate pytree of arrays that their methods
take and return.
"""

from abc import abstractmethod
from typing import Any, Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Int

from maesn.agent import Agents
from maesn.axes import Key
from maesn.episodes import Collect, Episodes

FastState = TypeVar("FastState")
MetaState = TypeVar("MetaState")
Info = TypeVar("Info")


class AbstractFastLearner(eqx.Module, Generic[FastState]):
    """Acts and improves in new tasks, all of them at once."""

    @abstractmethod
    def init(self, num_tasks: int) -> FastState:
        """Return the state before any experience, for that many tasks."""

    @abstractmethod
    def agents(self, state: FastState) -> Agents:
        """Return who plays the next episodes, one agent per task."""

    @abstractmethod
    def update(self, state: FastState, episodes: Episodes) -> FastState:
        """Learn from the episodes that `agents(state)` has played, `[task, episode, ...]`."""


class AbstractMetaLearner(eqx.Module, Generic[MetaState, Info]):
    """Learns across tasks how to learn inside one."""

    @abstractmethod
    def init(self, key: Key, observation_size: int, action_size: int, num_tasks: int) -> MetaState:
        """Return the state before any training."""

    @abstractmethod
    def step(self, key: Key, state: MetaState, collect: Collect) -> tuple[MetaState, Info]:
        """Do one meta-iteration: draw tasks, play, improve."""

    @abstractmethod
    def fast_learner(self, state: MetaState) -> AbstractFastLearner[Any]:
        """Return what has been learned, as a learner for new tasks."""

    @abstractmethod
    def iteration(self, state: MetaState) -> Int[Array, ""]:
        """Return the number of meta-iterations that lie behind a state."""
