"""No environment leaks its task into what the agent sees.

`observe` receives no task, but a task could still travel in the state. So the same episodes are
played with the same random numbers in two tasks: as long as both live, observations and hence
actions must agree bit for bit, while rewards must differ.
"""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import PROBES
from playing import agents, assert_same, keys, play, readings_at

from maesn.envs import FAMILIES, AnyEnv, BlockPushTask, Point, TaskFamily, TaskSet
from maesn.experience.episodes import Episodes

EVERY = FAMILIES | PROBES


# Here the agent sees its goal.
INSTRUCTED = {("blockpush", "paper")}


def two_tasks(family: TaskFamily) -> tuple[TaskSet, list[int]]:
    """Of tasks that look alike to the agent, the two that differ most in their first number."""
    tasks = family.task_set("test")
    alike = look_alike(tasks.tasks)
    first = np.asarray(jax.tree.leaves(tasks.tasks)[0]).reshape(len(tasks), -1)[alike, 0]
    return tasks, [int(alike[np.argmin(first)]), int(alike[np.argmax(first)])]


def look_alike(tasks: Any) -> np.ndarray:
    """The first twenty tasks; of laid tables, all that are laid like the first one."""
    if isinstance(tasks, BlockPushTask):
        return np.flatnonzero((tasks.layout == tasks.layout[0]).all((1, 2)))
    return np.arange(20)


def play_in(env: AnyEnv, tasks: TaskSet, index: int) -> Episodes:
    return play(env, tasks, [index, index], episodes=4, cast=agents(env, 2))


@cache
def pair_of(name: str) -> tuple[Episodes, Episodes]:
    """The same random numbers in two tasks of a family."""
    env, (tasks, pair) = EVERY[name].make_env(), two_tasks(EVERY[name])
    one, other = (play_in(env, tasks, index) for index in pair)
    return one, other


def seen(episodes: Episodes, both: np.ndarray) -> list[np.ndarray]:
    """What was seen and done while the episode lived in both tasks; the rest as zeros."""
    mask = both[..., None]
    return [
        np.where(mask, episodes.observation[..., :-1, :], 0),
        np.where(mask, episodes.action, 0),
        *(np.where(mask, leaf, 0) for leaf in jax.tree.leaves(episodes.behaviour)),
    ]


def leaks(one: Episodes, other: Episodes) -> bool:
    both = np.asarray(one.valid & other.valid)
    assert both[..., 0].all()
    same = jax.tree.map(np.array_equal, seen(one, both), seen(other, both))
    return not all(same)


@pytest.mark.parametrize("name", EVERY)
def test_nothing_seen_in_an_episode_depends_on_the_task(name: str) -> None:
    assert not leaks(*pair_of(name))


@pytest.mark.parametrize("name", FAMILIES)
def test_the_last_state_of_a_robot_does_not_depend_on_the_task_either(name: str) -> None:
    one, other = pair_of(name)
    assert_same(one.observation, other.observation)


@pytest.mark.parametrize("name", EVERY)
def test_rewards_depend_on_the_task(name: str) -> None:
    # Otherwise the tests above would compare a task with itself.
    one, other = pair_of(name)
    assert not np.array_equal(one.undiscounted_return, other.undiscounted_return)


@pytest.mark.parametrize("name", EVERY)
def test_episodes_are_repeatable(name: str) -> None:
    tasks, pair = two_tasks(EVERY[name])
    env = EVERY[name].make_env()
    first, again = pair_of(name)[0], play_in(env, tasks, pair[0])
    assert_same(first, again)
    other = play(env, tasks, [pair[0]] * 2, episodes=4, cast=agents(env, 2), seed=1)
    for field in ("action", "noise", "z"):
        draws = [np.asarray(getattr(episodes, field)) for episodes in (first, other)]
        if field == "action" and env.action_kind == "discrete":  # one of a few choices
            assert not np.array_equal(*draws)
        else:
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
        task = jax.tree.map(jnp.asarray, tasks[index])
        readings = readings_at(env, *env.initial(keys(1)[0], task))
        return env.observe(readings), env.instruction(task)

    (seen_one, shown_one), (seen_other, shown_other) = map(first, pair)
    assert_same(seen_one, seen_other)
    assert (name, variant) in INSTRUCTED or np.array_equal(shown_one, shown_other)


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
    tasks, pair = two_tasks(FAMILIES["point"])
    assert leaks(*(play_in(make_env(), tasks, index) for index in pair))
