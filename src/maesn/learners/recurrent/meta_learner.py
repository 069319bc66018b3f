"""RL2: a recurrent policy learns inside a task by its recurrent state (Duan et al. 2016).

https://arxiv.org/abs/1611.02779. A trial is several episodes of one task, between which the
recurrent state is kept. Meta-training improves the policy on whole trials: exploring in the first
episode is worth what it adds to the returns of the others. In a new task no weights change.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import ActionKind, Key
from maesn.context import Nothing
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.meta import AbstractMetaLearner, Problem
from maesn.learners.meta_batch import check_enough_tasks, draw_tasks, task_keys
from maesn.learners.policy_steps import AbstractPolicyStep, ProximalStep
from maesn.learners.recurrent.value import RecurrentValue
from maesn.learners.trial_learner import RecurrentFastLearner
from maesn.learners.trial_value import ValueState, explained_variance
from maesn.learners.trials import Trials, check_trials, join_episodes
from maesn.numerics import mesh, standardize, trial_advantages
from maesn.numerics.mesh import at_once, check_split, over_tasks
from maesn.policies import AbstractPolicy, AbstractPolicySettings, Recurrent


class RecurrentMetaState(eqx.Module):
    """State of a `RecurrentMetaLearner`."""

    policy: AbstractPolicy
    opt_state: Any
    """State of the policy's optimiser."""
    value: ValueState
    iteration: Int[Array, ""]


class RecurrentInfo(eqx.Module):
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


class RecurrentMetaLearner(AbstractMetaLearner[RecurrentMetaState, RecurrentInfo]):
    """Plays trials and improves a recurrent policy on them."""

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
    """Discount factor gamma of the rewards, across the episodes of a trial."""
    gae_lambda: float = 0.95
    """lambda of generalised advantage estimation. garage's RL2: 0.95."""

    def __check_init__(self) -> None:
        check_trials(self)
        if self.trial_episodes > 1 and not self.policy.is_recurrent:
            raise ValueError(
                f"`trial_episodes` is {self.trial_episodes}, but a policy of `"
                f"{type(self.policy).__name__}` is not recurrent and learns nothing from one "
                "episode for the next: choose `Recurrent`, or trials of 1 episode."
            )

    def init(self, key: Key, problem: Problem) -> RecurrentMetaState:
        """See `AbstractMetaLearner.init`.

        Raises:
            ValueError: the training set holds fewer tasks than one meta-batch.
        """
        check_enough_tasks(problem.num_tasks, self.meta_batch_size)
        policy_key, value_key = jax.random.split(key)
        sizes = problem.observation_size, problem.action_size
        policy = self.policy.init(policy_key, *sizes, 0)
        value = self.value.init(value_key, *sizes)
        opt_state = self.policy_step.init(policy)
        return RecurrentMetaState(policy, opt_state, value, jnp.zeros((), int))

    def iteration(self, state: RecurrentMetaState) -> Int[Array, ""]:
        return state.iteration

    def weights(self, state: RecurrentMetaState) -> AbstractPolicy:
        return state.policy

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        return iterations * self.trial_episodes * self.meta_batch_size * episodes_per_task

    def effort(self, steps: int, iterations: int) -> int:
        return 2 * steps  # policy and value go through trials step by step

    def slots(self) -> tuple[Any, ...]:
        """Return how the policy is improved."""
        return (type(self), type(self.policy_step))

    def for_actions(self, kind: ActionKind) -> "RecurrentMetaLearner":
        return replace(self, policy=self.policy.for_actions(kind))

    def check_batch(self, episodes_per_task: int) -> None:
        """See `AbstractMetaLearner.check_batch`: a trial is a sample, and no minibatch is empty."""
        check_split(self.meta_batch_size)
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
        """Return the learner of new tasks: its policy goes on through their trials."""
        return RecurrentFastLearner(state.policy, self.trial_episodes)

    def step(
        self, key: Key, state: RecurrentMetaState, collect: Collect
    ) -> tuple[RecurrentMetaState, RecurrentInfo]:
        task_key, play_key, learn_key = jax.random.split(key, 3)
        index = draw_tasks(task_key, collect.num_tasks, self.meta_batch_size)
        episodes: list[Episodes] = []
        for number in range(self.trial_episodes):
            keys = task_keys(play_key, number, self.meta_batch_size)
            trial_state = episodes[-1].trial_end if episodes else None
            agents = Agents(state.policy, Nothing(), shares_policy=True, trial_state=trial_state)
            episodes.append(collect(keys, agents, index, stage=number))
        return self._improve(learn_key, state, tuple(episodes))

    def _improve(
        self, key: Key, state: RecurrentMetaState, episodes: tuple[Episodes, ...]
    ) -> tuple[RecurrentMetaState, RecurrentInfo]:
        """Improve the policy and the value function, which learn from the same trials."""
        policy_key, value_key = jax.random.split(key)
        _, judged = over_tasks(self._judge, state, episodes)
        (improved, _), (fitted, _) = at_once(
            partial(over_tasks, self._improve_policy, (policy_key, state), judged),
            partial(over_tasks, self._fit_value, (value_key, state), judged),
        )
        (policy, opt_state, step), (value, accepted) = improved, fitted
        info, _ = over_tasks(_describe, (accepted, step), (episodes, judged))
        return RecurrentMetaState(policy, opt_state, value, state.iteration + 1), info

    # `over_tasks` runs the following.
    def _judge(
        self, state: RecurrentMetaState, episodes: tuple[Episodes, ...]
    ) -> tuple[None, "_Judged"]:
        trials = join_episodes(episodes)
        expected = self.value.values(state.value, self._seen(state, trials))
        return None, _Judged(trials, self.advantages(trials, expected), expected)

    def _improve_policy(
        self, shared: tuple[Key, RecurrentMetaState], judged: "_Judged"
    ) -> tuple[tuple[AbstractPolicy, Any, Any], None]:
        key, state = shared
        trials, advantages, _ = judged
        standard = standardize(advantages, trials.valid, mean=mesh.mean_of_valid)
        policy, opt_state, step = self.policy_step(
            key, state.policy, state.opt_state, trials, standard
        )
        policy = self.policy.after_iteration(policy, state.iteration + 1)
        return (policy, opt_state, step), None

    def _fit_value(
        self, shared: tuple[Key, RecurrentMetaState], judged: "_Judged"
    ) -> tuple[tuple[ValueState, Bool[Array, ""]], None]:
        key, state = shared
        trials, advantages, expected = judged
        seen = self._seen(state, trials)
        return self.value.fit(key, state.value, seen, advantages + expected), None

    @staticmethod
    def _seen(state: RecurrentMetaState, trials: Trials) -> Trials:
        """Return trials with the inputs that the policy's network reads."""
        return replace(trials, inputs=state.policy.seen(trials.inputs))

    def advantages(
        self, trials: Trials, expected: Float[Array, "trial time"]
    ) -> Float[Array, "trial time"]:
        """Return the advantage of every step, over the whole trial and not standardised.

        Args:
            trials: the trials to learn from.
            expected: V_t.
        """
        return jax.vmap(trial_advantages, in_axes=(0, 0, 0, None, None))(
            trials.reward, expected, trials.valid, self.discount, self.gae_lambda
        )


class _Judged(NamedTuple):
    """Trials, and what the value function says of them."""

    trials: Trials
    advantages: Float[Array, "trial time"]
    expected: Float[Array, "trial time"]


def _describe(shared: Any, rows: Any) -> tuple[RecurrentInfo, None]:
    (value_accepted, policy_step), (episodes, (trials, advantages, expected)) = shared, rows
    first, last = episodes[0], episodes[-1]
    valid, behaviour = trials.valid, trials.behaviour
    return RecurrentInfo(
        return_before=mesh.mean(first.undiscounted_return.mean()),
        return_after=mesh.mean(last.undiscounted_return.mean()),
        success_after=mesh.mean(last.success.mean()),
        action_std=mesh.mean_of_valid(behaviour.std().mean(-1), valid),
        entropy=mesh.mean_of_valid(behaviour.entropy(), valid),
        explained_variance=explained_variance(advantages, expected, valid),
        value_accepted=value_accepted,
        policy_step=policy_step,
    ), None
