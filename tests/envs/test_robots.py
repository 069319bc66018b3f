"""Observations, controls, starts and dynamics of the robots, against the facts."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.envs import Ant, BlockPush, Point, Wheeled

STANDING_ANT = (0, 0, 0.55, 1, 0, 0, 0, 0, 1, 0, -1, 0, -1, 0, 1)


@pytest.mark.parametrize(
    ("make_env", "scale"), [(Wheeled, 2.0), (Point, 1.0), (Ant, 1.0), (BlockPush, 2.0)]
)
def test_control_scales_and_clips(make_env: type, scale: float) -> None:
    env = make_env()
    for action, expected in (
        (-3, -1),
        (-1, -1),
        (-0.5, -0.5),
        (0, 0),
        (0.25, 0.25),
        (1, 1),
        (7, 1),
    ):
        given = jnp.zeros(env.action_size).at[0].set(action).at[1].set(0.125)
        control = np.zeros(env.action_size)
        control[:2] = scale * expected, scale * 0.125
        np.testing.assert_array_equal(env.control(given), control)


@pytest.mark.parametrize(
    ("make_env", "horizon", "period", "observation", "action", "radius"),
    [
        (Wheeled, 200, 0.01, 12, 2, 0.8),
        (Point, 40, 0.1, 2, 2, 0.5),
        (Ant, 200, 0.01, 125, 8, 0.8),
        (BlockPush, 100, 0.01, 26, 3, 0.2),
    ],
)
def test_sizes_and_times(
    make_env: type, horizon: int, period: float, observation: int, action: int, radius: float
) -> None:
    env = make_env()
    assert (env.horizon, env.control_period, env.sparse_radius) == (horizon, period, radius)
    assert (env.observation_size, env.action_size) == (observation, action)
    assert BlockPush(variant="paper").observation_size == 28


@pytest.mark.parametrize("make_env", [Wheeled, Point, BlockPush])
def test_figures_show_the_first_two_coordinates(make_env: type) -> None:
    env = make_env()
    observation = jnp.arange(1.0, env.observation_size + 1.0)
    np.testing.assert_array_equal(env.position(observation), [1.0, 2.0])
    size = (env.observation_size + 1) // 2
    for value in (0.0, 1e6, jnp.nan):
        state = {"qpos": jnp.full(size, value), "qvel": jnp.full(size, value)}
        assert not bool(env.terminated(state))


@pytest.mark.parametrize(
    ("make_env", "middle", "speed"),
    [(Wheeled, (0,) * 6, 0.1), (Ant, STANDING_ANT, 0.1), (Point, (0, 0), 0.0)],
)
def test_the_start_has_the_spread_of_the_reference(
    make_env: type, middle: Any, speed: float
) -> None:
    # Position 0.01 N(0, 1), velocity 0.1 N(0, 1), independent in all coordinates; the point is at
    # rest. The mean of n draws has the deviation s / sqrt(n), their standard deviation
    # s / sqrt(2 n).
    n = 20_000
    keys = jax.random.split(jax.random.key(0), n)
    qpos, qvel = jax.vmap(make_env().initial, (0, None))(keys, jnp.array([0.0, 2.0]))
    draws = (np.asarray(qpos) - middle) / 0.01
    if speed:
        draws = np.concatenate([draws, np.asarray(qvel) / speed], axis=1)
    else:
        np.testing.assert_array_equal(qvel, np.zeros((n, 2)))
    size = draws.shape[1]
    np.testing.assert_allclose(draws.mean(0), np.zeros(size), atol=5 / np.sqrt(n))
    np.testing.assert_allclose(draws.std(0), np.ones(size), atol=5 / np.sqrt(2 * n))
    np.testing.assert_allclose(np.corrcoef(draws.T), np.eye(size), atol=5 / np.sqrt(n))


def test_the_point_moves_a_tenth_of_a_metre_per_unit() -> None:
    # From (1, 2) with u = (0.5, -1): by 0.1 u = (0.05, -0.1), at 0.1 u / 0.1 s = u metres a second.
    # So a goal 2 m away is twenty full steps away.
    state = {"qpos": jnp.array([1.0, 2.0]), "qvel": jnp.array([9.0, 9.0])}
    following = Point().advance(state, jnp.array([0.5, -1.0]))
    np.testing.assert_allclose(following["qpos"], [1.05, 1.9], rtol=1e-6)
    np.testing.assert_allclose(following["qvel"], [0.5, -1.0], rtol=1e-6)
