"""VariBAD: acts on a learned belief about the task (Zintgraf et al. 2020).

https://arxiv.org/abs/1910.08348. A recurrent encoder turns the steps of a trial into a posterior
over a latent, which a decoder predicts rewards from. The policy sees the posterior's mean and
spread, and learns on whole trials what it is worth to find out. With a bonus it is HyperX.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Key, ObservedReward
from maesn.experience.episodes import Episodes
from maesn.learners.meta import Problem, TaskBelief
from maesn.learners.meta_batch import check_enough_tasks
from maesn.learners.policy_steps import AbstractPolicyStep, ProximalStep
from maesn.learners.trial_meta import (
    AbstractTrialMetaLearner,
    RecurrentFastLearner,
    TrialInfo,
    describe_trials,
)
from maesn.learners.trial_value import ValueState
from maesn.learners.trials import Trials, join_episodes
from maesn.learners.varibad.bonus import BonusState, HyperBonus
from maesn.learners.varibad.decoder import BeliefDecoderSettings, Decoder
from maesn.learners.varibad.encoder import BeliefEncoderSettings
from maesn.learners.varibad.inference import BeliefInference, InferenceInfo
from maesn.learners.varibad.policy import BeliefPolicy, side_by_side
from maesn.learners.varibad.steps import Steps, empty_buffer, steps_of
from maesn.learners.varibad.value import BeliefValue
from maesn.numerics import (
    DiagonalGaussian,
    MinibatchDescent,
    Ring,
    if_finite,
    masked_mean,
    standardize,
)
from maesn.numerics.normalization import no_observations
from maesn.policies import AbstractPolicySettings, GaussianMLP
from maesn.settings import check_choice

# Of policy and value in the reference.
PUBLISHED_DESCENT = MinibatchDescent(learning_rate=7e-4, epochs=2, minibatches=4)
# Bytes that the buffer of trials takes at most. The newest checkpoint holds it.
MOST_BUFFER_BYTES = 150_000_000
_DRAWS = 64  # of m, whose predictions a belief averages


class BeliefNetworks(eqx.Module):
    """The policy with its belief, and what the belief predicts."""

    policy: BeliefPolicy
    decoder: Decoder


class VaribadState(eqx.Module):
    """State of a `VaribadMetaLearner`."""

    networks: BeliefNetworks
    opt_state: Any
    """State of the policy's optimiser."""
    inference: Any
    """State of Adam of encoder and decoder."""
    value: ValueState
    bonus: BonusState | None
    buffer: Ring
    iteration: Int[Array, ""]


class VaribadInfo(TrialInfo):
    """Info of one meta-iteration: scalars only."""

    bonus: Float[Array, ""]
    """Mean bonus of a step, in the unit of rewards."""
    bonus_accepted: Bool[Array, ""]
    """False if the bonus or its networks were not finite: none is given, and they stay."""
    inference: InferenceInfo
    inference_accepted: Bool[Array, ""]
    """False if encoder or decoder were not finite: they stay as they were."""


class VaribadMetaLearner(AbstractTrialMetaLearner[VaribadState, VaribadInfo]):
    """Plays trials, and learns from them to believe and to act."""

    encoder: BeliefEncoderSettings = BeliefEncoderSettings()
    """The posterior over the latent."""
    decoder: BeliefDecoderSettings = BeliefDecoderSettings()
    """What the latent predicts."""
    inference: BeliefInference = BeliefInference()
    """How encoder and decoder learn."""
    policy: AbstractPolicySettings = GaussianMLP()
    """The policy's network, which sees observation and belief."""
    policy_step: AbstractPolicyStep = ProximalStep(0.1, 0.01, PUBLISHED_DESCENT)
    """How the policy is improved: `ProximalStep` (PPO) or `TrustRegionStep` (TRPO). Reference: clip
    0.05 on GridNavi, 0.1 on point goals; entropy weight 0.01 and 0.001; 4 and 8 minibatches."""
    value: BeliefValue = BeliefValue(descent=PUBLISHED_DESCENT)
    """The value function that advantages are measured from."""
    bonus: HyperBonus = HyperBonus()
    """The bonus of HyperX; none by default."""
    observed_reward: ObservedReward = "own"
    """Reward that the encoder sees and the decoder predicts: the world's own, or the sparse one
    while the policy learns from the dense one."""
    meta_batch_size: int = 16
    """Training tasks per meta-iteration, drawn without replacement. In each of them
    `episodes_per_task` trials are played in parallel. Reference: 16, one trial each."""
    trial_episodes: int = 2
    """Episodes of a trial. Reference: 4 on GridNavi, 3 on point goals, 2 elsewhere."""
    discount: float = 0.95
    """Discount factor gamma of the rewards, across the episodes of a trial. Reference: 0.95 on
    GridNavi, 0.99 on point goals, 0.97 elsewhere."""
    gae_lambda: float = 0.95
    """lambda of generalised advantage estimation. Reference: 0.95 on GridNavi, 0.9 elsewhere."""

    def __check_init__(self) -> None:
        check_choice("observed_reward", self.observed_reward, ObservedReward)

    def init(self, key: Key, problem: Problem) -> VaribadState:
        check_enough_tasks(problem.num_tasks, self.meta_batch_size)
        keys = jax.random.split(key, 5)
        latent, sizes = self.encoder.latent_size, (problem.observation_size, problem.action_size)
        encoder = self.encoder.init(keys[0], *sizes)
        decoder = self.decoder.init(keys[1], latent, *sizes)
        seen = problem.observation_size + 2 * latent
        inner = self.policy.init(keys[2], seen, problem.action_size, 0)
        policy = BeliefPolicy(encoder, inner, no_observations(seen), self.observed_reward)
        return VaribadState(
            networks=BeliefNetworks(policy, decoder),
            opt_state=self.policy_step.init(inner),
            inference=self.inference.init(encoder, decoder),
            value=self.value.init(keys[3], seen, problem.action_size),
            bonus=self.bonus.init(keys[4], seen),
            buffer=empty_buffer(*self._capacity(problem), *sizes),
            iteration=jnp.zeros((), int),
        )

    def _capacity(self, problem: Problem) -> tuple[int, int]:
        """Return how many trials the buffer holds, and of how many steps."""
        time = self.trial_episodes * problem.horizon
        # Numbers of a step: the fields of `Steps`.
        features = 2 * problem.observation_size + problem.action_size + 2
        most = MOST_BUFFER_BYTES // (4 * features * time)
        return max(min(self.inference.buffer_trials, most), 1), time

    def weights(self, state: VaribadState) -> BeliefNetworks:
        return state.networks

    def replay(self, state: VaribadState) -> Ring:
        return state.buffer

    @eqx.filter_jit
    def belief(
        self,
        state: VaribadState,
        episodes: Sequence[Episodes],
        places: Float[ArrayLike, "place observation"],
    ) -> TaskBelief:
        policy, decoder = state.networks.policy, state.networks.decoder
        belief = jax.vmap(policy.encoder.posteriors)(steps_of(episodes))
        noise = jax.random.normal(jax.random.key(0), (_DRAWS, self.encoder.latent_size))
        actions = episodes[0].action.shape[-1]

        def predicted(mean: Array, std: Array) -> Array:
            expected = partial(self.decoder.expected, decoder, jnp.asarray(places), actions)
            return jax.vmap(lambda one: expected(mean + std * one))(noise).mean(0)

        std = belief.std()
        return TaskBelief(belief.mean, std, jax.vmap(jax.vmap(predicted))(belief.mean, std))

    def effort(self, steps: int, iterations: int) -> int:
        return 4 * steps  # encoder, decoder and policy go through trials step by step

    def fast_learner(self, state: VaribadState) -> RecurrentFastLearner:
        """Return the learner of new tasks: without noise, as the reference evaluates it."""
        return RecurrentFastLearner(state.networks.policy, self.trial_episodes, is_noisy=False)

    @eqx.filter_jit
    def improved(
        self, key: Key, state: VaribadState, episodes: tuple[Episodes, ...]
    ) -> tuple[VaribadState, VaribadInfo]:
        keys = jax.random.split(key, 4)
        policy, decoder = state.networks.policy, state.networks.decoder
        steps = steps_of(episodes)
        beliefs = jax.vmap(policy.encoder.posteriors)(steps)
        trials, raw = self._seen(policy, join_episodes(episodes), beliefs)
        (bonus, bonus_state), bonus_accepted = self._bonus(keys[0], state, steps, beliefs, trials)
        rewarded = replace(trials, reward=trials.reward + bonus)

        expected = self.value.values(state.value, rewarded)
        advantages = self.advantages(rewarded, expected)
        inner, opt_state, step = self.policy_step(
            keys[1],
            policy.policy,
            state.opt_state,
            rewarded,
            standardize(advantages, trials.valid),
        )
        inner = self.policy.after_iteration(inner, state.iteration + 1)
        value, value_accepted = self.value.fit(
            keys[2], state.value, rewarded, advantages + expected
        )
        buffer = state.buffer.extend(steps, jnp.ones(len(steps.valid), bool))
        encoder, decoder, adam, inference, inference_accepted = self.inference.learn(
            keys[3], policy.encoder, self.decoder, decoder, state.inference, buffer
        )
        statistics = policy.statistics.with_batch(raw, trials.valid)
        policy = BeliefPolicy(encoder, inner, statistics, self.observed_reward)
        info = VaribadInfo(
            **describe_trials(episodes, trials, advantages, expected),
            bonus=masked_mean(bonus, trials.valid),
            bonus_accepted=bonus_accepted,
            value_accepted=value_accepted,
            policy_step=step,
            inference=inference,
            inference_accepted=inference_accepted,
        )
        after = VaribadState(
            BeliefNetworks(policy, decoder),
            opt_state,
            adam,
            value,
            bonus_state,
            buffer,
            state.iteration + 1,
        )
        return after, info

    def _seen(
        self, policy: BeliefPolicy, trials: Trials, beliefs: DiagonalGaussian
    ) -> tuple[Trials, Float[Array, "trial time seen"]]:
        """Return the trials as the policy saw them, and that before it is normalised."""
        before = jax.tree.map(lambda x: x[:, :-1], beliefs)
        raw = side_by_side(trials.inputs.observation, before)
        inputs = trials.inputs._replace(observation=policy.statistics.normalized(raw))
        return replace(trials, inputs=inputs), raw

    def _bonus(
        self, key: Key, state: VaribadState, steps: Steps, beliefs: DiagonalGaussian, trials: Trials
    ) -> tuple[tuple[Float[Array, "trial time"], BonusState | None], Bool[Array, ""]]:
        """Return the bonus of each step and the state of what learns it, and whether both hold."""
        if state.bonus is None:
            return (jnp.zeros_like(trials.reward), None), jnp.array(True)
        noise_key, learn_key = jax.random.split(key)
        policy, decoder = state.networks.policy, state.networks.decoder
        after = jax.tree.map(lambda x: x[:, 1:], beliefs)
        m = after.sample_from_noise(after.noise(noise_key, after.mean.shape))

        def error(m: Array, step: Steps) -> Float[Array, ""]:
            one = jax.tree.map(lambda x: x[None], step)
            return self.decoder.surprise(decoder, m, one)[0]

        errors = jax.vmap(jax.vmap(error))(m, steps)
        seen = policy.hyper_state(steps.next_observation, after)
        bonus, judged = self.bonus.judge(
            state.bonus, state.iteration, seen, errors, trials.reward, steps.valid, self.discount
        )
        learned = self.bonus.learn(learn_key, judged, seen, steps.valid)
        return if_finite((bonus, learned), (jnp.zeros_like(bonus), state.bonus))
