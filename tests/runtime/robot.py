"""A cast for the tests of the runtime: a learner with odd numbers, and episodes of a mock robot."""

import functools
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from maesn import maesn as maesn_preset
from maesn.context import Latent
from maesn.envs import AnyEnv, Point
from maesn.evaluation.exporting import Stated, exported_policy, write_policy
from maesn.learners import Problem
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.policies import GaussianMLP
from maesn.runtime import Explorer
from maesn.runtime.record import encoded
from maesn.runtime.storage import Snapshot

LATENT_SIZE = 2
STEPS = 5

Rewards = Callable[[np.ndarray, int], Sequence[float]]


def fast_learner(env: AnyEnv | None = None, **settings: Any) -> GradientFastLearner:
    """A fast learner with random weights and another step size for every parameter."""
    env = Point() if env is None else env
    settings = {"policy": GaussianMLP((16, 12), initial_std=0.3), "meta_batch_size": 1, **settings}
    learner = maesn_preset(**settings)
    state = learner.init(jax.random.key(3), Problem(env.observation_size, env.action_size, 1))
    sizes = Latent(jnp.asarray([1.3, 0.4]), jnp.asarray([0.7, -0.2]))
    return eqx.tree_at(lambda fast: fast.step_sizes.context, learner.fast_learner(state), sizes)


def policy_file(
    directory: Path, env: AnyEnv | None = None, stated: Stated | None = None, **settings: Any
) -> Path:
    """An exported policy."""
    env = Point() if env is None else env
    path = directory / "policy.npz"
    learner = fast_learner(env, **settings)
    write_policy(path, exported_policy(learner, env, {"run": "a test"}, stated=stated or Stated()))
    return path


def observations(explorer: Explorer, num_steps: int, seed: int = 0) -> np.ndarray:
    """What a mock robot would see, `[time, observation]`."""
    shape = (num_steps, explorer.exported.observation_size)
    return np.random.default_rng(seed).standard_normal(shape)


def play(explorer: Explorer, num_episodes: int, rewards: Rewards, steps: int = STEPS) -> None:
    """Play episodes; `rewards(z, number)` returns those of one."""
    for number in range(num_episodes):
        z = explorer.begin_episode()
        for observation in observations(explorer, steps, seed=number):
            explorer.act(observation)
        explorer.end_episode(rewards(z, number))


def towards(target: Sequence[float], steps: int = STEPS) -> Rewards:
    """Rewards that are higher the nearer z is to a target."""
    return lambda z, number: [-float(np.linalg.norm(z - np.asarray(target)))] * steps


def constant(reward: float, steps: int = STEPS) -> Rewards:
    """Rewards around a constant."""
    return lambda z, number: [reward + 0.01 * (-1.0) ** number] * steps


def contents(explorer: Explorer) -> dict[str, Any]:
    """All that an explorer holds, in a form that can be compared."""
    random_state = explorer._generator.bit_generator.state
    state, search = replace(explorer._state, search=None), explorer._state.search
    history = None if search is None else search.history
    arrays, document = encoded(
        Snapshot(explorer.exported, state, explorer.safeguards, random_state, history)
    )
    return {"document": document} | {name: array.tolist() for name, array in arrays.items()}


def altered(path: Path, name: str, value: Any) -> Path:
    """A file with another array, or entry of its metadata, of that name; without it for None."""
    with np.load(path) as archive:
        entries = {one: archive[one] for one in archive.files}
    metadata = json.loads(str(entries["metadata"]))
    if value is None and name in entries:
        del entries[name]
    elif isinstance(value, np.ndarray):
        entries[name] = value
    else:
        *parents, last = name.split(".")
        functools.reduce(dict.__getitem__, parents, metadata)[last] = value
        entries["metadata"] = np.array(json.dumps(metadata))
    other = path.with_stem("altered")
    np.savez(other, **entries)
    return other
