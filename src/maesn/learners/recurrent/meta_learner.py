"""RL2: learning inside a task is what a policy with memory does (Duan et al. 2016).

https://arxiv.org/abs/1611.02779. A trial is several episodes of one task between which memory is
kept. Meta-training improves the policy on whole trials, so that it pays to find out in the first
episode what the others need. In a new task nothing is updated but the memory.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import ActionKind, Key
from maesn.context import Nothing
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.base import AbstractMetaLearner
from maesn.learners.meta_batch import check_enough_tasks, draw_tasks, task_keys
from maesn.learners.recurrent.fast_learner import RecurrentFastLearner
from maesn.learners.recurrent.policy_steps import AbstractPolicyStep, ProximalStep
from maesn.learners.recurrent.trials import Trials, join_episodes
from maesn.learners.recurrent.value import RecurrentValue, ValueState
from maesn.learners.side_by_side import side_by_side
from maesn.numerics import masked_mean, standardize, trial_advantages
from maesn.policies import AbstractPolicy, AbstractPolicySettings, Recurrent


class RecurrentMetaState(eqx.Module):
    """State of a `RecurrentMetaLearner`."""

    policy: AbstractPolicy
    optimizer: Any
    """State of the policy's optimiser."""
    value: ValueState
    iteration: Int[Array, ""]


class RecurrentInfo(eqx.Module):
    """What a human wants to know of one meta-iteration: scalars only."""

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
    """Share of the variance of the returns that the value function knew before it was fitted."""
    value_accepted: Bool[Array, ""]
    """False if the fit of the value function did not end in numbers: it stays as it was."""
    policy_step: Any
    """What the step of the policy says."""


class RecurrentMetaLearner(AbstractMetaLearner[RecurrentMetaState, RecurrentInfo]):
    """Plays trials and improves a policy with memory on them."""

    policy: AbstractPolicySettings = Recurrent()
    """The policy's network."""
    policy_step: AbstractPolicyStep = ProximalStep()
    """How the policy is improved: `ProximalStep` (PPO) or `TrustRegionStep` (TRPO)."""
    value: RecurrentValue = RecurrentValue()
    """The baseline that advantages are measured from."""
    meta_batch_size: int = 20
    """Training tasks per meta-iteration, drawn without replacement. In each of them
    `episodes_per_task` trials are played in parallel."""
    trial_episodes: int = 2
    """Episodes of a trial. With 2, a meta-iteration takes as many steps as one of MAESN."""
    discount: float = 0.99
    """gamma, the weight of a reward one step later; it runs on across the episodes of a trial."""
    gae_lambda: float = 0.95
    """lambda of generalised advantage estimation. garage's RL2: 0.95."""

    def __check_init__(self) -> None:
        for name in ("meta_batch_size", "trial_episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1, got {getattr(self, name)}.")
        for name in ("discount", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"`{name}` must lie in [0, 1], got {getattr(self, name)}.")
        if self.trial_episodes > 1 and not self.policy.is_recurrent:
            raise ValueError(
                f"`trial_episodes` is {self.trial_episodes}, but a policy of `"
                f"{type(self.policy).__name__}` remembers nothing from one episode to the next: "
                "choose `Recurrent`, or trials of 1 episode."
            )

    def init(
        self,
        key: Key,
        observation_size: int,
        action_size: int,
        num_tasks: int,
        description_size: int = 0,
    ) -> RecurrentMetaState:
        """See `AbstractMetaLearner.init`.

        Raises:
            ValueError: the training set holds fewer tasks than one meta-batch.
        """
        check_enough_tasks(num_tasks, self.meta_batch_size)
        policy_key, value_key = jax.random.split(key)
        policy = self.policy.init(policy_key, observation_size, action_size, 0)
        value = self.value.init(value_key, observation_size, action_size)
        optimizer = self.policy_step.init(policy)
        return RecurrentMetaState(policy, optimizer, value, jnp.zeros((), int))

    def iteration(self, state: RecurrentMetaState) -> Int[Array, ""]:
        return state.iteration

    def slots(self) -> tuple[Any, ...]:
        """Return how the policy is improved."""
        return (type(self), type(self.policy_step))

    def for_actions(self, kind: ActionKind) -> "RecurrentMetaLearner":
        """See `AbstractMetaLearner.for_actions`."""
        return replace(self, policy=self.policy.for_actions(kind))

    def check_batch(self, episodes_per_task: int) -> None:
        """See `AbstractMetaLearner.check_batch`: a trial is a sample, and no minibatch is empty."""
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

    def fast_learner(self, state: RecurrentMetaState) -> RecurrentFastLearner:
        """Return the learner of new tasks: it remembers."""
        return RecurrentFastLearner(state.policy, self.trial_episodes)

    def step(
        self, key: Key, state: RecurrentMetaState, collect: Collect
    ) -> tuple[RecurrentMetaState, RecurrentInfo]:
        """See `AbstractMetaLearner.step`."""
        task_key, play_key, learn_key = jax.random.split(key, 3)
        index = draw_tasks(task_key, collect.num_tasks, self.meta_batch_size)
        episodes: list[Episodes] = []
        for number in range(self.trial_episodes):
            keys = task_keys(play_key, number, index.shape[0])
            trial_state = episodes[-1].trial_end if episodes else None
            agents = Agents(state.policy, Nothing(), shares_policy=True, trial_state=trial_state)
            episodes.append(collect(keys, agents, index, stage=number))
        return self._improve(learn_key, state, tuple(episodes))

    def _improve(
        self, key: Key, state: RecurrentMetaState, episodes: tuple[Episodes, ...]
    ) -> tuple[RecurrentMetaState, RecurrentInfo]:
        policy_key, value_key = jax.random.split(key)
        trials, expected, advantages = self._judge(state.value, episodes)
        (policy, optimizer, told), (value, accepted) = side_by_side(
            lambda: self._improve_policy(policy_key, state, trials, advantages),
            lambda: self._fit_value(value_key, state.value, trials, advantages + expected),
        )
        info = _describe(episodes, trials, advantages, expected, accepted, told)
        return RecurrentMetaState(policy, optimizer, value, state.iteration + 1), info

    @eqx.filter_jit
    def _judge(
        self, value: ValueState, episodes: tuple[Episodes, ...]
    ) -> tuple[Trials, Float[Array, "trial time"], Float[Array, "trial time"]]:
        """Return the trials, V_t and advantages."""
        trials = join_episodes(episodes)
        expected = self.value.values(value, trials)
        return trials, expected, self.advantages(trials, expected)

    @eqx.filter_jit
    def _improve_policy(
        self,
        key: Key,
        state: RecurrentMetaState,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, Any, Any]:
        standard = standardize(advantages, trials.valid)
        return self.policy_step(key, state.policy, state.optimizer, trials, standard)

    @eqx.filter_jit
    def _fit_value(
        self,
        key: Key,
        value: ValueState,
        trials: Trials,
        returns: Float[Array, "trial time"],
    ) -> tuple[ValueState, Bool[Array, ""]]:
        return self.value.fit(key, value, trials, returns)

    def advantages(
        self, trials: Trials, expected: Float[Array, "trial time"]
    ) -> Float[Array, "trial time"]:
        """Return the advantage of every step, over the whole trial and not standardised.

        Args:
            trials: what was played.
            expected: V_t.
        """
        return jax.vmap(trial_advantages, in_axes=(0, 0, 0, None, None))(
            trials.reward, expected, trials.valid, self.discount, self.gae_lambda
        )


@eqx.filter_jit
def _describe(
    episodes: tuple[Episodes, ...],
    trials: Trials,
    advantages: Float[Array, "trial time"],
    expected: Float[Array, "trial time"],
    value_accepted: Bool[Array, ""],
    told: Any,
) -> RecurrentInfo:
    first, last = episodes[0], episodes[-1]
    valid, behaviour = trials.valid, trials.behaviour
    spread = _variance(advantages + expected, trials)
    unknown = _variance(advantages, trials) / jnp.where(spread > 0, spread, 1.0)
    return RecurrentInfo(
        return_before=first.undiscounted_return.mean(),
        return_after=last.undiscounted_return.mean(),
        success_after=(last.solved & last.valid).any(-1).mean(),
        action_std=masked_mean(behaviour.std().mean(-1), valid),
        entropy=masked_mean(behaviour.entropy(), valid),
        explained_variance=jnp.where(spread > 0, 1.0 - unknown, 0.0),
        value_accepted=value_accepted,
        policy_step=told,
    )


def _variance(values: Float[Array, "trial time"], trials: Trials) -> Float[Array, ""]:
    mean = masked_mean(values, trials.valid)
    return masked_mean((values - mean) ** 2, trials.valid)
