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

from maesn.axes import Key
from maesn.experience.episodes import Episodes
from maesn.learners.meta import Problem
from maesn.learners.meta_batch import check_enough_tasks
from maesn.learners.policy_steps import AbstractPolicyStep, ProximalStep
from maesn.learners.recurrent.value import RecurrentValue
from maesn.learners.trial_meta import (
    AbstractTrialMetaLearner,
    RecurrentFastLearner,
    TrialInfo,
    describe_trials,
)
from maesn.learners.trial_value import ValueState
from maesn.learners.trials import Trials, join_episodes
from maesn.numerics import at_once, standardize
from maesn.policies import AbstractPolicy, AbstractPolicySettings, Recurrent


class RecurrentMetaState(eqx.Module):
    """State of a `RecurrentMetaLearner`."""

    policy: AbstractPolicy
    opt_state: Any
    """State of the policy's optimiser."""
    value: ValueState
    iteration: Int[Array, ""]


class RecurrentMetaLearner(AbstractTrialMetaLearner[RecurrentMetaState, TrialInfo]):
    """Plays trials and improves a recurrent policy on them."""

    policy: AbstractPolicySettings = Recurrent()
    """The policy's network."""
    policy_step: AbstractPolicyStep = ProximalStep()
    """How the policy is improved: `ProximalStep` (PPO) or `TrustRegionStep` (TRPO)."""
    value: RecurrentValue = RecurrentValue()
    """The value function that advantages are measured from."""
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
        if self.trial_episodes > 1 and not self.policy.is_recurrent:
            raise ValueError(
                f"`trial_episodes` is {self.trial_episodes}, but a policy of `"
                f"{type(self.policy).__name__}` is not recurrent and learns nothing from one "
                "episode for the next: choose `Recurrent`, or trials of 1 episode."
            )

    def init(self, key: Key, problem: Problem) -> RecurrentMetaState:
        check_enough_tasks(problem.num_tasks, self.meta_batch_size)
        policy_key, value_key = jax.random.split(key)
        sizes = problem.observation_size, problem.action_size
        policy = self.policy.init(policy_key, *sizes, 0)
        value = self.value.init(value_key, *sizes)
        opt_state = self.policy_step.init(policy)
        return RecurrentMetaState(policy, opt_state, value, jnp.zeros((), int))

    def weights(self, state: RecurrentMetaState) -> AbstractPolicy:
        return state.policy

    def effort(self, steps: int, iterations: int) -> int:
        return 2 * steps  # policy and value go through trials step by step

    def slots(self) -> tuple[Any, ...]:
        """Return how the policy is improved."""
        return (type(self), type(self.policy_step))

    def fast_learner(self, state: RecurrentMetaState) -> RecurrentFastLearner:
        return RecurrentFastLearner(state.policy, self.trial_episodes)

    def improved(
        self, key: Key, state: RecurrentMetaState, episodes: tuple[Episodes, ...]
    ) -> tuple[RecurrentMetaState, TrialInfo]:
        policy_key, value_key = jax.random.split(key)
        judged = self._judge(state, episodes)
        (policy, opt_state, step), (value, accepted) = at_once(
            partial(self._improve_policy, policy_key, state, judged),
            partial(self._fit_value, value_key, state, judged),
        )
        info = _describe(episodes, judged, accepted, step)
        return RecurrentMetaState(policy, opt_state, value, state.iteration + 1), info

    @eqx.filter_jit
    def _judge(self, state: RecurrentMetaState, episodes: tuple[Episodes, ...]) -> "_Judged":
        trials = join_episodes(episodes)
        expected = self.value.values(state.value, self._seen(state, trials))
        return _Judged(trials, self.advantages(trials, expected), expected)

    @eqx.filter_jit
    def _improve_policy(
        self, key: Key, state: RecurrentMetaState, judged: "_Judged"
    ) -> tuple[AbstractPolicy, Any, Any]:
        trials, advantages, _ = judged
        standard = standardize(advantages, trials.valid)
        policy, opt_state, step = self.policy_step(
            key, state.policy, state.opt_state, trials, standard
        )
        policy = self.policy.after_iteration(policy, state.iteration + 1)
        return policy, opt_state, step

    @eqx.filter_jit
    def _fit_value(
        self, key: Key, state: RecurrentMetaState, judged: "_Judged"
    ) -> tuple[ValueState, Bool[Array, ""]]:
        trials, advantages, expected = judged
        seen = self._seen(state, trials)
        return self.value.fit(key, state.value, seen, advantages + expected)

    @staticmethod
    def _seen(state: RecurrentMetaState, trials: Trials) -> Trials:
        return replace(trials, inputs=state.policy.seen(trials.inputs))


class _Judged(NamedTuple):
    """Trials, and what the value function says of them."""

    trials: Trials
    advantages: Float[Array, "trial time"]
    expected: Float[Array, "trial time"]


@eqx.filter_jit
def _describe(
    episodes: tuple[Episodes, ...], judged: _Judged, value_accepted: Bool[Array, ""], step: Any
) -> TrialInfo:
    told = describe_trials(episodes, *judged)
    return TrialInfo(**told, value_accepted=value_accepted, policy_step=step)
