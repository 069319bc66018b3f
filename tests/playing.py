"""Small casts for tests that play episodes: agents, keys, and comparisons of what was played."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maesn.context import Latent
from maesn.envs import AnyEnv, TaskSet
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.networks import MLP, Linear
from maesn.policies import CategoricalMLP, GaussianMLP, GaussianMLPPolicy
from maesn.worlds import Start, make_world, open_stepper
from maesn.worlds.collector import Collector

LATENT_SIZE = 2

_collectors: dict[tuple[Any, ...], Collector] = {}


def keys(num_tasks: int, seed: int = 0) -> jax.Array:
    """One key per task slot; the first ones do not depend on how many there are."""
    return jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), jnp.arange(num_tasks))


def agents(env: AnyEnv, num_tasks: int, seed: int = 0, hidden: tuple[int, ...] = (8,)) -> Agents:
    """Agents with random weights, and with another latent in every slot."""
    settings = {"continuous": GaussianMLP, "discrete": CategoricalMLP}[env.action_kind](hidden)
    policy = settings.init(jax.random.key(seed), env.observation_size, env.action_size, LATENT_SIZE)
    return Agents(policy, _latent(num_tasks, seed), shares_policy=True)


def constant_agents(env: AnyEnv, num_tasks: int, mean: Any, std: float) -> Agents:
    """Agents whose actions are N(mean, std^2), whatever they see and whatever their latent."""
    inputs = env.observation_size + LATENT_SIZE
    layer = Linear(jnp.zeros((inputs, env.action_size)), jnp.full(env.action_size, mean, float))
    log_std = jnp.full(env.action_size, math.log(std), float)
    return Agents(
        GaussianMLPPolicy(MLP((layer,)), log_std), _latent(num_tasks, 0), shares_policy=True
    )


def _latent(num_tasks: int, seed: int) -> Latent:
    mean_key, std_key = jax.random.split(jax.random.key(seed))
    shape = (num_tasks, LATENT_SIZE)
    return Latent(jax.random.normal(mean_key, shape), 0.3 * jax.random.normal(std_key, shape))


def play(
    env: AnyEnv,
    tasks: TaskSet,
    task_index: Any,
    *,
    episodes: int = 3,
    seed: int = 0,
    cast: Agents | None = None,
    **options: Any,
) -> Episodes:
    """Collect episodes of the tasks; collectors are kept, so that programs compile once."""
    index = jnp.asarray(task_index)
    which = (env, tasks.digest(), episodes, *sorted(options.items()))
    if which not in _collectors:
        _collectors[which] = Collector(make_world(env, tasks, **options), episodes)
    cast = agents(env, len(index)) if cast is None else cast
    return _collectors[which](keys(len(index), seed), cast, index)


def readings_at(env: AnyEnv, qpos: Any, qvel: Any) -> dict[str, jax.Array]:
    """What an engine reads in that state, in single precision as in episodes."""
    stepper = open_stepper(env, 1)
    read = stepper.begin(Start(np.float64(qpos)[None], np.float64(qvel)[None], {}), None)
    stepper.close()
    return {name: jnp.asarray(value[0], jnp.float32) for name, value in read.items()}


def assert_same(first: Any, second: Any) -> None:
    """Bit for bit, NaN included."""
    jax.tree.map(np.testing.assert_array_equal, first, second)
