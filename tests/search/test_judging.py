"""Episodes judged under tasks that they were not played for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from runtime.robot import fast_learner

from maesn.envs import FAMILIES, AnyEnv, TaskFamily, TaskSet
from maesn.envs.blockpush import blockpush
from maesn.envs.point import point
from maesn.search.prior import returns_under, situations
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

OWN = [family for family in FAMILIES.values() if family.name in ("point", "wheeled", "blockpush")]


def sparse(family: TaskFamily, **settings: object) -> AnyEnv:
    return family.make_env(reward_kind="sparse", **settings)


@pytest.mark.parametrize("family", OWN, ids=lambda family: family.name)
def test_an_episode_returns_in_its_own_task_what_it_was_played_for(family: TaskFamily) -> None:
    """And in another task of the situation what it returns when it is played there."""
    env, tasks = sparse(family), TaskSet(family.draw_tasks(np.random.default_rng(0), 10))
    group = next(group for group in situations(env, tasks) if len(group) > 1)[:3]
    world = make_world(env, tasks, num_threads=1)
    learner = fast_learner(env)
    keys = jnp.stack([jax.random.key(3)] * len(group))
    agents = learner.agents(learner.init(keys))
    episodes, readings = Collector(world, 4).play(keys, agents, jnp.asarray(group))
    world.close()
    first = jax.tree.map(lambda x: x[:, :4], readings)
    judged = returns_under(env, first, episodes.action[0], episodes.valid[0], tasks[group])
    # The same keys: the same episodes in every task.
    np.testing.assert_allclose(judged, episodes.undiscounted_return, rtol=1e-5)


@pytest.mark.parametrize("variant", ["reference", "paper"])
@pytest.mark.parametrize("name", ["point", "wheeled", "ant", "blockpush"])
def test_outside_of_the_radius_the_goal_s_part_is_the_far_reward(name: str, variant: str) -> None:
    family = FAMILIES[name]
    env = sparse(family, variant=variant, sparse_radius=1e-6)
    tasks = TaskSet(family.draw_tasks(np.random.default_rng(1), 3))
    world = make_world(env, tasks, num_threads=1)
    learner = fast_learner(env)
    keys = jax.random.split(jax.random.key(0), 3)
    episodes = Collector(world, 1)(keys, learner.agents(learner.init(keys)), jnp.arange(3))
    world.close()
    far = jax.vmap(env.far_reward)(tasks.tasks)[:, None, None]
    expected = jnp.where(episodes.valid, far, episodes.goal_reward)
    np.testing.assert_allclose(episodes.goal_reward, expected, rtol=1e-6)


def test_tasks_share_episodes_where_only_their_rewards_differ() -> None:
    goals = TaskSet(point.draw_tasks(np.random.default_rng(0), 6))
    assert [group.tolist() for group in situations(sparse(point), goals)] == [list(range(6))]
    pushes = TaskSet(blockpush.draw_tasks(np.random.default_rng(0), 10))
    groups = situations(sparse(blockpush), pushes)
    assert [len(group) for group in groups] == [5, 5]
    for group in groups:
        layouts = pushes.tasks.layout[group]
        np.testing.assert_array_equal(layouts, np.broadcast_to(layouts[:1], layouts.shape))
    # The variant of the paper shows the goal, and so what is done depends on it.
    assert len(situations(sparse(blockpush, variant="paper"), pushes)) == 10
