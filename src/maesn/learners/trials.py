"""Trials: recorded episodes, with all that another policy's likelihood of them depends on."""

from collections.abc import Sequence
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.experience.agent import Agent
from maesn.experience.episodes import Episodes, Thinning
from maesn.numerics import AbstractDistribution
from maesn.policies import AbstractPolicy, PolicyInput


class Trials(eqx.Module):
    """Independent trials, each of one episode or of several episodes of the same task.

    `time` runs over all episodes of a trial, one after another. An episode that ended early leaves
    a gap of invalid steps before the next one. The recurrent state is reset at the start of every
    trial.
    """

    inputs: PolicyInput
    """Inputs of the policy, `[trial time ...]`; 0 where invalid."""
    action: Float[Array, "trial time action"]
    """The policy's actions; 0 where invalid."""
    reward: Float[Array, "trial time"]
    """Rewards to learn from; 0 where invalid."""
    valid: Bool[Array, "trial time"]
    behaviour: AbstractDistribution
    """The distribution that each action was drawn from, `[trial time action]`."""
    z: Float[Array, "trial z"]
    """The context's input to the policy, constant during a trial."""

    def distributions(self, policy: AbstractPolicy) -> AbstractDistribution:
        """Return a policy's action distributions along the trials, `[trial time action]`.

        Gradients run through the whole of every trial.
        """
        trials = self.valid.shape[0]
        initial_states = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (trials, *x.shape)), policy.initial_recurrent_state()
        )
        return policy.unroll(self.inputs, self.valid, self.z, initial_states)[0]

    def sample_trials(self, key: Key, stride: int) -> "Trials":
        """Draw one in `stride` of the trials, at least one."""
        count = self.valid.shape[0]
        rows = jax.random.permutation(key, count)[: max(count // stride, 1)]
        return jax.tree.map(lambda x: x[rows], self)

    def sample_steps(self, key: Key, stride: int) -> "Trials":
        """Draw every `stride`-th time step of all trials. A recurrent policy needs all steps."""
        thinning = Thinning.draw(key, stride, self.valid)
        steps = self.inputs, self.action, self.reward, self.valid, self.behaviour
        chosen: _Steps = jax.tree.map(lambda x: thinning.take(x, 1), steps)
        return Trials(*chosen, self.z)


def join_episodes(episodes: Sequence[Episodes]) -> Trials:
    """Concatenate the episodes of each trial in time.

    Args:
        episodes: the first, second, ... episode of every trial, `[task, episode, time, ...]`. Each
            pair of a task and an episode index is one trial.
    """
    flat = [
        jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), _steps(one, one.policy_inputs()))
        for one in episodes
    ]
    joined: _Steps = jax.tree.map(lambda *arrays: jnp.concatenate(arrays, axis=1), *flat)
    z = episodes[0].z
    # Not -1 for the number of trials: z may have no components.
    return Trials(*joined, z.reshape(z.shape[0] * z.shape[1], z.shape[2]))


def trials_of(agent: Agent, episodes: Episodes) -> Trials:
    """Return an agent's episodes `[episode, time, ...]` in one task, each as a trial of its own."""
    return Trials(*_steps(episodes, agent.perceive(episodes.policy_inputs())), episodes.z)


# The fields of `Trials` that have a time axis, in their order.
_Steps: TypeAlias = tuple[PolicyInput, Array, Array, Array, AbstractDistribution]


def _steps(episodes: Episodes, inputs: PolicyInput) -> _Steps:
    """Return all that has a time axis, with the axes of the episodes; 0 where invalid."""
    valid = episodes.valid
    action = jnp.where(valid[..., None], episodes.action, 0.0)
    reward = jnp.where(valid, episodes.reward, 0.0)
    return inputs, action, reward, valid, episodes.behaviour
