"""What a policy that reads rewards sees: nothing of the task while the goal is far.

The same episodes are played with the same random numbers in two tasks, as in `test_leaks`.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import PROBES
from playing import agents, play

from maesn.envs import FAMILIES, AnyEnv, Point
from maesn.experience.episodes import Episodes
from maesn.policies import GaussianMLPPolicy

EVERY = FAMILIES | PROBES
# The rewards of these depend on the goal's distance while it is far, in the reference.
REVEALING = {"ant", "blockpush"}


class SparseSeer(GaussianMLPPolicy):
    """A policy that sees sparse rewards wherever it plays."""

    @property
    def observed_reward(self) -> Any:
        return "sparse"


def two_tasks(name: str) -> list[int]:
    """Two tasks whose goals differ in their distance from the start, where there are such."""
    tasks = EVERY[name].task_set("test").tasks
    if name == "blockpush":
        alike = np.flatnonzero((tasks.layout == tasks.layout[0]).all((1, 2)))
        return [int(alike[0]), int(alike[-1])]
    first = np.abs(np.asarray(jax.tree.leaves(tasks)[0]).reshape(100, -1)[:, 0])
    order = np.argsort(first)  # not the extremes: the shortest life of `hidden_end` is one step
    return [int(order[30]), int(order[95])]


def play_in(env: AnyEnv, index: int) -> Episodes:
    return play(env, EVERY[env.name].task_set("test"), [index, index], cast=agents(env, 2))


@pytest.mark.parametrize(
    ("name", "variant"),
    # The paper's block pushing shows its goal to every policy, so that episodes differ. Probes are
    # the same in both variants.
    # The wheeled robot has the point's rewards.
    [
        *((name, "reference") for name in EVERY),
        *((name, "paper") for name in ("ant", "point")),
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
