"""Baselines: agents that do nothing, or anything, and learn nothing.

A method is judged by where it stands between them and an oracle.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp

from maesn.axes import ActionKind, TaskKeys
from maesn.context import Nothing
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners.fast import AbstractFastLearner, Capabilities, Purpose
from maesn.policies import AbstractPolicy, AbstractPolicySettings, CategoricalMLP, GaussianMLP
from maesn.policies.feed_forward import MINIMUM_STD


class FixedPolicy(AbstractFastLearner[None]):
    """Acts with one fixed policy in all tasks."""

    policy: AbstractPolicy

    def init(self, keys: TaskKeys) -> None:
        """Remember nothing."""

    def agents(self, state: None, purpose: Purpose = "explore") -> Agents:
        return Agents(self.policy, Nothing(), shares_policy=True)

    def update(self, state: None, episodes: Episodes) -> None:
        """Learn nothing."""

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(learns_from_reward=False)


def baselines(
    observation_size: int, action_size: int, action_kind: ActionKind
) -> dict[str, FixedPolicy]:
    """Return the baselines by name; the better one is the reference of a comparison.

    * zero action: a = 0, to the least standard deviation that a policy has (a millionth);
    * random actions: a ~ N(0, I) at every step, close to what an untrained policy does;
    * random choices, where actions are discrete and there is no zero: each with the same
      probability.

    Args:
        observation_size: components of an observation.
        action_size: components of an action, or number of choices.
        action_kind: continuous or discrete.
    """
    if action_kind == "discrete":
        return {
            "random choices": FixedPolicy(_blind(CategoricalMLP(()), observation_size, action_size))
        }
    random = _blind(GaussianMLP(()), observation_size, action_size)
    least = jnp.full(action_size, math.log(MINIMUM_STD), dtype=float)
    still = eqx.tree_at(lambda policy: policy.log_std, random, least)
    return {"zero action": FixedPolicy(still), "random actions": FixedPolicy(random)}


def _blind(
    settings: AbstractPolicySettings, observation_size: int, action_size: int
) -> AbstractPolicy:
    """Return a policy whose weights are all 0: it sees nothing, and a Gaussian's std is 1."""
    key = jax.random.key(0)
    return jax.tree.map(jnp.zeros_like, settings.init(key, observation_size, action_size, 0))
