"""Curiosity: what the model learns of the dynamics, and the bonus for it."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.transitions import linear_episodes

from maesn.learners.wrappers.curiosity import (
    CuriosityBonus,
    CuriosityState,
    Scale,
    Transitions,
    transitions,
)

KEY = jax.random.key(0)
SMALL = CuriosityBonus(
    weight=0.5,
    hidden_sizes=(4,),
    pool_size=64,
    pool_additions=16,
    updates=20,
    samples=3,
    median_window=2,
)
# Compiled, as the learners call them.
judge, learn, information_gains = map(
    eqx.filter_jit, (CuriosityBonus.judge, CuriosityBonus.learn, CuriosityBonus.information_gains)
)


def knowing(curiosity: CuriosityBonus) -> CuriosityState:
    """An untrained model that passes for one that has learned, so that it is asked."""
    return replace(curiosity.init(KEY, 2, 1), has_learned=jnp.ones((), bool))


def test_transitions_are_the_steps_one_behind_the_other() -> None:
    played = linear_episodes(0, (2, 3), 4)
    seen = transitions(played)
    assert seen.rows.shape == (24, 5)
    task, episode, step = 1, 2, 3
    before, after = (np.asarray(played.observation[task, episode, step + n]) for n in (0, 1))
    expected = [*before, *np.asarray(played.action[task, episode, step]), *(after - before)]
    np.testing.assert_array_equal(seen.rows[(task * 3 + episode) * 4 + step], expected)
    assert seen.valid.all()


def test_steps_beyond_the_end_or_without_a_finite_successor_do_not_count() -> None:
    played = linear_episodes(0, (1,), 4)
    ended = replace(
        played,
        valid=jnp.array([[True, True, True, False]]),
        # As where the physics of the last living step blows up.
        observation=played.observation.at[0, 3].set(jnp.nan),
    )
    np.testing.assert_array_equal(transitions(ended).valid, [True, True, False, False])


def exact_posterior(inputs: np.ndarray, targets: np.ndarray, curiosity: CuriosityBonus) -> tuple:
    """Means of Bayesian linear regression, and the best independent standard deviations.

    The posterior precision is L = I/p² + X'X/s², for each output. Among independent Gaussians the
    one closest to it has its mean, and the variances 1/L_ii (Bishop, "Pattern Recognition and
    Machine Learning", section 10.1.2).
    """
    rows = np.column_stack([inputs, np.ones(len(inputs))])
    variance = curiosity.likelihood_std**2
    precision = np.eye(rows.shape[1]) / curiosity.prior_std**2 + rows.T @ rows / variance
    mean = np.linalg.solve(precision, rows.T @ targets / variance)
    return mean, 1 / np.sqrt(np.diag(precision))


def linear_problem(curiosity: CuriosityBonus) -> tuple:
    """A state with a full pool, and the exact posterior of a linear model given that pool."""
    state = curiosity.init(KEY, 2, 1)
    state, _ = judge(curiosity, KEY, state, linear_episodes(1, (8,), 25))
    pool = np.asarray(state.pool.rows[: int(state.pool.size)], np.float64)
    scaled = (pool - pool.mean(0)) / pool.std(0)
    return state, *exact_posterior(scaled[:, :3], scaled[:, 3:], curiosity)


LINEAR = CuriosityBonus(
    hidden_sizes=(),
    pool_size=200,
    pool_additions=200,
    updates=4000,
    batch_size=50,
    samples=20,
    learning_rate=1e-2,
)


@pytest.mark.usefixtures("optimising_compiler")
def test_a_linear_model_learns_the_exact_posterior() -> None:
    state, mean, std = linear_problem(LINEAR)
    assert int(state.pool.size) == 200
    fine = replace(LINEAR, learning_rate=3e-4)
    state = learn(fine, KEY, learn(LINEAR, KEY, state))
    (layer,), (rho,) = state.network.mean.layers, state.network.rho.layers
    found_mean = np.vstack([layer.weight, layer.bias[None]])
    found_std = np.log1p(np.exp(np.vstack([rho.weight, rho.bias[None]])))
    # Steps are noisy: by less than a third of a posterior standard deviation.
    np.testing.assert_array_less(np.abs(found_mean - mean) / std[:, None], 0.35)
    np.testing.assert_allclose(found_std, np.tile(std[:, None], 2), rtol=0.04)
    # Far from where it started.
    assert std.max() < LINEAR.prior_std / 5


@pytest.mark.usefixtures("x64")
def test_the_exact_posterior_is_where_the_objective_is_flat() -> None:
    # Draws +1 and -1 have the moments of a normal draw up to the third: a mean over both is the
    # expectation of a quadratic function, so nothing is random here.
    state, mean, std = linear_problem(LINEAR)
    network = state.network
    rho = np.log(np.expm1(np.tile(std[:, None], 2)))
    for leaf, rows in (("mean", mean), ("rho", rho)):
        layer = getattr(network, leaf).layers[0]
        exact = replace(layer, weight=jnp.asarray(rows[:-1]), bias=jnp.asarray(rows[-1]))
        network = replace(network, **{leaf: replace(getattr(network, leaf), layers=(exact,))})
    pool = state.pool
    rows = jax.vmap(Scale(*pool.moments()).__call__)(pool.rows)
    draws = jnp.stack([jnp.ones(2), -jnp.ones(2)])
    noise = jnp.broadcast_to(draws, (rows.shape[0], *draws.shape))
    gradient = jax.jit(jax.grad(LINEAR.objective))
    slope = gradient(network, rows, noise, jnp.asarray(200.0))
    for leaf in jax.tree.leaves(slope):
        np.testing.assert_allclose(leaf, 0.0, atol=1e-10)
    start = gradient(state.network, rows, noise, jnp.asarray(200.0))
    assert max(np.abs(leaf).max() for leaf in jax.tree.leaves(start)) > 1e-2


def test_the_bonus_is_the_gain_over_the_mean_of_the_last_medians() -> None:
    curiosity = SMALL
    state, medians = knowing(curiosity), []
    for batch in range(4):
        played = linear_episodes(batch, (3,), 5, scale=1.0 + batch)
        key = jax.random.key(batch)
        network = state.network
        state, bonus = judge(curiosity, key, state, played)
        scale = Scale(*state.pool.moments())
        noise_key = jax.random.split(key)[1]
        gain = information_gains(curiosity, noise_key, network, scale, transitions(played))
        medians.append(np.median(gain))
        expected = 0.5 * np.asarray(gain).reshape(3, 5) / np.mean(medians[-2:])
        np.testing.assert_allclose(bonus, expected, rtol=1e-5)
        state = learn(curiosity, key, state)
    assert len({*map(float, medians)}) == 4


def test_who_has_learned_nothing_yet_is_not_asked() -> None:
    state = SMALL.init(KEY, 2, 1)
    for batch in range(2):
        state, bonus = judge(SMALL, KEY, state, linear_episodes(batch, (3,), 5))
        np.testing.assert_array_equal(bonus, np.zeros((3, 5)))
    assert int(state.medians.size) == 0
    # What it has seen is there to learn from.
    assert int(state.pool.size) == 2 * 15
    state = SMALL.start(learn(SMALL, KEY, state))
    state, bonus = judge(SMALL, KEY, state, linear_episodes(2, (3,), 5))
    # Of a single batch, the typical gain is the median one.
    assert float(np.median(bonus)) == pytest.approx(SMALL.weight)


def test_the_gain_of_a_linear_model_is_worked_out_by_hand() -> None:
    # Without hidden layers, and with draws of mean 0: the error e = y - x'μ is that of the mean,
    # E[(y - f)²] = e² + Σ x_i² σ_i², so that  ∂ℓ/∂μ_i = -e x_i / s²  and
    # ∂ℓ/∂ρ_i = σ_i x_i² / s² dσ/dρ.  Their Newton step gains
    # ½ Σ_i (σ_i e x_i / s²)² + ¼ Σ_i (σ_i² x_i² / s²)².
    curiosity = replace(SMALL, hidden_sizes=(), samples=20_000)
    network = curiosity.init(KEY, 1, 1).network
    row, scale = jnp.array([0.7, -1.2, 0.4]), Scale(jnp.zeros(3), jnp.ones(3))
    seen = Transitions(row[None], jnp.ones(1, bool))
    (gain,) = information_gains(curiosity, KEY, network, scale, seen)
    x, variance = np.array([0.7, -1.2, 1.0]), curiosity.likelihood_std**2
    (layer,) = network.mean.layers
    error = 0.4 - x @ np.append(layer.weight[:, 0], layer.bias)
    by_mean = 0.5 * np.sum((0.5 * error * x / variance) ** 2)
    by_rho = 0.25 * np.sum((0.25 * x**2 / variance) ** 2)
    np.testing.assert_allclose(gain, by_mean + by_rho, rtol=0.05)


def test_what_is_masked_changes_nothing() -> None:
    played = linear_episodes(0, (4,), 6)
    ended = replace(played, valid=jnp.arange(6)[None] < jnp.array([[6], [2], [4], [1]]))
    garbage = replace(
        ended,
        action=jnp.where(ended.valid[..., None], played.action, jnp.nan),
        observation=played.observation.at[1, 3:].set(jnp.inf).at[3, 2:].set(jnp.nan),
    )
    found = []
    for episodes in (ended, garbage):
        state, bonus = judge(SMALL, KEY, knowing(SMALL), episodes)
        found.append((learn(SMALL, KEY, state), bonus))
    for one, other in zip(*map(jax.tree.leaves, found), strict=True):
        np.testing.assert_array_equal(one, other)
        assert np.isfinite(one).all()
    bonus = np.asarray(found[0][1])
    assert np.all(bonus[~np.asarray(ended.valid)] == 0)
    assert np.all(bonus[np.asarray(ended.valid)] > 0)


def test_nothing_to_see_has_no_bonus() -> None:
    state = knowing(SMALL)
    over = replace(linear_episodes(0, (2,), 3), valid=jnp.zeros((2, 3), bool))
    after, bonus = judge(SMALL, KEY, state, over)
    np.testing.assert_array_equal(bonus, np.zeros((2, 3)))
    assert int(after.pool.size) == int(after.medians.size) == 0
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(learn(SMALL, KEY, after)))


def test_the_pool_holds_a_sample_of_all_batches() -> None:
    state = SMALL.init(KEY, 2, 1)
    for batch in range(3):
        state, _ = judge(SMALL, jax.random.key(batch), state, linear_episodes(batch, (4,), 10))
    assert int(state.pool.size) == 3 * 16
    rows = np.asarray(state.pool.rows)
    for batch in range(3):
        seen = {
            tuple(row) for row in np.asarray(transitions(linear_episodes(batch, (4,), 10)).rows)
        }
        added = [tuple(row) for row in rows[16 * batch : 16 * (batch + 1)]]
        assert len(set(added)) == 16
        assert set(added) <= seen


def test_the_pool_gets_its_share_where_episodes_end_early() -> None:
    played = linear_episodes(0, (4,), 10)
    short = replace(
        played, valid=played.valid.at[:, 4:].set(False)
    )  # 16 steps, as many as it takes
    state, _ = judge(SMALL, KEY, SMALL.init(KEY, 2, 1), short)
    assert int(state.pool.size) == 16
    expected = np.asarray(transitions(short).rows)[np.asarray(short.valid).ravel()]
    np.testing.assert_array_equal(
        np.unique(state.pool.rows[:16], axis=0), np.unique(expected, axis=0)
    )


def test_a_world_without_observations_is_refused() -> None:
    with pytest.raises(ValueError, match="`observation_size` must be at least 1, got 0"):
        CuriosityBonus().init(KEY, 0, 2)
