"""The two ways of mapping over tasks give the same."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.context import Latent
from maesn.experience.agent import Agent, Agents
from maesn.numerics.normalization import no_observations
from maesn.numerics.tasks import How
from maesn.policies import GaussianMLP, PolicyInput

TASKS, OBSERVATION, ACTION, LATENT = 3, 4, 2, 2
pytestmark = pytest.mark.usefixtures("x64")


def agents_of(shares_policy: bool) -> Agents:
    def policy(key: jax.Array) -> Any:
        return GaussianMLP((5,)).init(key, OBSERVATION, ACTION, LATENT)

    keys = jax.random.split(jax.random.key(0), TASKS)
    mean = jax.random.normal(jax.random.key(1), (TASKS, LATENT))
    policies = policy(keys[0]) if shares_policy else jax.vmap(policy)(keys)
    seen = jax.random.normal(jax.random.key(3), (10, OBSERVATION))
    statistics = no_observations(OBSERVATION).with_batch(seen, jnp.ones(10, bool))
    return Agents(policies, Latent(mean, jnp.zeros_like(mean)), shares_policy, statistics)


def mean_action(agent: Agent, observation: jax.Array, scale: jax.Array) -> jax.Array:
    received = PolicyInput(observation, jnp.zeros(ACTION), jnp.zeros(()), jnp.zeros((), bool))
    distribution, _ = agent.policy(
        agent.perceive(received), agent.context.mean, agent.policy.initial_recurrent_state()
    )
    return scale * distribution.mean


@pytest.mark.parametrize("shares_policy", [True, False])
def test_one_after_the_other_is_all_at_once(shares_policy: bool) -> None:
    agents = agents_of(shares_policy)
    observation = jax.random.normal(jax.random.key(2), (TASKS, OBSERVATION))
    scale = jnp.arange(1.0, TASKS + 1)

    def loss(agents: Agents, mapping: How) -> jax.Array:
        return (agents.map(mean_action, observation, scale, how=mapping) ** 2).sum()

    at_once, serial = (
        jax.jit(jax.value_and_grad(loss), static_argnums=1)(agents, how)
        for how in ("vmap", "serial")
    )
    for expected, actual in zip(*map(jax.tree.leaves, (at_once, serial)), strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-12)
