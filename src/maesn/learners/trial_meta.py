"""What RL2 and VariBAD share: they play trials, and learn from whole ones by policy gradient.

In a new task the recurrent state of the policy is all that learns.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, TypeVar

import equinox as eqx
import jax
from jaxtyping import Array, Bool, Float

from maesn.axes import ActionKind, Key, TaskKeys
from maesn.context import Nothing
from maesn.experience.agent import Agents, TrialState
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.fast import AbstractFastLearner, Capabilities, Purpose
from maesn.learners.meta import AbstractMetaLearner
from maesn.learners.meta_batch import draw_tasks, task_keys
from maesn.learners.policy_steps import AbstractPolicyStep
from maesn.learners.trial_value import AbstractTrialValue, explained_variance
from maesn.learners.trials import Trials
from maesn.numerics import masked_mean, trial_advantages
from maesn.numerics.mesh import refuse_sharing
from maesn.policies import AbstractPolicy, AbstractPolicySettings
from maesn.settings import check_least, check_number

MetaState = TypeVar("MetaState")
Info = TypeVar("Info", bound="TrialInfo")


class TrialInfo(eqx.Module):
    """Info of one meta-iteration: scalars only."""

    return_before: Float[Array, ""]
    """Mean undiscounted return of the first episodes of the trials."""
    return_after: Float[Array, ""]
    """Mean undiscounted return of their last episodes."""
    success_after: Float[Array, ""]
    """Share of the last episodes that reach the goal region."""
    action_std: Float[Array, ""]
    """Mean standard deviation of the actions."""
    entropy: Float[Array, ""]
    """Mean entropy of the action distributions, in nats."""
    explained_variance: Float[Array, ""]
    """Share of the variance of the returns that the value function explained before the fit."""
    value_accepted: Bool[Array, ""]
    """False if the fitted value function was not finite: it stays as it was."""
    policy_step: Any
    """Info of the policy's step."""


def describe_trials(
    episodes: tuple[Episodes, ...],
    trials: Trials,
    advantages: Float[Array, "trial time"],
    expected: Float[Array, "trial time"],
) -> dict[str, Float[Array, ""]]:
    """Return the fields of `TrialInfo` but `value_accepted` and `policy_step`."""
    first, last, behaviour = episodes[0], episodes[-1], trials.behaviour
    return {
        "return_before": first.undiscounted_return.mean(),
        "return_after": last.undiscounted_return.mean(),
        "success_after": last.success.mean(),
        "action_std": masked_mean(behaviour.std().mean(-1), trials.valid),
        "entropy": masked_mean(behaviour.entropy(), trials.valid),
        "explained_variance": explained_variance(advantages, expected, trials.valid),
    }


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
        """The same for both purposes; who judges them takes the noise from their actions."""
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


class AbstractTrialMetaLearner(AbstractMetaLearner[MetaState, Info]):
    """Plays trials of a meta-batch of tasks, episode after episode, and learns from them."""

    policy: eqx.AbstractVar[AbstractPolicySettings]
    policy_step: eqx.AbstractVar[AbstractPolicyStep]
    value: eqx.AbstractVar[AbstractTrialValue[Any]]
    meta_batch_size: eqx.AbstractVar[int]
    trial_episodes: eqx.AbstractVar[int]
    discount: eqx.AbstractVar[float]
    gae_lambda: eqx.AbstractVar[float]

    def __check_init__(self) -> None:  # Equinox runs that of a subclass as well
        check_least(self, meta_batch_size=1, trial_episodes=1)
        for name in ("discount", "gae_lambda"):
            check_number(name, getattr(self, name), 0, 1)

    @abstractmethod
    def fast_learner(self, state: MetaState) -> RecurrentFastLearner:
        """Return the learner of new tasks: its policy goes on through their trials."""

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        return iterations * self.trial_episodes * self.meta_batch_size * episodes_per_task

    def for_actions(self, kind: ActionKind) -> "AbstractTrialMetaLearner[MetaState, Info]":
        return replace(self, policy=self.policy.for_actions(kind))

    def check_batch(self, episodes_per_task: int) -> None:
        """One device learns. A trial is a sample, and no minibatch is empty."""
        refuse_sharing()
        trials = self.meta_batch_size * episodes_per_task
        parts = {
            "policy_step": self.policy_step.minibatches,
            "value": self.value.descent.minibatches,
        }
        for owner, minibatches in parts.items():
            if trials < minibatches:
                raise ValueError(
                    f"`{owner}.descent.minibatches` is {minibatches}, but a meta-iteration has "
                    f"only {trials} trials, {episodes_per_task} in each of "
                    f"{self.meta_batch_size} tasks: lower it, or play more."
                )

    def step(self, key: Key, state: MetaState, collect: Collect) -> tuple[MetaState, Info]:
        task_key, play_key, learn_key = jax.random.split(key, 3)
        index = draw_tasks(task_key, collect.num_tasks, self.meta_batch_size)
        policy = self.fast_learner(state).policy
        episodes: list[Episodes] = []
        for number in range(self.trial_episodes):
            keys = task_keys(play_key, number, self.meta_batch_size)
            trial_state = episodes[-1].trial_end if episodes else None
            agents = Agents(policy, Nothing(), shares_policy=True, trial_state=trial_state)
            episodes.append(collect(keys, agents, index, stage=number))
        return self.improved(learn_key, state, tuple(episodes))

    @abstractmethod
    def improved(
        self, key: Key, state: MetaState, episodes: tuple[Episodes, ...]
    ) -> tuple[MetaState, Info]:
        """Learn from the first, second, ... episodes of all trials."""

    def advantages(
        self, trials: Trials, expected: Float[Array, "trial time"]
    ) -> Float[Array, "trial time"]:
        """Return the advantage of every step over V_t, `expected`; it is not standardised.

        It reaches over the episodes of the whole trial.
        """
        return jax.vmap(trial_advantages, in_axes=(0, 0, 0, None, None))(
            trials.reward, expected, trials.valid, self.discount, self.gae_lambda
        )
