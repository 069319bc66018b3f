"""The vector environment: every row is the single environment, bit for bit, resets included."""

from typing import Any

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from learning_problems.probes import hidden_end
from pictures import drawn

from maesn.gym import IDS, TaskEnv, TaskVectorEnv

COUNT = 3


def play(envs: gymnasium.vector.VectorEnv, steps: int, **reset: Any) -> list[Any]:
    rng = np.random.default_rng(0)
    results: list[Any] = [envs.reset(**reset)]
    for _ in range(steps):
        action = rng.uniform(-1, 1, envs.action_space.shape).astype(np.float32)
        if isinstance(envs.action_space, gymnasium.spaces.MultiDiscrete):
            action = rng.integers(envs.action_space.nvec)
        results.append(envs.step(action))
    return results


def assert_same(batched: list[Any], one_by_one: list[Any]) -> None:
    for step, (got, expected) in enumerate(zip(batched, one_by_one, strict=True)):
        for ours, theirs in zip(got[:-1], expected[:-1], strict=True):
            np.testing.assert_array_equal(ours, theirs, f"step {step}")
        for name in ("task", "is_success"):
            np.testing.assert_array_equal(got[-1][name], expected[-1][name], f"step {step}")


@pytest.mark.parametrize(
    ("family", "steps", "num_threads"),
    # point: three episodes one after the other. hidden_end: episodes of different lengths, NaN
    # behind their ends. The robots: states that only the engine knows.
    [("point", 90, 0), (hidden_end, 40, 0), ("wheeled", 10, 2), ("ant", 10, 2),
     ("blockpush", 110, 1), ("grid_navi", 40, 0), ("cheetah_body", 10, 2)],
)  # fmt: skip
def test_rows_are_single_environments(family: Any, steps: int, num_threads: int) -> None:
    batched = TaskVectorEnv(family, COUNT, num_threads=num_threads)
    single = SyncVectorEnv([lambda: TaskEnv(family)] * COUNT)
    assert batched.observation_space == single.observation_space
    assert batched.action_space == single.action_space
    assert batched.tasks.digest() == TaskEnv(family).tasks.digest()
    got = play(batched, steps, seed=11)
    assert_same(got, play(single, steps, seed=11))
    assert np.array([result[0] for result in got]).std() > 0
    batched.close()


def test_gymnasium_makes_it_by_name_and_knows_how_it_resets() -> None:
    for name in IDS.values():
        envs = gymnasium.make_vec(f"maesn.gym:{name}", num_envs=COUNT)
        assert isinstance(envs, TaskVectorEnv)
        assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        envs.close()


def test_episodes_can_be_reset_by_hand() -> None:
    envs = TaskVectorEnv(hidden_end, COUNT, task=[2, 3, 2], autoreset_mode="Disabled")
    envs.reset(seed=0)
    action = np.zeros((COUNT, 1), np.float32)
    ended = np.zeros(COUNT, bool)
    while not ended.any():
        _, _, terminated, truncated, _ = envs.step(action)
        ended = terminated | truncated
    assert not ended.all()  # the lifetimes of the two tasks differ
    with pytest.raises(gymnasium.error.ResetNeeded, match="have ended and are not reset"):
        envs.step(action)
    going_on = envs._stepper._steps[~ended].copy()
    envs.reset(options={"reset_mask": ended})
    np.testing.assert_array_equal(envs._stepper._steps[~ended], going_on)
    np.testing.assert_array_equal(envs._stepper._steps[ended], 0)
    envs.step(action)


def test_a_masked_reset_draws_from_the_rows_own_seed() -> None:
    whole, part = TaskVectorEnv("point", COUNT), TaskVectorEnv("point", COUNT)
    expected = whole.reset(seed=20)[0]
    before = part.reset(seed=7)[0]
    mask = np.array([False, True, False])
    after = part.reset(seed=20, options={"reset_mask": mask})[0]
    np.testing.assert_array_equal(after, np.where(mask[:, None], expected, before))
    for same in ([20, 21, 22], np.int64(20), np.uint8(20)):
        np.testing.assert_array_equal(TaskVectorEnv("point", COUNT).reset(seed=same)[0], expected)


def test_tasks_are_chosen_for_all_or_for_each() -> None:
    envs = TaskVectorEnv("point", COUNT)
    np.testing.assert_array_equal(envs.reset(options={"task": 5})[1]["task"], [5, 5, 5])
    _, information = envs.reset(options={"task": [5, 6, 7]})
    np.testing.assert_array_equal(information["task"], [5, 6, 7])
    np.testing.assert_array_equal(information["_task"], True)
    kept = jax.tree.map(np.copy, information)
    envs.reset(options={"task": 0})
    jax.tree.map(np.testing.assert_array_equal, information, kept)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"options": {"task": [1, 2]}}, "`task` must be an index"),
        ({"options": {"reset_mask": np.zeros(COUNT, bool)}}, "`reset_mask` must be 3 booleans"),
        ({"options": {"reset_mask": np.ones(COUNT)}}, "`reset_mask` must be 3 booleans"),
        ({"options": {"mask": np.ones(COUNT, bool)}}, "`mask` is not an option: .* `reset_mask`"),
        ({"seed": [1, 2]}, "`seed` must be one number or one for each of 3 episodes, got 2"),
        ({"seed": [4, -1, 5]}, "Seed must be greater or equal to zero, actual value: -1"),
    ],
)
def test_wrong_resets_are_refused_by_name_and_change_nothing(
    wrong: dict[str, Any], message: str
) -> None:
    envs, others = TaskVectorEnv("point", COUNT), TaskVectorEnv("point", COUNT)
    envs.reset(seed=3)
    others.reset(seed=3)
    with pytest.raises((ValueError, gymnasium.error.Error), match=message):
        envs.reset(**{"seed": 4} | wrong)
    np.testing.assert_array_equal(envs.reset()[1]["task"], others.reset()[1]["task"])


def test_what_it_cannot_do_is_refused() -> None:
    with pytest.raises(ValueError, match="`autoreset_mode` must be NEXT_STEP or DISABLED"):
        TaskVectorEnv("point", autoreset_mode=AutoresetMode.SAME_STEP)
    with pytest.raises(ValueError, match=r"`threads` is not a setting: .* `num_threads`"):
        gymnasium.make_vec(IDS["point"], num_envs=COUNT, threads=1)
    envs = TaskVectorEnv("point", COUNT)
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episode is running"):
        envs.step(np.zeros((COUNT, 2), np.float32))
    with pytest.raises(gymnasium.error.ResetNeeded, match="`reset` all of them first"):
        envs.reset(options={"reset_mask": np.array([True, False, False])})


def test_every_row_has_a_picture_or_one_sentence_says_why_not() -> None:
    envs = TaskVectorEnv("point", 2, render_mode="rgb_array")
    envs.reset(seed=0, options={"task": [0, 50]})
    pictures = drawn(envs.render)
    if pictures is None:
        return
    first, second = pictures
    assert first.shape == second.shape == (360, 480, 3)
    assert (first != second).any()
    envs.close()
