"""The oracle: it is given the task, learns what to do with that, and adapts nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import PROBES, hidden_target
from playing import assert_same, keys

from maesn import oracle
from maesn.context import OracleContext
from maesn.envs import FAMILIES, BlockPushTask
from maesn.evaluation.adapting import adapt
from maesn.learners import Problem
from maesn.policies import GaussianMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

SMALL = {"policy": GaussianMLP((8,)), "meta_batch_size": 4}


def test_an_oracle_is_fed_the_description_of_its_own_task() -> None:
    env, tasks = FAMILIES["point"].make_env(), FAMILIES["point"].task_set("test", 6)
    learner = oracle(**SMALL)
    fast = learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, 6, 2)))
    index = jnp.asarray([4, 1])
    agents = fast.agents(fast.init(keys(2)))
    episodes = Collector(make_world(env, tasks), 3)(keys(2), agents, index)
    wanted = np.repeat(np.asarray(tasks.tasks)[[4, 1], None], 3, axis=1)
    np.testing.assert_array_equal(episodes.z, wanted)
    np.testing.assert_array_equal(episodes.description, wanted)
    assert episodes.noise.shape[-1] == 0
    assert episodes.observation.shape[-1] == 2


def test_the_context_of_an_oracle_is_neither_random_nor_learned_nor_penalised() -> None:
    context = OracleContext()
    learned = context.init(jax.random.key(0), num_tasks=5, description_size=3)
    assert jax.tree.leaves(learned) == []
    assert (learned.size, learned.description_size) == (3, 3)
    description = jnp.asarray([1.0, -2.0, 0.5])
    noise = learned.noise(jax.random.key(0), jnp.zeros((), int))
    assert noise.shape == (0,)
    np.testing.assert_array_equal(learned.draw(noise, description), description)
    assert context.start(learned, jnp.asarray([1])) == context.start_new(learned, 2) == learned
    drawn = jnp.ones((2, 3))
    assert context.draw_loss(learned, drawn, jnp.ones(2)) == 0.0
    assert context.penalty(learned, learned, jnp.ones((2, 0))) == 0.0


@pytest.mark.parametrize("name", FAMILIES | PROBES)
def test_descriptions_tell_all_tasks_apart(name: str) -> None:
    family = (FAMILIES | PROBES)[name]
    env, tasks = family.make_env(), family.task_set("test", 20)
    description = np.asarray(jax.vmap(env.describe)(jax.tree.map(jnp.asarray, tasks.tasks)))
    assert description.ndim == 2
    assert np.isfinite(description).all()
    different = {tuple(row) for row in description}
    leaves = [np.asarray(leaf).reshape(len(tasks), -1) for leaf in jax.tree.leaves(tasks.tasks)]
    assert len(different) == len(np.unique(np.concatenate(leaves, axis=1), axis=0))


def test_an_oracle_of_block_pushing_is_told_the_block_and_the_goal() -> None:
    task = BlockPushTask(jnp.asarray(3), jnp.asarray([0.8, -0.25]), jnp.zeros((5, 2)))
    for variant in ("reference", "paper"):
        description = FAMILIES["blockpush"].make_env(variant=variant).describe(task)
        np.testing.assert_array_equal(description, np.float32([0, 0, 0, 1, 0, 0.8, -0.25]))


def test_updates_of_the_oracle_change_nothing() -> None:
    env, tasks = FAMILIES["point"].make_env(), FAMILIES["point"].task_set("test", 3)
    learner = oracle(**SMALL)
    fast = learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, 6, 2)))
    state = fast.init(keys(3))
    episodes = Collector(make_world(env, tasks), 3)(keys(3), fast.agents(state), jnp.arange(3))
    assert_same(fast.agents(fast.update(state, episodes)), fast.agents(state))


@pytest.mark.long
def test_the_oracle_beats_every_policy_that_is_not_told() -> None:
    # Without the task, -0.595 is the best there is (`learning_problems.probes`); with it, 0.
    env, tasks = hidden_target.make_env(), hidden_target.task_set("training", 20)
    learner = oracle(policy=GaussianMLP((16,)), meta_batch_size=10)
    state = learner.init(jax.random.key(0), Problem(env.observation_size, env.action_size, 20, 2))
    collect = Collector(make_world(env, tasks), 10)
    for step in range(80):
        state, _ = learner.step(jax.random.key(step), state, collect)
    unseen = Collector(make_world(env, hidden_target.task_set("test", 20)), 20)
    curves = adapt(learner.fast_learner(state), unseen, episodes=0).curves
    assert curves.mean_return.mean() > -0.3
