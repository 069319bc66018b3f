"""Every environment: sizes as announced, compiled and mapped without a difference."""

import dataclasses
import functools
from collections.abc import Callable
from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import PROBES
from playing import readings_at

from maesn.envs import FAMILIES, AbstractPureEnv, AnyEnv, TaskFamily

EVERY = FAMILIES | PROBES
BATCH = 2


@pytest.fixture(params=EVERY)
def family(request: pytest.FixtureRequest) -> TaskFamily:
    return EVERY[request.param]


@pytest.fixture
def env(family: TaskFamily) -> AnyEnv:
    return family.make_env()


def one_step(env: AnyEnv) -> Callable[[jax.Array, Any], dict[str, Any]]:
    """Everything that an environment computes in one step, as one function of a key and a task."""
    shapes = jax.tree.map(jnp.shape, some_readings(env))
    both = [env, dataclasses.replace(env, reward_kind="sparse")]

    def step(key: jax.Array, task: Any) -> dict[str, Any]:
        start_key, action_key, drift_key = jax.random.split(key, 3)
        qpos, qvel = env.initial(start_key, task)
        derived = {
            name: jax.random.normal(drift_key, shape)
            for name, shape in shapes.items()
            if name not in ("qpos", "qvel")
        }
        readings = {"qpos": qpos, "qvel": qvel, **derived}
        action = 2 * jax.random.normal(action_key, (env.action_size,))
        control = env.control(action)
        if isinstance(env, AbstractPureEnv):
            following = env.advance(readings, control)
        else:  # what the engine does is tested with the engine
            drift = jax.random.normal(drift_key)
            following = jax.tree.map(lambda reading: reading + drift, readings)
        observation = jnp.concatenate([env.observe(following), env.instruction(task)])
        return {
            "readings": readings,
            "control": control,
            "following": following,
            "observation": observation,
            "reward": [kind.reward(readings, action, following, task) for kind in both],
            "terminated": env.terminated(following),
            "solved": env.solved(following, task),
            "position": env.position(observation),
            "goal": env.goal(task),
            "landmarks": env.landmarks(task),
            "model_fields": env.model_fields(task),
        }

    return step


@functools.cache
def some_readings(env: AnyEnv) -> dict[str, jax.Array]:
    """Readings of the right shapes."""
    task = jax.tree.map(jnp.asarray, EVERY[env.name].task_set("training")[0])
    return readings_at(env, *env.initial(jax.random.key(0), task))


def arguments(family: TaskFamily) -> tuple[jax.Array, Any]:
    tasks = jax.tree.map(jnp.asarray, family.task_set("training")[:BATCH])
    return jax.random.split(jax.random.key(4), BATCH), tasks


@functools.cache
def steps_of(name: str) -> dict[str, Any]:
    """Compiled and mapped over keys and tasks."""
    return jax.jit(jax.vmap(one_step(EVERY[name].make_env())))(*arguments(EVERY[name]))


def test_sizes_are_as_announced(family: TaskFamily, env: AnyEnv) -> None:
    step = jax.tree.map(lambda leaf: leaf[0], steps_of(family.name))
    assert step["observation"].shape == (env.observation_size,)
    assert jax.tree.map(jnp.shape, step["following"]) == jax.tree.map(jnp.shape, step["readings"])
    assert step["position"].shape == step["goal"].shape == (2,)
    assert step["landmarks"].shape == ((5, 2) if env.name == "blockpush" else (0, 2))
    assert [x.shape for x in jax.tree.leaves(step["reward"])] == [()] * 4
    assert (step["terminated"].dtype, step["solved"].dtype) == (bool, bool)
    floats = [x for x in jax.tree.leaves(step) if x.dtype != bool]
    assert all(x.dtype == jnp.float32 for x in floats)
    assert env.horizon >= 1
    assert env.control_period > 0


def test_compiled_and_mapped_equals_interpreted_one_by_one(family: TaskFamily, env: AnyEnv) -> None:
    keys, tasks = arguments(family)
    singles = [one_step(env)(keys[i], jax.tree.map(itemgetter(i), tasks)) for i in range(BATCH)]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *singles)
    assert jax.tree.structure(stacked) == jax.tree.structure(steps_of(family.name))
    # Up to the rounding of fused operations.
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6),
        steps_of(family.name),
        stacked,
    )
