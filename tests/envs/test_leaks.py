"""No environment leaks its task into what the agent sees.

`observe` receives no task, but a task could still travel in the state. So the same episodes are
played with the same random numbers in two tasks: as long as both live, observations and hence
actions must agree bit for bit, while rewards must differ. Of these, a policy that reads rewards
sees nothing that depends on the task while the goal is far.
"""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import PROBES
from playing import agents, assert_same, keys, play, readings_at

from maesn.envs import FAMILIES, AnyEnv, BlockPushTask, Point
from maesn.experience.episodes import Episodes
from maesn.policies import GaussianMLPPolicy

EVERY = FAMILIES | PROBES


# Here the agent sees its goal.
INSTRUCTED = {("blockpush", "paper")}
# Here the motion depends on the task.
SHOWN_BY_DYNAMICS = {"cheetah_body"}
# Here every step's reward tells about the task: there is no other, dense or sparse.
INFORMATIVE = {"cheetah_vel", "cheetah_dir", "cheetah_body", "ant_dir", "ant_goal"}


def two_tasks(name: str) -> list[int]:
    """Two tasks that look alike to the agent and differ in their first number."""
    tasks = EVERY[name].task_set("test").tasks
    if isinstance(tasks, BlockPushTask):  # tables that are laid alike
        alike = np.flatnonzero((tasks.layout == tasks.layout[0]).all((1, 2)))
        return [int(alike[0]), int(alike[-1])]
    first = np.asarray(jax.tree.leaves(tasks)[0])
    order = np.argsort(first.reshape(len(first), -1)[:, 0], kind="stable")
    # Not the extremes: the shortest life of `hidden_end` is one step.
    return [int(order[int(share * len(order))]) for share in (0.3, 0.95)]


def play_in(env: AnyEnv, index: int, seed: int = 0) -> Episodes:
    tasks = EVERY[env.name].task_set("test")
    return play(env, tasks, [index, index], episodes=4, cast=agents(env, 2), seed=seed)


@cache
def pair_of(name: str) -> tuple[Episodes, Episodes]:
    """The same random numbers in two tasks of a family."""
    one, other = (play_in(EVERY[name].make_env(), index) for index in two_tasks(name))
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


@pytest.mark.parametrize("name", sorted(EVERY.keys() - SHOWN_BY_DYNAMICS))
def test_nothing_seen_in_an_episode_depends_on_the_task(name: str) -> None:
    one, other = pair_of(name)
    assert not leaks(one, other)
    if name in FAMILIES:  # the last state of a robot does not depend on it either
        assert_same(one.observation, other.observation)
    # Rewards do, or a task would be compared with itself.
    assert not np.array_equal(one.undiscounted_return, other.undiscounted_return)


@pytest.mark.parametrize("name", EVERY)
def test_episodes_are_repeatable(name: str) -> None:
    env, index = EVERY[name].make_env(), two_tasks(name)[0]
    first = pair_of(name)[0]
    assert_same(first, play_in(env, index))
    other = play_in(env, index, seed=1)
    for field in ("action", "noise", "z"):
        draws = [np.asarray(getattr(episodes, field)) for episodes in (first, other)]
        if field == "action" and env.action_kind == "discrete":  # one of a few choices
            assert not np.array_equal(*draws)
        else:
            assert not np.any(np.equal(*draws))


VARIANTS = [
    (name, variant) for name, family in EVERY.items() for variant in family.make_env().variants
]


@pytest.mark.parametrize("reward_kind", ["dense", "sparse"])
@pytest.mark.parametrize(("name", "variant"), VARIANTS)
def test_the_start_and_the_instruction_do_not_depend_on_the_task(
    name: str, variant: str, reward_kind: str
) -> None:
    env = EVERY[name].make_env(variant=variant, reward_kind=reward_kind)
    tasks = EVERY[name].task_set("test")

    def first(index: int) -> tuple[jax.Array, jax.Array]:
        task = jax.tree.map(jnp.asarray, tasks[index])
        readings = readings_at(env, *env.initial(keys(1)[0], task))
        return env.observe(readings), env.instruction(task)

    (seen_one, shown_one), (seen_other, shown_other) = map(first, two_tasks(name))
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
    assert leaks(*(play_in(make_env(), index) for index in two_tasks("point")))


# The rewards of these depend on the goal's distance while it is far, in the reference.
REVEALING = {"ant", "blockpush"}


class SparseSeer(GaussianMLPPolicy):
    """A policy that sees sparse rewards wherever it plays."""

    @property
    def observed_reward(self) -> Any:
        return "sparse"


@pytest.mark.parametrize(
    ("name", "variant"),
    # The paper's block pushing shows its goal to every policy, so that episodes differ. Probes are
    # the same in both variants.
    # The wheeled robot has the point's rewards.
    [
        *((name, "reference") for name in EVERY if name not in INFORMATIVE),
        *((name, "paper") for name in ("ant", "point")),
        *(("sparse_point", variant) for variant in ("varibad", "metacure")),
        pytest.param("wheeled", "paper", marks=pytest.mark.long),
    ],
)
def test_far_from_the_goal_what_is_seen_does_not_depend_on_the_task(
    name: str, variant: str
) -> None:
    env = EVERY[name].make_env(reward_kind="sparse", variant=variant, horizon=12)
    one, other = (play_in(env, index) for index in two_tasks(name))
    far = np.asarray(one.valid & other.valid & ~one.solved & ~other.solved)
    assert far.any()
    assert one.observed_reward is not None
    assert other.observed_reward is not None
    seen = [np.asarray(episodes.observed_reward)[far] for episodes in (one, other)]
    np.testing.assert_array_equal(*seen)
    # The reward itself may depend on it, and this test would notice if the policy saw that.
    # (Distances of 2 m to goals on a circle differ by rounding: what is seen must not even so.)
    rewards = [np.asarray(episodes.reward)[far] for episodes in (one, other)]
    reveals = not np.allclose(*rewards, rtol=1e-5)
    assert reveals == (variant == "reference" and name in REVEALING)


def test_near_the_goal_a_policy_sees_the_reward() -> None:
    env = Point(reward_kind="sparse", sparse_radius=10.0)
    episodes = play_in(env, 0)
    assert np.asarray(episodes.solved).all()
    np.testing.assert_array_equal(episodes.observed_reward, episodes.reward)


def test_a_policy_sees_dense_rewards_as_they_are() -> None:
    episodes = play_in(Point(), 0)
    np.testing.assert_array_equal(episodes.observed_reward, episodes.reward)


def test_a_policy_can_see_sparse_rewards_in_a_world_of_dense_ones() -> None:
    """Sparse input and dense objective: the reward is -d, and the policy sees -2 - cost."""
    env, tasks = Point(horizon=12), EVERY["point"].task_set("test")
    cast = agents(env, 2)
    seer = SparseSeer(cast.policy.mlp, cast.policy.log_std)  # type: ignore[attr-defined]
    sparse = play(Point(horizon=12, reward_kind="sparse"), tasks, [0, 1], cast=cast)
    dense = play(env, tasks, [0, 1], cast=cast)
    both = play(
        env, tasks, [0, 1], cast=type(cast)(seer, cast.context, cast.shares_policy), episodes=3
    )
    np.testing.assert_array_equal(both.reward, dense.reward)
    np.testing.assert_array_equal(both.observed_reward, sparse.observed_reward)
    assert not np.array_equal(np.asarray(both.observed_reward), np.asarray(both.reward))
    inputs = both.policy_inputs()
    assert both.observed_reward is not None
    np.testing.assert_array_equal(inputs.previous_reward[..., 1:], both.observed_reward[..., :-1])
    np.testing.assert_array_equal(inputs.previous_reward[..., 0], jnp.zeros((2, 3)))
