"""Block pushing: observations, rewards and tasks against the facts of the experiment."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from playing import constant_agents, play
from scipy import stats

from maesn.envs import SETS, BlockPush, BlockPushTask, TaskSet, blockpush
from maesn.physics import load_model

HOMES = np.stack([0.2 * np.arange(1, 6), np.zeros(5)], axis=-1)
TASK = BlockPushTask(
    jnp.asarray(3), jnp.array([0.8, -0.6]), jnp.arange(10.0).reshape(5, 2) / 10
)  # |goal| = 1


def readings(block: int, place: tuple[float, float]) -> dict[str, jax.Array]:
    """Everything at home, and one block somewhere."""
    blocks = HOMES.copy()
    blocks[block] = place
    moved = (blocks - HOMES).reshape(-1)
    return {"qpos": jnp.asarray(np.r_[0, 0, 0, moved], float), "qvel": jnp.zeros(13)}


def reward(env: BlockPush, place: tuple[float, float], block: int = 3) -> float:
    reward = env.reward(readings(block, (9.0, 9.0)), jnp.ones(3), readings(block, place), TASK)
    assert reward.other == 0.0
    return float(reward.total)


def test_what_is_seen_of_blocks_is_where_the_model_has_them() -> None:
    model = load_model("blockpush")
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(0).normal(size=13)
    mujoco.mj_forward(model, data)
    state = {"qpos": jnp.asarray(data.qpos, float), "qvel": jnp.zeros(13)}
    seen = BlockPush().observe(state)
    places = [data.geom(f"block_{block}").xpos[:2] for block in range(5)]
    np.testing.assert_allclose(seen[3:13], np.ravel(places), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(seen[:2], data.body("gripper").xpos[:2], rtol=1e-6)


def test_an_episode_starts_as_the_task_says() -> None:
    qpos, qvel = BlockPush().initial(jax.random.key(0), TASK)
    again, _ = BlockPush().initial(jax.random.key(1), TASK)
    np.testing.assert_array_equal(qpos, again)
    np.testing.assert_array_equal(qvel, np.zeros(13))
    observation = BlockPush().observe({"qpos": qpos, "qvel": qvel})
    np.testing.assert_array_equal(observation[:3], np.zeros(3))
    np.testing.assert_allclose(observation[3:13], np.arange(10.0) / 10, atol=1e-7)


@pytest.mark.parametrize(
    ("variant", "reward_kind", "place", "expected"),
    [
        # The goal is (0.8, -0.6), one metre from the origin; distances 0.3, 0.5, 0.1 and 0.2.
        ("reference", "dense", (0.8, -0.3), -1.5),
        ("reference", "dense", (0.5, -0.2), -2.5),
        ("reference", "sparse", (0.8, -0.3), -5.0),
        ("reference", "sparse", (0.8, -0.5), -0.5),
        ("reference", "sparse", (0.8, -0.39), -5.0),
        ("reference", "sparse", (0.8, -0.41), -0.95),
        ("paper", "dense", (0.8, -0.3), -0.3),
        ("paper", "sparse", (0.8, -0.3), -1.0),
        ("paper", "sparse", (0.8, -0.5), -0.1),
    ],
)
def test_rewards_worked_out_by_hand(
    variant: Any, reward_kind: Any, place: tuple[float, float], expected: float
) -> None:
    env = BlockPush(variant=variant, reward_kind=reward_kind)
    assert reward(env, place) == pytest.approx(expected, abs=1e-6)


def test_sparse_rewards_far_away_are_the_goals_distance_or_one_constant() -> None:
    far, task = readings(3, (9.0, 9.0)), TASK._replace(goal=jnp.array([0.3, 0.4]))
    for variant, expected in (("reference", -2.5), ("paper", -1.0)):
        env = BlockPush(variant=variant, reward_kind="sparse")
        assert env.reward(far, jnp.ones(3), far, task).total == pytest.approx(expected)
        # A policy that reads rewards does not see how far away the goal is.
        shown = env.observed_reward("own", far, jnp.ones(3), far, task)
        assert shown == {"reference": -5.0, "paper": -1.0}[variant]


def test_only_the_relevant_block_counts() -> None:
    env = BlockPush(reward_kind="sparse")
    at_goal = (0.8, -0.6)
    assert reward(env, at_goal, block=3) == 0.0
    assert bool(env.solved(readings(3, at_goal), TASK))
    for other in (0, 1, 2, 4):
        assert reward(env, at_goal, block=other) == -5.0
        assert not bool(env.solved(readings(other, at_goal), TASK))


def test_the_paper_tells_the_goal_and_not_the_block() -> None:
    np.testing.assert_array_equal(BlockPush().instruction(TASK), np.zeros(0))
    env = BlockPush(variant="paper")
    shown = [env.instruction(TASK._replace(block=jnp.asarray(block))) for block in range(5)]
    np.testing.assert_array_equal(shown, np.tile(np.float32([0.8, -0.6]), (5, 1)))


def test_a_block_is_pushed_into_its_goal_region() -> None:
    """Forwards with 1.4 N, a block in front of the crossbar; `test_leaks` compares what is seen."""
    layout = HOMES + np.array([0.0, 3.0])
    layout[2] = 0.4, 0.0
    goals = np.array([[0.9, 0.0], [0.9, 0.0]], np.float32)
    task = BlockPushTask(np.int32([2, 4]), goals, np.tile(np.float32(layout), (2, 1, 1)))
    env = BlockPush(reward_kind="sparse")
    cast = constant_agents(env, 2, mean=np.array([0.7, 0.0, 0.0]), std=1e-6)
    episodes = play(env, TaskSet(task), [0, 1], episodes=1, cast=cast)
    assert not episodes.solved_at_start.any()
    np.testing.assert_array_equal(episodes.solved.any(-1), [[True], [False]])


def test_episodes_that_start_in_the_goal_region_are_marked() -> None:
    tasks = blockpush.task_set("test")
    where = tasks.tasks.layout[np.arange(100), tasks.tasks.block]
    expected = np.linalg.norm(where - tasks.tasks.goal, axis=1) <= 0.2
    chosen = np.concatenate([np.flatnonzero(expected), np.flatnonzero(~expected)[:3]])
    episodes = play(BlockPush(), tasks, chosen, episodes=2)
    np.testing.assert_array_equal(episodes.solved_at_start[:, 0], expected[chosen])
    np.testing.assert_array_equal(episodes.solved_at_start[:, 1], expected[chosen])


# Tasks


def layouts(tasks: BlockPushTask) -> np.ndarray:
    return np.unique(tasks.layout.reshape(-1, 10), axis=0)


def bands(places: np.ndarray) -> np.ndarray:
    return np.clip(np.floor((places[..., 1].astype(np.float64) + 0.5) / 0.2), 0, 4).astype(int)


@pytest.mark.parametrize("which", SETS)
def test_twenty_layouts_of_five_tasks_each(which: Any) -> None:
    tasks, rows = blockpush.task_set(which).tasks, np.arange(100)
    found, counts = np.unique(tasks.layout.reshape(-1, 10), axis=0, return_counts=True)
    assert (len(found), set(counts)) == (20, {5})
    np.testing.assert_array_equal(np.bincount(tasks.block, minlength=5), np.full(5, 20))
    pairs = {
        (row.tobytes(), int(block)) for row, block in zip(tasks.layout, tasks.block, strict=True)
    }
    assert len(pairs) == 100
    # Shuffled: neither the blocks nor the layouts come in order.
    assert (np.diff(tasks.block) < 0).any()
    assert (tasks.layout[1:] == tasks.layout[:-1]).all((1, 2)).sum() < 20
    # Every block has a band to itself, and its goal lies in it.
    np.testing.assert_array_equal(np.sort(bands(tasks.layout)), np.tile(np.arange(5), (100, 1)))
    np.testing.assert_array_equal(bands(tasks.goal), bands(tasks.layout)[rows, tasks.block])
    for values, low, high in ((tasks.layout[..., 0], 0.35, 0.65), (tasks.goal[:, 0], 0.75, 0.95)):
        assert np.float32(low) <= values.min() < values.max() <= np.float32(high)


def test_no_layout_is_in_two_sets() -> None:
    found = [layouts(blockpush.task_set(which).tasks) for which in SETS]
    assert len(np.unique(np.concatenate(found), axis=0)) == 20 * len(SETS)


def test_places_are_uniform_and_bands_equally_likely() -> None:
    tasks = blockpush.draw_tasks(np.random.default_rng(0), 20_000)
    blocks = layouts(tasks).reshape(-1, 5, 2)[:, 0].astype(np.float64)
    samples = {
        "block x": (blocks[:, 0] - 0.35) / 0.3,
        "block y": (blocks[:, 1] + 0.5 - 0.2 * bands(blocks)) / 0.2,
        "goal x": (tasks.goal[:, 0].astype(np.float64) - 0.75) / 0.2,
        "goal y": (tasks.goal[:, 1].astype(np.float64) + 0.5 - 0.2 * bands(tasks.goal)) / 0.2,
    }
    for name, sample in samples.items():
        assert stats.kstest(sample, "uniform").pvalue > 1e-3, name
    assert stats.chisquare(np.bincount(bands(blocks), minlength=5)).pvalue > 1e-3


@pytest.mark.parametrize("size", [1, 4, 5, 7, 12])
def test_sets_of_other_sizes(size: int) -> None:
    tasks = blockpush.task_set("training", size=size)
    assert len(tasks) == size
    assert len(layouts(tasks.tasks)) <= -(-size // 5)
    assert jax.tree.map(np.shape, tasks.tasks) == BlockPushTask((size,), (size, 2), (size, 5, 2))


@pytest.mark.parametrize("wrong", [-1, 5, 7])
def test_a_block_that_is_not_there_is_refused(wrong: int) -> None:
    tasks = blockpush.task_set("test", size=5).tasks
    blockpush.check_tasks(tasks)
    tasks.block[3] = wrong
    with pytest.raises(ValueError, match=f"`block` must be .* from 0 to 4, got {wrong} in row 3"):
        blockpush.check_tasks(tasks)
