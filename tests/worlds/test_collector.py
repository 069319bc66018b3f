"""Collecting episodes: what depends on what, and what is recorded."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import HiddenEnd
from playing import agents, assert_same, keys, play

from maesn.envs import AnyEnv, Point, TaskSet, Wheeled, point, wheeled
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.policies import PolicyInput
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

TASKS = {"point": point.task_set("training"), "wheeled": wheeled.task_set("training")}
EXACT = ("valid", "solved", "terminated", "noise")


@pytest.fixture(scope="module", params=["point", "wheeled"])
def env(request: pytest.FixtureRequest) -> AnyEnv:
    return {"point": Point(horizon=25), "wheeled": Wheeled(horizon=25)}[request.param]


@functools.cache
def collector(env: AnyEnv, episodes: int = 3) -> Collector:
    return Collector(make_world(env, TASKS[env.name]), episodes)


def take(tree: Any, index: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def cast_of(everyone: Agents, index: Any) -> Agents:
    return Agents(everyone.policy, take(everyone.context, index), everyone.shares_policy)


def assert_equal_up_to_rounding(first: Episodes, second: Episodes) -> None:
    """Truth values and random draws exactly; what went through a matrix product to 1e-5."""
    for name in EXACT:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
    starts = (x.observation[..., 0, :] for x in (first, second))
    np.testing.assert_array_equal(*starts)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), first, second)


def test_a_batch_of_four_tasks_equals_two_of_two(env: AnyEnv) -> None:
    collect, cast, index = collector(env), agents(env, 4), jnp.array([5, 9, 9, 2])
    together = collect(keys(4), cast, index)
    halves = [
        collect(keys(4)[part], cast_of(cast, part), index[part])
        for part in (slice(0, 2), slice(2, 4))
    ]
    apart = jax.tree.map(lambda *parts: jnp.concatenate(parts), *halves)
    assert_equal_up_to_rounding(together, apart)


def test_more_episodes_begin_with_the_same_ones(env: AnyEnv) -> None:
    few, many = (
        collector(env, count)(keys(2), agents(env, 2), jnp.array([0, 1])) for count in (2, 3)
    )
    assert_equal_up_to_rounding(few, take(many, (slice(None), slice(0, 2))))


def test_a_slot_depends_on_no_other_slot(env: AnyEnv) -> None:
    collect = collector(env)
    everyone = agents(env, 6)
    before = collect(keys(4), cast_of(everyone, slice(0, 4)), jnp.array([0, 1, 2, 3]))
    # Other keys, other tasks and other latents for all but slot 1.
    strangers = cast_of(everyone, jnp.array([4, 1, 5, 0]))
    after = collect(keys(4)[jnp.array([2, 1, 3, 0])], strangers, jnp.array([8, 1, 7, 7]))
    assert_same(take(before, 1), take(after, 1))
    for slot in (0, 2, 3):
        assert not np.any(np.equal(before.action[slot], after.action[slot]))
    # What a key draws does not depend on the place of its slot.
    np.testing.assert_array_equal(before.noise[0], after.noise[3])


def test_log_probabilities_can_be_recomputed_from_what_is_recorded(env: AnyEnv) -> None:
    cast = agents(env, 2)
    episodes = collector(env)(keys(2), cast, jnp.array([0, 1]))

    def log_prob(observation: Any, context: Any, action: Any) -> Any:
        seen = PolicyInput(observation, jnp.zeros_like(action), jnp.zeros(()), jnp.zeros((), bool))
        return cast.policy(seen, context, None)[0].log_prob(action)

    # The context has no time axis: one and the same z explains every step of an episode.
    steps = jax.vmap(log_prob, (0, None, 0))
    recomputed = jax.jit(jax.vmap(jax.vmap(steps)))(
        episodes.observation[:, :, :-1], episodes.z, episodes.action
    )
    recorded = episodes.behaviour.log_prob(episodes.action)
    np.testing.assert_allclose(recorded, recomputed, rtol=1e-5, atol=1e-5)


def test_policies_of_their_own_equal_shared_ones(env: AnyEnv) -> None:
    first, second = (agents(env, 2, seed=seed) for seed in (0, 1))
    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), first.policy, second.policy)
    index = jnp.array([0, 1])
    own = collector(env)(keys(2), Agents(both, first.context, shares_policy=False), index)
    for slot, policy in enumerate((first.policy, second.policy)):
        cast = Agents(policy, first.context, shares_policy=True)
        shared = collector(env)(keys(2), cast, index)
        assert_equal_up_to_rounding(take(own, slot), take(shared, slot))


def test_masks_of_episodes_that_end_early() -> None:
    env, lifetimes = HiddenEnd(horizon=6), np.float32([2.0, 9.0, 6.0])
    episodes = play(env, TaskSet(lifetimes), [0, 1, 2], episodes=2)
    alive = np.array([[1, 1, 0, 0, 0, 0], [1] * 6, [1] * 6], bool)
    np.testing.assert_array_equal(episodes.valid, np.stack([alive] * 2, axis=1))
    # By nature, by the clock, and by nature in the very last step.
    np.testing.assert_array_equal(episodes.terminated[:, 0], [True, False, True])
    np.testing.assert_array_equal(episodes.solved[:, 0, 1], [True, False, False])
    assert not np.any(episodes.solved[0, :, 2:])
    np.testing.assert_array_equal(episodes.undiscounted_return[:, 0], [2, 6, 6])
    assert np.isnan(episodes.reward[0, :, 2:]).all()
