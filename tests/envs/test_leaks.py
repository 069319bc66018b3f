"""No environment leaks its task into what the agent sees.

`observe` receives no task, but a task could still travel in the state. So the same episodes are
played with the same random numbers in two tasks: as long as both live, observations and hence
actions must agree bit for bit, while rewards must differ.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import agents, assert_same, keys, play

from maesn.envs import FAMILIES, PROBES, AnyEnv, Point, TaskFamily, TaskSet
from maesn.episodes import Episodes

EVERY = FAMILIES | PROBES


def two_tasks(family: TaskFamily) -> tuple[TaskSet, list[int]]:
    """The two of the first twenty tasks that differ most in their first number."""
    tasks = family.task_set("test")
    first = np.asarray(tasks[:20]).reshape(20, -1)[:, 0]
    return tasks, [int(np.argmin(first)), int(np.argmax(first))]


def play_in(env: AnyEnv, tasks: TaskSet, index: int) -> Episodes:
    return play(env, tasks, [index, index], episodes=4, cast=agents(env, 2))


def seen(episodes: Episodes, both: np.ndarray) -> list[np.ndarray]:
    """What was seen and done while the episode lived in both tasks; the rest as zeros."""
    mask = both[..., None]
    return [
        np.where(mask, episodes.observation[..., :-1, :], 0),
        np.where(mask, episodes.action, 0),
        np.where(mask, episodes.behaviour.mean, 0),
    ]


def leaks(env: AnyEnv, tasks: TaskSet, pair: list[int]) -> bool:
    one, other = (play_in(env, tasks, index) for index in pair)
    both = np.asarray(one.valid & other.valid)
    assert both[..., 0].all()
    same = jax.tree.map(np.array_equal, seen(one, both), seen(other, both))
    return not all(same)


@pytest.mark.parametrize("name", EVERY)
def test_nothing_seen_in_an_episode_depends_on_the_task(name: str) -> None:
    assert not leaks(EVERY[name].make_env(), *two_tasks(EVERY[name]))


@pytest.mark.parametrize("name", FAMILIES)
def test_the_last_state_of_a_robot_does_not_depend_on_the_task_either(name: str) -> None:
    tasks, pair = two_tasks(FAMILIES[name])
    one, other = (play_in(FAMILIES[name].make_env(), tasks, index) for index in pair)
    assert_same(one.observation, other.observation)


@pytest.mark.parametrize("name", EVERY)
def test_what_is_paid_depends_on_the_task(name: str) -> None:
    # Otherwise the tests above would compare a task with itself.
    tasks, pair = two_tasks(EVERY[name])
    one, other = (play_in(EVERY[name].make_env(), tasks, index) for index in pair)
    assert not np.array_equal(one.undiscounted_return, other.undiscounted_return)


@pytest.mark.parametrize("name", EVERY)
def test_episodes_are_repeatable(name: str) -> None:
    tasks, pair = two_tasks(EVERY[name])
    env = EVERY[name].make_env()
    first, again = (play_in(env, tasks, pair[0]) for _ in range(2))
    assert_same(first, again)
    other = play(env, tasks, [pair[0]] * 2, episodes=4, cast=agents(env, 2), seed=1)
    for field in ("action", "noise", "context"):
        draws = (np.asarray(getattr(episodes, field)) for episodes in (first, other))
        assert not np.any(np.equal(*draws))


@pytest.mark.parametrize("reward_kind", ["dense", "sparse"])
@pytest.mark.parametrize("variant", ["reference", "paper"])
@pytest.mark.parametrize("name", EVERY)
def test_the_start_and_the_instruction_do_not_depend_on_the_task(
    name: str, variant: str, reward_kind: str
) -> None:
    env = EVERY[name].make_env(variant=variant, reward_kind=reward_kind)
    tasks, pair = two_tasks(EVERY[name])

    def first(index: int) -> tuple[jax.Array, jax.Array]:
        task = jnp.asarray(tasks[index])
        qpos, qvel = env.initial(keys(1)[0], task)
        return env.observe({"qpos": qpos, "qvel": qvel}), env.instruction(task)

    assert_same(first(pair[0]), first(pair[1]))


class LeakyStart(Point):
    """Starts a micrometre towards its goal."""

    def initial(self, key: Any, task: Any) -> Any:
        qpos, qvel = super().initial(key, task)
        return qpos + 1e-6 * task, qvel


class LeakyInstruction(Point):
    """Tells the goal."""

    observation_size: int = 4

    def instruction(self, task: Any) -> Any:
        return task


@pytest.mark.parametrize("make_env", [LeakyStart, LeakyInstruction])
def test_a_leak_would_be_noticed(make_env: type[Point]) -> None:
    assert leaks(make_env(), *two_tasks(FAMILIES["point"]))
