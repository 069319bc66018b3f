"""The batch type: thinning, joining and returns."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.prepared import HORIZON, UNEQUAL, make_problem, stack

from maesn.experience.episodes import Episodes, Thinning, concatenate
from maesn.learners.gradient.curvature import step_weights


def episodes(garbage: float = 0.0) -> Episodes:
    return stack(make_problem(0, UNEQUAL).batches(0)[:2], garbage)


def test_every_step_is_all_steps() -> None:
    whole = episodes()
    thinned = whole.every(1, 0)
    np.testing.assert_array_equal(thinned.observation, whole.observation[:, :, :-1])
    names = ("action", "reward", "goal_reward", "valid", "solved", "solved_at_start")
    for name in (*names, "terminated", "noise"):
        np.testing.assert_array_equal(getattr(thinned, name), getattr(whole, name))
    for name in ("mean", "log_std"):
        np.testing.assert_array_equal(
            getattr(thinned.behaviour, name), getattr(whole.behaviour, name)
        )
    np.testing.assert_array_equal(thinned.z, whole.z)


@pytest.mark.parametrize("stride", [2, 3, 4])
def test_every_so_manieth_step(stride: int) -> None:
    whole = episodes()
    kept = HORIZON // stride
    every = jax.jit(lambda offset: whole.every(stride, offset))
    for offset in range(stride):
        thinned = every(jnp.asarray(offset))
        for name in ("observation", "action", "reward", "goal_reward", "valid", "solved"):
            expected = getattr(whole, name)[:, :, :HORIZON][:, :, offset::stride][:, :, :kept]
            np.testing.assert_array_equal(getattr(thinned, name), expected, err_msg=name)
        expected = whole.behaviour.mean[:, :, offset::stride][:, :, :kept]
        np.testing.assert_array_equal(thinned.behaviour.mean, expected)


def test_a_thinning_is_drawn_such_that_every_step_can_be() -> None:
    played = jnp.ones((2, 7), bool)
    drawn = [Thinning.draw(key, 3, played) for key in jax.random.split(jax.random.key(0), 50)]
    steps = [int(one.offset) + one.stride * np.arange(7 // 3) for one in drawn]
    assert set(np.concatenate(steps).tolist()) == set(range(7))
    beyond = Thinning.draw(jax.random.key(0), 12, played)
    assert beyond.stride == 7
    assert 0 <= int(beyond.offset) < 7


def test_a_thinning_of_episodes_that_all_end_early_takes_a_step_that_was_played() -> None:
    valid = jnp.asarray(np.arange(200) < np.array([[3], [8]]))  # [episode, time]
    drawn = [Thinning.draw(key, 20, valid) for key in jax.random.split(jax.random.key(0), 50)]
    assert {int(one.offset) for one in drawn} == set(range(8))


def test_weights_of_the_steps_make_a_mean_over_tasks_of_means_over_valid_steps() -> None:
    batch = episodes()
    weight = np.asarray(step_weights(batch))
    values = np.random.default_rng(0).normal(size=weight.shape)
    valid = np.asarray(batch.valid)
    expected = np.mean([values[task][valid[task]].mean() for task in range(2)])
    np.testing.assert_allclose((weight * values).sum(), expected, rtol=1e-6)
    assert (weight[~valid] == 0).all()


def test_a_task_without_any_valid_step_weighs_nothing() -> None:
    batch = episodes()
    silent = eqx.tree_at(lambda e: e.valid, batch, batch.valid.at[1].set(False))
    weight = step_weights(silent)
    assert (weight[1] == 0).all()
    np.testing.assert_array_equal(weight[0], step_weights(batch)[0])


@pytest.mark.parametrize("garbage", [0.0, np.nan])
def test_undiscounted_return_adds_the_valid_rewards(garbage: float) -> None:
    played = make_problem(0, UNEQUAL).batches(0)[:2]
    expected = [[episode.reward.sum() for episode in task] for task in played]
    np.testing.assert_allclose(episodes(garbage).undiscounted_return, expected, rtol=1e-5)


def test_joining_keeps_tasks_apart() -> None:
    first, second = episodes(), stack(make_problem(1, UNEQUAL).batches(0)[:2])
    joined = concatenate(first, second)
    count = len(UNEQUAL)
    for whole, before, after in zip(*map(jax.tree.leaves, (joined, first, second)), strict=True):
        np.testing.assert_array_equal(whole[:, :count], before)
        np.testing.assert_array_equal(whole[:, count:], after)
