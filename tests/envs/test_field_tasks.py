"""Tasks of other papers, beside a NumPy transcription of the formulas of their code."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import agents, play

from maesn.envs import GridNavi, SparsePoint, grid_navi, sparse_point
from maesn.envs.grid_navi import goal_cells
from maesn.envs.sparse_point import grid_goals


def oyster_step(
    state: np.ndarray, action: np.ndarray, goal: np.ndarray, radius: float
) -> tuple[np.ndarray, float, float]:
    """State, dense and sparse reward of `SparsePointEnv.step`; its actions are scaled to 0.1."""
    state = state + 0.1 * np.clip(action, -1.0, 1.0)
    reward = -float(((state - goal) ** 2).sum() ** 0.5)
    inside = reward >= -radius
    return state, reward, reward * inside + 1.0 if inside else 0.0


@pytest.mark.parametrize(
    ("variant", "radius", "horizon"),
    [("pearl", 0.2, 20), ("reference", 0.2, 20), ("varibad", 0.2, 100), ("metacure", 0.3, 32)],
)
def test_the_sparse_point_is_that_of_the_papers(variant: Any, radius: float, horizon: int) -> None:
    env = sparse_point.make_env(variant=variant)
    assert (env.sparse_radius, env.horizon, env.control_period) == (radius, horizon, 1.0)
    sparse = sparse_point.make_env(variant=variant, reward_kind="sparse")
    rng, goal = np.random.default_rng(0), sparse_point.task_set("test")[0].astype(float)
    qpos, qvel = env.initial(jax.random.key(0), jnp.asarray(goal))
    np.testing.assert_array_equal(qpos, [0.0, 0.0])
    readings, state = {"qpos": qpos, "qvel": qvel}, np.zeros(2)
    seen = set()
    for _ in range(horizon):
        action = 10 * (goal - state) + rng.normal(0, 1.0, 2)
        state, dense_reward, sparse_reward = oyster_step(state, action, goal, radius)
        after = env.advance(readings, env.control(jnp.asarray(action)))
        np.testing.assert_allclose(env.observe(after), state, atol=1e-5)
        for one, expected in ((env, dense_reward), (sparse, sparse_reward)):
            reward = one.reward(readings, jnp.asarray(action), after, jnp.asarray(goal))
            np.testing.assert_allclose(reward.total, expected, atol=1e-5)
            assert reward.other == 0
        assert not env.terminated(after)
        seen.add(bool(env.solved(after, jnp.asarray(goal))))
        readings = after
    assert seen == {False, True}


def test_outside_of_the_radius_the_sparse_reward_is_zero_in_every_task() -> None:
    env = SparsePoint(reward_kind="sparse", horizon=5)  # too short to get near
    tasks = sparse_point.task_set("test")
    episodes = play(env, tasks, [0, 1], cast=agents(env, 2))
    assert not np.asarray(episodes.solved).any()
    np.testing.assert_array_equal(episodes.reward, 0.0)
    np.testing.assert_array_equal(episodes.observed_reward, 0.0)
    assert all(env.far_reward(jnp.asarray(task)) == 0 for task in tasks.tasks[:3])


def test_the_papers_own_goals_are_an_even_grid_in_their_order() -> None:
    np.random.seed(1337)  # noqa: NPY002, as their code has it
    angles = np.linspace(0, np.pi, num=100)
    goals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.random.shuffle(goals)  # noqa: NPY002
    np.testing.assert_array_equal(grid_goals(100), goals.astype(np.float32))
    apart = np.linalg.norm(grid_goals(100)[80:, None] - grid_goals(100)[None, :80], axis=-1)
    assert apart.min(axis=1).max() < 0.07
    assert np.median(apart.min(axis=1)) < 0.033


def varibad_step(cell: list[int], action: int, goal: Any) -> tuple[list[int], float]:
    """Cell and reward of `GridNavi.step`: noop, up, right, down, left."""
    x, y = cell
    if action == 1:
        y = min(y + 1, 4)
    elif action == 2:
        x = min(x + 1, 4)
    elif action == 3:
        y = max(y - 1, 0)
    elif action == 4:
        x = max(x - 1, 0)
    return [x, y], 1.0 if [x, y] == list(goal) else -0.1


def test_the_goals_of_the_grid_are_all_cells_but_the_start_and_those_next_to_it() -> None:
    possible = [[x, y] for x in range(5) for y in range(5)]
    for cell in ([0, 0], [0, 1], [1, 1], [1, 0]):
        possible.remove(cell)
    assert grid_navi.task_set("training").tasks.tolist() == possible
    assert len(goal_cells(3)) == 5


@pytest.mark.parametrize("reward_kind", ["dense", "sparse"])
def test_the_grid_is_that_of_the_paper(reward_kind: Any) -> None:
    env = GridNavi(reward_kind=reward_kind)
    assert (env.horizon, env.action_size, env.observation_size) == (15, 5, 2)
    rng = np.random.default_rng(1)
    goal, cell = [1, 2], [0, 0]
    readings = dict(
        zip(("qpos", "qvel"), env.initial(jax.random.key(0), jnp.zeros(2)), strict=True)
    )
    met = 0
    for choice in rng.integers(5, size=200):
        action = jnp.eye(5)[choice]
        cell, expected = varibad_step(cell, choice, goal)
        after = env.advance(readings, env.control(action))
        assert env.observe(after).tolist() == cell
        reward = env.reward(readings, action, after, jnp.asarray(goal, float))
        np.testing.assert_allclose(reward.total, expected, rtol=1e-6)
        met += expected > 0
        assert not env.terminated(after)
        readings = after
    assert 0 < met < 200


def test_choices_are_one_hot_and_lead_to_the_next_cell() -> None:
    env, tasks = GridNavi(), grid_navi.task_set("training")
    episodes = play(env, tasks, [0, 20], cast=agents(env, 2), episodes=4)
    action = np.asarray(episodes.action)
    np.testing.assert_array_equal(action.sum(-1), 1.0)
    assert set(np.unique(action)) == {0.0, 1.0}
    assert np.asarray(episodes.valid).all()
    assert (action.reshape(-1, 5).sum(0) > 0).all()
    position = np.asarray(episodes.observation)
    assert ((position >= 0) & (position <= 4) & (position == position.round())).all()
    assert np.abs(np.diff(position, axis=-2)).sum(-1).max() == 1


def test_wrong_variants_are_refused() -> None:
    for family, wrong in ((sparse_point, "paper"), (grid_navi, "pearl")):
        with pytest.raises(ValueError, match=f"`variant` must be .*, got '{wrong}'"):
            family.make_env(variant=wrong)
