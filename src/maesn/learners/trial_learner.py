"""The fast learner of trials: the recurrent state of its policy is all that it learns."""

from maesn.axes import TaskKeys
from maesn.context import Nothing
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.experience.trial_state import TrialState
from maesn.learners.fast import AbstractFastLearner, Capabilities, Purpose
from maesn.policies import AbstractPolicy


class RecurrentFastLearner(AbstractFastLearner[TrialState | None]):
    """Acts with a recurrent policy; an update is one more episode of its trials.

    Its state is that of the trials, `[task, episode, ...]`, and None at their start.

    The episodes of a task are played in parallel, and each is the next one of a trial of its own:
    an update means one more episode of experience, however many trials are averaged over.
    """

    policy: AbstractPolicy
    trained_episodes: int
    """Episodes of a trial in meta-training."""
    is_noisy: bool = True
    """Whether its actions are drawn at random."""

    def init(self, keys: TaskKeys) -> None:
        """Trials begin; nothing is random."""

    def agents(self, state: TrialState | None, purpose: Purpose = "explore") -> Agents:
        """To be judged, they do what they always do."""
        return Agents(
            self.policy,
            Nothing(),
            shares_policy=True,
            trial_state=state,
            is_noisy=self.is_noisy,
        )

    def update(self, state: TrialState | None, episodes: Episodes) -> TrialState | None:
        """Go on from where the trials are after the episodes."""
        return episodes.trial_end

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(
            is_recurrent=True, trial_episodes=self.trained_episodes, learns_from_reward=False
        )
