"""What VariBAD believes, what it learns to believe, and the bonus of HyperX."""

import itertools
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from maesn import BeliefDecoderSettings, BeliefEncoderSettings, BeliefInference, HyperBonus
from maesn.learners.varibad.decoder import Decoder
from maesn.learners.varibad.encoder import BeliefEncoder
from maesn.learners.varibad.inference import Draws, previous
from maesn.learners.varibad.steps import Steps, empty_buffer
from maesn.numerics import DiagonalGaussian

TIME, LATENT, OBSERVATION, ACTION = 6, 3, 2, 2
VALID = np.array([True, True, False, False, True, True])  # a gap between two episodes


@cache
def encoder() -> BeliefEncoder:
    return BeliefEncoderSettings(LATENT, (5,), 4, (6,)).init(jax.random.key(3), OBSERVATION, ACTION)


@cache
def trial(seed: int = 0) -> Steps:
    """One trial whose observations are cells of a grid of 3 x 2."""
    stream = np.random.default_rng(seed)

    def masked(x: np.ndarray) -> jax.Array:
        return jnp.asarray(np.where(VALID.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0), float)

    cells = stream.integers(0, [3, 2], (2, TIME, 2))
    return Steps(
        masked(cells[0]),
        masked(stream.normal(size=(TIME, ACTION))),
        masked(stream.choice([-0.1, 1.0], TIME)),
        masked(cells[1]),
        jnp.asarray(VALID),
    )


def draws(seed: int = 0) -> Draws:
    noise = jax.random.normal(jax.random.key(seed), (TIME + 1, LATENT))
    return Draws(noise, jnp.asarray([6, 0, 3, 1]), jnp.asarray([4, 0, 2]))


def mlp(network: Any, x: np.ndarray) -> np.ndarray:
    for layer in network.layers[:-1]:
        x = np.maximum(x @ np.float64(layer.weight) + np.float64(layer.bias), 0.0)
    return x @ np.float64(network.layers[-1].weight) + np.float64(network.layers[-1].bias)


def reference_loss(
    settings: BeliefDecoderSettings,
    decoder: Decoder,
    inference: BeliefInference,
    steps: Steps,
    drawn: Draws,
) -> tuple[float, float]:
    """The loss and the ELBO with weight 1, by loops over prefixes and steps."""
    q = encoder().posteriors(steps)
    mean, std = np.float64(q.mean), np.exp(np.float64(q.log_std))
    kls, reconstructions = [], []
    for t in range(TIME + 1):
        if t and not VALID[t - 1]:
            continue
        m0, s0 = (mean[t - 1], std[t - 1]) if t else (np.zeros(LATENT), np.ones(LATENT))
        terms = np.log(s0 / std[t]) + (std[t] ** 2 + (mean[t] - m0) ** 2) / (2 * s0**2) - 0.5
        kls.append(terms.sum())
    for t in np.asarray(drawn.prefixes):
        m = mean[t] + std[t] * np.asarray(drawn.noise[t])
        for k in np.asarray(drawn.decoded):
            if (t and not VALID[t - 1]) or not VALID[k]:
                continue
            o, a, r, after, _ = (np.float64(x[k]) for x in steps)
            if settings.cells:
                column, row = after.astype(int)
                predicted = mlp(decoder.reward, m)[column * settings.cells[1] + row]
            else:
                predicted = mlp(decoder.reward, np.concatenate([m, o, a, after]))[0]
            if settings.likelihood == "bernoulli":
                p = 1 / (1 + np.exp(-predicted))
                surprise = -np.log(p if r > 0 else 1 - p)
            else:
                surprise = (predicted - r) ** 2 / (2 * settings.reward_std**2)
            if settings.transitions:
                error = mlp(decoder.transition, np.concatenate([m, o, a])) - after
                surprise += (error**2).sum() / (2 * settings.transition_std**2)
            reconstructions.append(surprise)
    reconstruction = np.mean(reconstructions) * VALID.sum()
    kl = np.mean(kls)
    return reconstruction + inference.kl_weight * kl, -reconstruction - kl


LIKELIHOODS = [
    BeliefDecoderSettings((7,), "bernoulli", (3, 2)),
    BeliefDecoderSettings((7,), "bernoulli"),
    BeliefDecoderSettings((7,), "gaussian", (3, 2), reward_std=0.4, transitions=True),
    BeliefDecoderSettings((7,), "gaussian", transitions=True, transition_std=0.2),
]


@pytest.mark.parametrize("settings", LIKELIHOODS)
def test_the_loss_equals_loops_over_prefixes_and_steps(settings: BeliefDecoderSettings) -> None:
    decoder, inference = settings.init(jax.random.key(1), LATENT, 2, ACTION), BeliefInference(0.3)
    loss, info = eqx.filter_jit(inference.loss)(encoder(), settings, decoder, trial(), draws())
    expected, elbo = reference_loss(settings, decoder, inference, trial(), draws())
    assert float(loss) == pytest.approx(expected, rel=1e-5)
    assert float(info.elbo) == pytest.approx(elbo, rel=1e-5)


def test_gradients_equal_finite_differences(x64: None) -> None:
    settings = BeliefDecoderSettings((7,), "bernoulli", (3, 2))
    networks = (encoder(), settings.init(jax.random.key(1), LATENT, 2, ACTION))
    # Beside the kink where a trial begins: a state of 0, and biases of 0.
    networks = jax.tree.map(lambda x: x.astype(jnp.float64) + 0.01, networks)
    steps, drawn = jax.tree.map(
        lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, (trial(), draws())
    )

    def loss(one: Any, decoder: Any) -> Any:
        return BeliefInference(0.3).loss(one, settings, decoder, steps, drawn)[0]

    check_grads(jax.jit(loss), networks, order=1, modes=["rev"], eps=1e-6)


def test_a_belief_is_one_step_after_another_and_gaps_change_nothing() -> None:
    one, steps = encoder(), trial()
    hidden, expected = one.initial(), [one.posterior(one.initial())]
    for t in range(TIME):
        if VALID[t]:
            hidden = one.advance(
                hidden, steps.action[t], steps.reward[t], steps.next_observation[t]
            )
        expected.append(one.posterior(hidden))
    beliefs = one.posteriors(steps)
    for name in ("mean", "log_std"):
        np.testing.assert_allclose(
            getattr(beliefs, name), [getattr(q, name) for q in expected], rtol=1e-5, atol=1e-6
        )


# A bandit of two tasks, of which everything can be enumerated. One arm pays with probability 0.9 or
# 0.2.

PULLS, CHANCES = 4, np.array([0.9, 0.2])


def sequences() -> np.ndarray:
    return np.array(list(itertools.product((0.0, 1.0), repeat=PULLS)))


def chance_of(rewards: np.ndarray) -> np.ndarray:
    """Probability of some rewards in each of the tasks."""
    return np.prod(np.where(rewards[:, None] > 0, CHANCES, 1 - CHANCES), axis=0)


def pulls(rewards: np.ndarray) -> Steps:
    """Trials of rewards `[*trial, pull]`."""
    nothing = jnp.zeros((*rewards.shape, 1))
    valid = jnp.ones(rewards.shape, bool)
    return Steps(nothing, nothing + 1, jnp.asarray(rewards, float), nothing, valid)


def test_the_bound_falls_short_of_the_evidence_by_the_divergence_from_the_true_posterior() -> None:
    """log p(τ) - ELBO_0 = KL(q_0 || p(m | τ)), for every sequence of rewards τ.

    The expectation over m is a quadrature, whose nodes are the noise of the draws.
    """
    settings = BeliefDecoderSettings((), "bernoulli")  # no kinks, which a quadrature would miss
    one = BeliefEncoderSettings(1, (5,), 4).init(jax.random.key(0), 1, 1)
    decoder = settings.init(jax.random.key(2), 1, 1, 1)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights /= weights.sum()
    m = np.linspace(-9.0, 9.0, 4001)
    seen = np.stack([m, 0 * m, 0 * m + 1, 0 * m], axis=1)
    paid = 1 / (1 + np.exp(-mlp(decoder.reward, seen)[:, 0]))
    prior = np.exp(-(m**2) / 2)
    prior /= prior.sum()
    mean_bound = 0.0

    @jax.jit
    def believed(steps: Steps) -> Any:
        def reconstruction(node: Any) -> Any:
            drawn = Draws(jnp.full((PULLS + 1, 1), node), jnp.arange(1), jnp.arange(PULLS))
            return BeliefInference().loss(one, settings, decoder, steps, drawn)[1].reconstruction

        q = one.posteriors(steps)
        return q, q.kl(previous(q))[0], jax.vmap(reconstruction)(jnp.asarray(nodes, float))

    for rewards in sequences():
        q, divergence, expected = believed(pulls(rewards))
        bound = -(weights @ np.asarray(expected)) - float(divergence)
        likelihood = np.prod(np.where(rewards > 0, paid[:, None], 1 - paid[:, None]), axis=1)
        evidence = (prior * likelihood).sum()
        q_0 = np.exp(-((m - float(q.mean[0, 0])) ** 2) / (2 * np.exp(2 * float(q.log_std[0, 0]))))
        q_0 /= q_0.sum()
        gap = (q_0 * np.log(q_0 / (prior * likelihood / evidence))).sum()
        assert np.log(evidence) - bound == pytest.approx(gap, rel=1e-3, abs=1e-5)
        mean_bound += 0.5 * chance_of(rewards).sum() * bound
    # No model predicts the rewards of the two tasks better than the tasks do.
    truth = np.array([0.5 * chance_of(rewards).sum() for rewards in sequences()])
    assert mean_bound < (truth * np.log(truth)).sum()


def test_a_learned_belief_predicts_the_rewards_of_a_trial_as_bayes_does() -> None:
    """All steps look alike, so the best prediction is the mean of those known and of the rest."""
    stream = np.random.default_rng(0)
    number = 3000
    task = stream.integers(0, 2, number)
    rewards = (stream.random((number, PULLS)) < CHANCES[task][:, None]).astype(np.float32)
    buffer = empty_buffer(number, PULLS, 1, 1).extend(pulls(rewards), jnp.ones(number, bool))
    settings = BeliefDecoderSettings((16,), "bernoulli")
    inference = BeliefInference(kl_weight=1e-3, updates=800, batch_size=64, learning_rate=5e-3)
    one = BeliefEncoderSettings(2, (8,), 16).init(jax.random.key(0), 1, 1)
    decoder = settings.init(jax.random.key(2), 2, 1, 1)
    one, decoder, _, _, accepted = jax.jit(inference.learn, static_argnums=(2,))(
        jax.random.key(1), one, settings, decoder, inference.init(one, decoder), buffer
    )
    assert bool(accepted)
    every = sequences()
    beliefs = jax.vmap(one.posteriors)(pulls(every))
    m = beliefs.sample_from_noise(jax.random.normal(jax.random.key(5), (400, *beliefs.mean.shape)))
    step = jax.tree.map(lambda x: x[0, :1], pulls(every))
    logits = jax.vmap(lambda m: settings.rewards(decoder, m, step)[0])(m.reshape(-1, 2))
    predicted = np.asarray(jax.nn.sigmoid(logits)).reshape(m.shape[:-1]).mean(0)
    for rewards, along in zip(every, predicted, strict=True):
        for t in range(PULLS + 1):
            chances = chance_of(rewards[:t])
            of_the_rest = (chances * CHANCES).sum() / chances.sum()
            expected = (rewards[:t].sum() + (PULLS - t) * of_the_rest) / PULLS
            assert along[t] == pytest.approx(expected, abs=0.08)


# The buffer.


def test_the_buffer_returns_what_was_added_and_forgets_the_oldest() -> None:
    trials = jax.tree.map(lambda *x: jnp.stack(x), *(trial(seed) for seed in range(5)))
    buffer = empty_buffer(3, TIME, OBSERVATION, ACTION)
    for part in (slice(0, 2), slice(2, 5)):
        some = jax.tree.map(lambda x, part=part: x[part], trials)
        buffer = buffer.extend(some, jnp.ones(len(some.valid), bool))
    drawn = buffer.sample(jax.random.key(0), 40)
    found = set()
    for row in range(40):
        one = jax.tree.map(lambda x, row=row: np.asarray(x[row]), drawn)
        same = [
            number
            for number in range(5)
            if all((x == y).all() for x, y in zip(one, trial(number), strict=True))
        ]
        assert len(same) == 1
        found.add(same[0])
    assert found == {2, 3, 4}


# HyperX.


def test_the_bonus_equals_its_formula_and_is_annealed() -> None:
    bonus = HyperBonus(0.3, 0.2, last_iteration=10, hidden_sizes=(4,), output_size=3)
    state = bonus.init(jax.random.key(0), 2)
    assert state is not None
    stream = np.random.default_rng(0)
    seen = stream.normal(size=(5, TIME, 2))
    error, reward = stream.random((2, 5, TIME))
    valid = np.broadcast_to(VALID, (5, TIME))

    def found(iteration: int) -> np.ndarray:
        arrays = (jnp.asarray(x, float) for x in (seen, error, reward))
        return np.asarray(
            bonus.judge(state, jnp.asarray(iteration), *arrays, jnp.asarray(valid), 0.9)[0]
        )

    f, g = mlp(state.target, seen), mlp(state.predictor, seen)
    novelty = ((f - g) ** 2).mean(-1)

    def std_of_returns(x: np.ndarray) -> float:
        returns, following = np.zeros(x.shape), np.zeros(5)
        for t in reversed(range(TIME)):
            # An invalid step brings nothing, and takes time as any other.
            following = np.where(valid[:, t], x[:, t], 0.0) + 0.9 * following
            returns[:, t] = following
        return float(returns[valid].std())

    expected = 0.3 * novelty / std_of_returns(novelty) + 0.2 * error / std_of_returns(error)
    expected *= std_of_returns(reward)
    for iteration, left in ((0, 1.0), (4, 0.6), (10, 0.0), (20, 0.0)):
        np.testing.assert_allclose(
            found(iteration), np.where(valid, left * expected, 0.0), rtol=1e-4, atol=1e-6
        )


def test_a_bonus_that_becomes_small_stays_small() -> None:
    """Its scale is that of all iterations so far."""
    bonus = HyperBonus(0.0, 1.0, last_iteration=10**9)
    state = bonus.init(jax.random.key(0), 1)
    assert state is not None
    stream = np.random.default_rng(0)
    seen, valid = jnp.zeros((5, TIME, 1)), jnp.ones((5, TIME), bool)
    reward, error = (jnp.asarray(stream.random((5, TIME)), float) for _ in range(2))
    sizes = []
    for iteration in range(50):
        faded = error / (iteration + 1)
        found, state = bonus.judge(state, jnp.asarray(0), seen, faded, reward, valid, 0.9)
        sizes.append(float(found.mean()))
    assert sizes[-1] < 0.2 * sizes[0]


def test_what_is_seen_often_is_no_longer_new() -> None:
    bonus = HyperBonus(1.0, learning_rate=1e-2, updates=300, batch_size=16)
    state = bonus.init(jax.random.key(0), 1)
    assert state is not None
    often, valid = jnp.full((1, TIME, 1), 0.5), jnp.asarray(VALID)[None]
    # What lies in a gap is never learned from.
    garbage = jnp.where(valid[..., None], often, jnp.nan)
    learned = bonus.learn(jax.random.key(1), state, garbage, valid)
    both = jnp.concatenate([often, jnp.full((1, TIME, 1), -0.5)])
    zeros, all_valid = jnp.zeros((2, TIME)), jnp.ones((2, TIME), bool)
    values = [
        bonus.judge(one, jnp.asarray(0), both, zeros, zeros, all_valid, 0.9)[0][:, 0]
        for one in (state, learned)
    ]
    assert float(values[1][0]) < 0.01 * float(values[1][1])
    assert float(values[0][0]) > 0.1 * float(values[0][1])


def test_without_weights_there_is_no_bonus() -> None:
    assert HyperBonus().init(jax.random.key(0), 4) is None


def test_the_belief_before_the_first_step_is_compared_with_a_standard_normal() -> None:
    belief = DiagonalGaussian(jnp.arange(6.0).reshape(3, 2), jnp.ones((3, 2)))
    before = previous(belief)
    np.testing.assert_array_equal(before.mean, [[0, 0], [0, 1], [2, 3]])
    np.testing.assert_array_equal(before.log_std, [[0, 0], [1, 1], [1, 1]])
