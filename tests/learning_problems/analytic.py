"""A tiny world in NumPy, for learners that must be run and not only fed."""

from dataclasses import dataclass, field

import jax
import numpy as np
from reference.advantage import Episode
from reference.parameters import Array, Parameters
from reference.policy import action_log_std, action_mean

from learning_problems.prepared import HORIZON, stack
from learning_problems.translation import policy_to_reference
from maesn.context import AbstractContext, Bias, Latent
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes

OBSERVATION, ACTION = 3, 2


@dataclass
class AnalyticCollect:
    """A `Collect` in which a point is pushed towards a goal on the unit circle.

    The agents' own weights play, in double precision; all randomness comes from the keys.
    """

    num_tasks: int = 7
    episodes_per_task: int = 4
    index: list[Array] = field(default_factory=list)
    """Tasks that were asked for, call by call."""

    def __call__(
        self, keys: jax.Array, agents: Agents, task_index: jax.Array, stage: int = 0
    ) -> Episodes:
        """Play every episode to its horizon."""
        self.index.append(np.asarray(task_index))
        seeds = np.asarray(jax.random.key_data(keys))
        batch = []
        for slot, row in enumerate(self.index[-1]):
            rng = np.random.default_rng(seeds[slot].tolist())
            angle = np.pi * row / self.num_tasks
            goal = np.array([np.cos(angle), np.sin(angle)])
            batch.append(
                [self._episode(rng, agents, slot, goal) for _ in range(self.episodes_per_task)]
            )
        return stack(batch)

    def _episode(self, rng: np.random.Generator, agents: Agents, slot: int, goal: Array) -> Episode:
        theta = policy_of(agents, slot)
        size = agents.context.size if isinstance(agents.context, Latent) else 0
        noise = rng.normal(size=size)
        drawn = draw(agents.context, slot, noise)
        std = np.exp(action_log_std(theta))
        position = 0.1 * rng.normal(size=2)
        observations, means, actions, rewards = [], [], [], []
        for step in range(HORIZON):
            observations.append(np.append(position, step / HORIZON))
            means.append(action_mean(theta, observations[-1][None], drawn)[0])
            actions.append(means[-1] + std * rng.normal(size=ACTION))
            position = position + 0.3 * np.tanh(actions[-1])
            rewards.append(-np.linalg.norm(position - goal))
        return Episode(
            observation=np.stack(observations),
            action=np.stack(actions),
            reward=np.array(rewards),
            noise=noise,
            latent=drawn,
            mean=np.stack(means),
            log_std=np.tile(np.log(std), (HORIZON, 1)),
        )


def policy_of(agents: Agents, slot: int) -> Parameters:
    """Return the weights of one task slot."""
    if agents.shares_policy:
        return policy_to_reference(agents.policy)
    return policy_to_reference(jax.tree.map(lambda x: np.asarray(x)[slot], agents.policy))


def draw(context: AbstractContext, slot: int, noise: Array) -> Array:
    """Return what the policy of one task slot is fed."""
    if isinstance(context, Latent):
        mean, log_std = (np.float64(x)[slot] for x in (context.mean, context.log_std))
        return mean + np.exp(log_std) * noise
    if isinstance(context, Bias):
        return np.float64(context.value)[slot]
    return np.zeros(0)
