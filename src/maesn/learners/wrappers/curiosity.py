"""Curiosity: a bonus for information about the dynamics of the world, as in VIME.

A Bayesian neural network models p(s' | s, a). The bonus of a transition is its information gain on
the network's weights, KL(posterior after it || posterior before it). Nothing here depends on a task
or a learner: `maesn.learners.wrappers.bonus` adds the bonus to the rewards of any learner.

Source: Houthooft et al., "VIME: Variational Information Maximizing Exploration" (2016),
https://arxiv.org/abs/1605.09674. "Published code" below is the authors'.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.experience.episodes import Episodes
from maesn.networks import BayesianNetwork, init_bayesian_network
from maesn.numerics import DiagonalGaussian, Ring, first_order_step
from maesn.settings import check_least, check_positive, check_sizes

# Number of transitions whose gradients are held at once; bounds the memory.
CHUNK_SIZE = 256
# Standard deviations beyond which inputs and changes are cut off: contacts have heavy tails.
FEATURE_CLIP = 10.0


class Transitions(NamedTuple):
    """Transitions of all episodes, one after another."""

    rows: Float[Array, "transition feature"]
    """Observation, action, and change of the observation, side by side."""
    valid: Bool[Array, " transition"]
    """False for steps beyond the end of an episode, and where an observation is not finite."""


class Scale(NamedTuple):
    """Mean and standard deviation of each feature of the pool."""

    mean: Float[Array, " feature"]
    std: Float[Array, " feature"]

    def __call__(self, row: Float[Array, " feature"]) -> Float[Array, " feature"]:
        """Return the standardised features of one transition."""
        return jnp.clip((row - self.mean) / self.std, -FEATURE_CLIP, FEATURE_CLIP)


def transitions(episodes: Episodes) -> Transitions:
    """Return the transitions of all steps of all episodes."""
    before, after = episodes.observation[..., :-1, :], episodes.observation[..., 1:, :]
    finite = jnp.isfinite(before).all(-1) & jnp.isfinite(after).all(-1)
    rows = jnp.concatenate([before, episodes.action, after - before], axis=-1)
    return Transitions(rows.reshape(-1, rows.shape[-1]), (episodes.valid & finite).reshape(-1))


class CuriosityState(eqx.Module):
    """One model of the dynamics and its training data: arrays only."""

    network: BayesianNetwork
    opt_state: Any
    """State of Adam."""
    pool: Ring
    """Transitions to learn from, a replay buffer."""
    medians: Ring
    """Median information gains of the last batches."""
    has_learned: Bool[Array, ""]
    """Whether the network has been trained at all."""

    @property
    def scale(self) -> Scale:
        """Mean and standard deviation of the features in the pool."""
        return Scale(*self.pool.moments())

    @property
    def typical_gain(self) -> Float[Array, ""]:
        """Mean of `medians`; 0 if there are none."""
        mean, _ = self.medians.moments()
        return mean[0]


class CuriosityBonus(eqx.Module):
    """How a bonus is computed: r'(s, a, s') = r + weight * gain(s, a, s') / typical gain.

    The typical gain is the mean of the median gains of the last batches. An untrained model gives
    no bonus, as in the published code: its gains are so large that their median would leave hardly
    any bonus to the next batches.

    Methods are written for one model; callers map them over tasks.
    """

    weight: float = 1e-4
    """eta, the bonus of a transition of typical information gain. Published: 1e-4."""
    hidden_sizes: tuple[int, ...] = (32,)
    """Widths of the network's hidden layers. Published: 32."""
    prior_std: float = 0.5
    """Standard deviation of every weight under the prior, and at the start. Published: 0.5."""
    likelihood_std: float = 0.5
    """Standard deviation of the model's noise, in standard deviations of the changes. (Published
    code: 5, with the divergence from the prior weighted as if there were 50 transitions.)"""
    samples: int = 10
    """Draws of the network's weights in each expectation. Published: 10."""
    learning_rate: float = 1e-3
    """Learning rate of Adam. Published: 1e-3 by default, 1e-4 in the experiments with ten times the
    updates."""
    updates: int = 500
    """Steps of Adam after each batch of episodes. Published: 500 by default, 5000 in the
    experiments, whose batches were five times as large."""
    batch_size: int = 10
    """Transitions per step of Adam. Published: 10."""
    pool_size: int = 20_000
    """Transitions that the pool holds. Published: 1e5 by default, 1e6 in the experiments, for one
    task."""
    pool_additions: int = 500
    """Transitions of each batch that enter the pool, drawn at random. (Published code: all.)"""
    median_window: int = 10
    """Number of batches whose median gains are averaged. Published: 10."""

    def __check_init__(self) -> None:
        check_least(
            self, samples=1, batch_size=1, pool_size=1, pool_additions=1, median_window=1, updates=0
        )
        check_positive(self, "prior_std", "likelihood_std", "learning_rate")
        if not 0 <= self.weight < math.inf:
            raise ValueError(f"`weight` must be at least 0 and finite, got {self.weight}.")
        check_sizes(self, "hidden_sizes")

    def init(self, key: Key, observation_size: int, action_size: int) -> CuriosityState:
        """Return an untrained model; raises `ValueError` if there is nothing to predict."""
        if observation_size < 1:
            raise ValueError(
                f"`observation_size` must be at least 1, got {observation_size}: curiosity "
                "predicts observations, and there are none."
            )
        sizes = (observation_size + action_size, *self.hidden_sizes, observation_size)
        network = init_bayesian_network(key, sizes, self.prior_std)
        pool = Ring.empty(self.pool_size, jnp.zeros(network.input_size + network.output_size))
        opt_state = optax.adam(self.learning_rate).init(network)
        medians = Ring.empty(self.median_window, jnp.zeros(1))
        return CuriosityState(network, opt_state, pool, medians, jnp.zeros((), bool))

    def start(self, trained: CuriosityState) -> CuriosityState:
        """Return a new state with the network and the pool of another one.

        The pool's moments standardise the network's inputs and outputs, so both go together.
        """
        opt_state = optax.adam(self.learning_rate).init(trained.network)
        medians = Ring.empty(self.median_window, jnp.zeros(1))
        return replace(trained, opt_state=opt_state, medians=medians)

    def judge(
        self, key: Key, state: CuriosityState, episodes: Episodes
    ) -> tuple[CuriosityState, Float[Array, "*batch time"]]:
        """Return the bonus of every step under the present model; 0 where invalid.

        The new state holds some of the transitions and their median gain; `learn` trains on them
        later. For an untrained model the bonus is 0, and no median is kept. The episodes may be
        those of any number of tasks with the same dynamics.
        """
        pool_key, noise_key = jax.random.split(key)
        played = transitions(episodes)
        drawn = jax.random.permutation(pool_key, len(played.valid))
        # In the order drawn, but valid ones before the others.
        chosen = drawn[jnp.argsort(~played.valid[drawn])][: self.pool_additions]
        pool = state.pool.extend(played.rows[chosen], played.valid[chosen])
        state = replace(state, pool=pool)
        gain = self.information_gains(noise_key, state.network, state.scale, played)
        median = jnp.nanmedian(jnp.where(played.valid, gain, jnp.nan))
        has_median = state.has_learned & played.valid.any()
        medians = state.medians.extend(median[None, None], has_median[None])
        state = replace(state, medians=medians)
        typical = state.typical_gain
        bonus = jnp.where(typical > 0, self.weight * gain / typical, 0.0)
        return state, bonus.reshape(episodes.valid.shape)

    def information_gains(
        self, key: Key, network: BayesianNetwork, scale: Scale, played: Transitions
    ) -> Float[Array, " transition"]:
        """Return the information gain of each transition, in nats for a step of size 1.

        All transitions use the same draws of the weights, so that gains differ by the transitions
        alone. The step size cancels in the bonus.
        """
        noise = jax.random.normal(key, (self.samples, network.noise_size))

        def gain(transition: tuple[Array, Array]) -> Float[Array, ""]:
            row, valid = transition
            finite_row = jnp.where(valid, row, scale.mean)
            gradient = jax.grad(self.surprise)(network, scale(finite_row), noise)
            return jnp.where(valid, network.information_gain(gradient), 0.0)

        return jax.lax.map(gain, tuple(played), batch_size=CHUNK_SIZE)

    def surprise(
        self,
        network: BayesianNetwork,
        row: Float[Array, " feature"],
        noise: Float[Array, "sample unit"],
    ) -> Float[Array, ""]:
        """Return -E_q[log p(change | observation, action, weights)] of one transition, in nats.

        `row` holds its standardised features, `noise` standard normal numbers for each draw of the
        weights.
        """
        inputs = network.input_size
        predicted = jax.vmap(network, in_axes=(None, 0))(row[:inputs], noise)
        log_std = jnp.full_like(predicted, jnp.log(self.likelihood_std))
        return -DiagonalGaussian(predicted, log_std).log_prob(row[inputs:]).mean()

    def objective(
        self,
        network: BayesianNetwork,
        rows: Float[Array, "transition feature"],
        noise: Float[Array, "transition sample unit"],
        number: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Negative evidence lower bound per transition.

            -mean_n E_q[log p(x_n | w)] + KL(q(w) || p(w)) / N,   p(w) = N(0, prior_std²)

        Args:
            network: the model.
            rows: standardised transitions x_n, a minibatch.
            noise: standard normal noise of each draw of the weights.
            number: N, the number of transitions in the pool.
        """
        surprise = jax.vmap(self.surprise, in_axes=(None, 0, 0))(network, rows, noise).mean()
        posterior = network.posterior
        prior_std = jnp.full_like(posterior.log_std, jnp.log(self.prior_std))
        prior = DiagonalGaussian(jnp.zeros_like(posterior.mean), prior_std)
        return surprise + posterior.kl(prior) / number

    def learn(self, key: Key, state: CuriosityState) -> CuriosityState:
        """Return the state after `updates` steps of Adam on the transitions of the pool."""
        adam, scale = optax.adam(self.learning_rate), state.scale
        number = jnp.maximum(state.pool.size, 1).astype(float)

        def step(now: tuple[BayesianNetwork, Any], step_key: Key) -> Any:
            network, opt_state = now
            row_key, noise_key = jax.random.split(step_key)
            rows = jax.vmap(scale.__call__)(state.pool.sample(row_key, self.batch_size))
            shape = (self.batch_size, self.samples, network.noise_size)
            noise = jax.random.normal(noise_key, shape)
            gradient = jax.grad(self.objective)(network, rows, noise, number)
            return first_order_step(adam, network, gradient, opt_state), None

        start = (state.network, state.opt_state)
        (network, opt_state), _ = jax.lax.scan(step, start, jax.random.split(key, self.updates))
        has_learned = jnp.ones_like(state.has_learned)
        return replace(state, network=network, opt_state=opt_state, has_learned=has_learned)
