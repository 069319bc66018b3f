"""The fast learner of RL2: it learns by remembering."""

import equinox as eqx

from maesn.axes import TaskKeys
from maesn.context import Nothing
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes, TrialState
from maesn.learners.base import AbstractFastLearner
from maesn.policies import AbstractPolicy


class RecurrentFastState(eqx.Module):
    """State of a `RecurrentFastLearner`."""

    memory: TrialState | None
    """What is remembered, `[task, episode, ...]`; None at the start."""


class RecurrentFastLearner(AbstractFastLearner[RecurrentFastState]):
    """Acts with a policy that has memory; an update is to go on remembering.

    The episodes of a task are played in parallel, and each is the next one of a trial of its own:
    an update means one more episode of experience, however many trials are averaged over.
    """

    policy: AbstractPolicy
    trained_episodes: int
    """Episodes of a trial in meta-training."""

    def init(self, keys: TaskKeys) -> RecurrentFastState:
        """Return the start in new tasks: nothing is remembered, and nothing is random."""
        return RecurrentFastState(None)

    def agents(self, state: RecurrentFastState) -> Agents:
        return Agents(self.policy, Nothing(), shares_policy=True)

    def memory(self, state: RecurrentFastState) -> TrialState | None:
        return state.memory

    def update(self, state: RecurrentFastState, episodes: Episodes) -> RecurrentFastState:
        """Remember the episodes."""
        return RecurrentFastState(episodes.carry)

    def episodes_per_update(self, episodes_per_task: int) -> int:
        return 1

    @property
    def is_recurrent(self) -> bool:
        return True

    @property
    def learns_from_reward(self) -> bool:
        return False

    @property
    def trial_episodes(self) -> int:
        return self.trained_episodes
