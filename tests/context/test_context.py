"""The context slot: starts, draws and penalties in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from maesn.context import Bias, BiasContext, Latent, LatentContext, NoContext, Nothing

ROWS = 20_000
NOISE = jnp.zeros((3, 2))  # of three episodes; no penalty here reads it


@pytest.mark.parametrize("kl_weight", [0.0, 0.1, 2.0])
def test_penalty_of_a_latent_is_its_weighted_divergence_from_the_prior(kl_weight: float) -> None:
    mean, std = np.array([0.5, -2.0]), np.array([0.3, 1.5])
    latent = Latent(jnp.asarray(mean, float), jnp.asarray(np.log(std), float))
    expected = kl_weight * 0.5 * np.sum(std**2 + mean**2 - 1 - 2 * np.log(std))
    actual = LatentContext(kl_weight=kl_weight).penalty(latent, latent, NOISE)
    np.testing.assert_allclose(actual, expected, rtol=1e-6)


def test_the_prior_itself_costs_nothing() -> None:
    assert LatentContext().penalty(*2 * [Latent(jnp.zeros(2), jnp.zeros(2))], NOISE) == 0.0


def test_penalty_is_on_the_latents_alone() -> None:
    assert NoContext().penalty(Nothing(), Nothing(), NOISE) == 0.0
    assert BiasContext(2).penalty(*2 * [Bias(jnp.full(2, 9.0))], NOISE) == 0.0


@pytest.mark.parametrize("spread", [1.0, 0.3])
def test_latents_start_at_normal_means_and_unit_standard_deviations(spread: float) -> None:
    learned = LatentContext(size=2, initial_spread=spread).init(jax.random.key(0), ROWS)
    assert learned.mean.shape == learned.log_std.shape == (ROWS, 2)
    np.testing.assert_array_equal(learned.log_std, 0.0)
    # Chance of a false alarm 1e-4, and that for this key alone.
    for component in learned.mean.T:
        assert scipy.stats.kstest(component, "norm", args=(0, spread)).pvalue > 1e-4
    # Independent components: the correlation of n pairs has standard deviation 1 / sqrt(n).
    correlation = np.corrcoef(learned.mean.T)[0, 1]
    assert abs(correlation) < 4 / np.sqrt(ROWS)


def test_no_spread_starts_every_latent_at_the_prior() -> None:
    learned = LatentContext(initial_spread=0.0).init(jax.random.key(0), 5)
    np.testing.assert_array_equal(learned.mean, 0.0)


def test_training_tasks_start_from_their_own_rows() -> None:
    context = LatentContext(size=3)
    learned = Latent(jnp.arange(12.0).reshape(4, 3), -jnp.arange(12.0).reshape(4, 3))
    started = context.start(learned, jnp.asarray([2, 0]))
    np.testing.assert_array_equal(started.mean, [[6, 7, 8], [0, 1, 2]])
    np.testing.assert_array_equal(started.log_std, -started.mean)


def test_new_tasks_start_from_the_prior_whatever_was_learned() -> None:
    learned = Latent(jnp.ones((4, 2)), jnp.ones((4, 2)))
    started = LatentContext().start_new(learned, 3)
    np.testing.assert_array_equal(started.mean, np.zeros((3, 2)))
    np.testing.assert_array_equal(started.log_std, np.zeros((3, 2)))


def test_a_bias_starts_at_zero_and_is_shared_by_training_and_new_tasks() -> None:
    context = BiasContext(2)
    np.testing.assert_array_equal(context.init(jax.random.key(0), 5).value, [0.0, 0.0])
    learned = Bias(jnp.asarray([1.0, -3.0]))
    for started in (context.start(learned, jnp.asarray([4, 1])), context.start_new(learned, 2)):
        np.testing.assert_array_equal(started.value, [[1.0, -3.0], [1.0, -3.0]])


def test_draws() -> None:
    noise = jnp.asarray([1.0, -2.0])
    latent = Latent(jnp.asarray([0.5, 0.25]), jnp.log(jnp.asarray([2.0, 0.5])))
    np.testing.assert_allclose(latent.draw(noise, jnp.zeros(0)), [2.5, -0.75], rtol=1e-6)
    bias = Bias(jnp.asarray([3.0, 4.0, 5.0]))
    np.testing.assert_array_equal(bias.draw(jnp.zeros(0), jnp.zeros(0)), [3.0, 4.0, 5.0])
    assert Nothing().draw(jnp.zeros(0), jnp.zeros(0)).shape == (0,)
    draw = jax.random.key(0), jnp.zeros((), int)
    sizes = [(value.size, value.noise(*draw).size) for value in (latent, bias, Nothing())]
    assert sizes == [(2, 2), (3, 0), (0, 0)]


def test_the_zeroth_action_is_judged_by_its_likelihood() -> None:
    value = Latent(jnp.asarray([1.0]), jnp.log(jnp.asarray([2.0])))
    drawn, advantage = jnp.asarray([[2.0], [-3.0], [1.0]]), jnp.asarray([1.0, 0.5, -2.0])
    log_q = scipy.stats.norm(1.0, 2.0).logpdf(np.asarray(drawn)[:, 0])
    expected = -np.mean(log_q * np.asarray(advantage))
    np.testing.assert_allclose(
        LatentContext(1).draw_loss(value, drawn, advantage), expected, rtol=1e-6
    )
    pathwise = LatentContext(1, gradient="reparameterized")
    assert pathwise.draw_loss(value, drawn, advantage) == 0.0
