"""Observations, controls, starts and dynamics of the robots, against the facts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.envs import Point, Wheeled

SCALING = [
    # action, wheeled: clip(2 a, -2, 2), point: clip(a, -1, 1)
    (-3.0, -2.0, -1.0),
    (-1.0, -2.0, -1.0),
    (-0.5, -1.0, -0.5),
    (0.0, 0.0, 0.0),
    (0.25, 0.5, 0.25),
    (1.0, 2.0, 1.0),
    (7.0, 2.0, 1.0),
]


@pytest.mark.parametrize(("action", "wheeled", "point"), SCALING)
def test_control_scales_and_clips(action: float, wheeled: float, point: float) -> None:
    pair = jnp.array([action, 0.125])
    np.testing.assert_array_equal(Wheeled().control(pair), [wheeled, 0.25])
    np.testing.assert_array_equal(Point().control(pair), [point, 0.125])


def test_wheeled_sees_positions_then_velocities() -> None:
    readings = {"qpos": jnp.arange(6.0), "qvel": jnp.arange(6.0, 12.0)}
    np.testing.assert_array_equal(Wheeled().observe(readings), np.arange(12.0))


def test_point_sees_its_position() -> None:
    readings = {"qpos": jnp.array([0.3, -0.7]), "qvel": jnp.array([5.0, 6.0])}
    np.testing.assert_array_equal(Point().observe(readings), np.float32([0.3, -0.7]))


@pytest.mark.parametrize("make_env", [Wheeled, Point])
def test_figures_show_the_first_two_coordinates_and_the_goal(make_env: type) -> None:
    env = make_env()
    observation = jnp.arange(1.0, env.observation_size + 1.0)
    np.testing.assert_array_equal(env.position(observation), [1.0, 2.0])
    np.testing.assert_array_equal(env.goal(jnp.array([3.0, 4.0])), [3.0, 4.0])


@pytest.mark.parametrize(
    ("make_env", "horizon", "period", "observation", "action"),
    [(Wheeled, 200, 0.01, 12, 2), (Point, 40, 0.1, 2, 2)],
)
def test_sizes_and_times(
    make_env: type, horizon: int, period: float, observation: int, action: int
) -> None:
    env = make_env()
    assert (env.horizon, env.control_period) == (horizon, period)
    assert (env.observation_size, env.action_size) == (observation, action)


@pytest.mark.parametrize("make_env", [Wheeled, Point])
def test_robots_never_terminate(make_env: type) -> None:
    env = make_env()
    size = (env.observation_size + 1) // 2
    for value in (0.0, 1e6, jnp.nan):
        state = {"qpos": jnp.full(size, value), "qvel": jnp.full(size, value)}
        assert not bool(env.terminated(state))


def test_the_wheeled_robot_starts_with_the_spread_of_the_reference() -> None:
    # Position 0.01 N(0, 1), velocity 0.1 N(0, 1), independent in all twelve coordinates. The mean
    # of n draws has the deviation s / sqrt(n), their standard deviation s / sqrt(2 n).
    n = 20_000
    start = jax.vmap(Wheeled().initial, (0, None))(
        jax.random.split(jax.random.key(0), n), jnp.array([0.0, 2.0])
    )
    draws = np.concatenate([np.asarray(start[0]) / 0.01, np.asarray(start[1]) / 0.1], axis=1)
    np.testing.assert_allclose(draws.mean(0), np.zeros(12), atol=5 / np.sqrt(n))
    np.testing.assert_allclose(draws.std(0), np.ones(12), atol=5 / np.sqrt(2 * n))
    np.testing.assert_allclose(np.corrcoef(draws.T), np.eye(12), atol=5 / np.sqrt(n))


def test_the_point_starts_at_rest_near_the_origin() -> None:
    n = 20_000
    qpos, qvel = jax.vmap(Point().initial, (0, None))(
        jax.random.split(jax.random.key(0), n), jnp.array([0.0, 2.0])
    )
    np.testing.assert_array_equal(qvel, np.zeros((n, 2)))
    draws = np.asarray(qpos) / 0.01
    np.testing.assert_allclose(draws.mean(0), np.zeros(2), atol=5 / np.sqrt(n))
    np.testing.assert_allclose(draws.std(0), np.ones(2), atol=5 / np.sqrt(2 * n))


def test_the_point_moves_a_tenth_of_a_metre_per_unit() -> None:
    # From (1, 2) with u = (0.5, -1): by 0.1 u = (0.05, -0.1), at 0.1 u / 0.1 s = u metres a second.
    state = {"qpos": jnp.array([1.0, 2.0]), "qvel": jnp.array([9.0, 9.0])}
    following = Point().advance(state, jnp.array([0.5, -1.0]))
    np.testing.assert_allclose(following["qpos"], [1.05, 1.9], rtol=1e-6)
    np.testing.assert_allclose(following["qvel"], [0.5, -1.0], rtol=1e-6)


def test_the_goal_is_twenty_full_steps_away() -> None:
    env, goal = Point(reward_kind="sparse"), jnp.array([2.0, 0.0])
    state = {"qpos": jnp.zeros(2), "qvel": jnp.zeros(2)}
    reached = []
    for _ in range(20):
        state = env.advance(state, env.control(jnp.array([1.0, 0.0])))
        reached.append(bool(env.solved(state, goal)))
    np.testing.assert_allclose(state["qpos"], goal, atol=1e-5)
    # The region of radius 0.5 is entered after 15 steps, where d = 2 - 1.5 up to rounding.
    assert reached[:14] == [False] * 14
    assert reached[15:] == [True] * 5
