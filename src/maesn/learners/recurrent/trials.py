"""Trials: what happens between two losses of memory, as one stretch of time."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.experience.episodes import Episodes
from maesn.numerics import AbstractDistribution
from maesn.policies import AbstractPolicy, PolicyInput


class Trials(eqx.Module):
    """Trials of any tasks. `time` runs over all episodes of a trial, one behind the other.

    An episode that ended early leaves a gap of invalid steps before the next one.
    """

    inputs: PolicyInput
    """What the policy was told, `[trial time ...]`; 0 where invalid."""
    action: Float[Array, "trial time action"]
    """What it did; 0 where invalid."""
    reward: Float[Array, "trial time"]
    """What it was paid, which is what it learns from; 0 where invalid."""
    valid: Bool[Array, "trial time"]
    behaviour: AbstractDistribution
    """The distribution that each action was drawn from, `[trial time action]`."""

    def distributions(self, policy: AbstractPolicy) -> AbstractDistribution:
        """Return a policy's distributions along the trials, `[trial time action]`.

        Memory starts afresh in every trial. Gradients run through the whole of it.
        """
        trials = self.valid.shape[0]
        fresh = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (trials, *x.shape)), policy.initial_recurrent_state()
        )
        return policy.unroll(self.inputs, self.valid, jnp.zeros((trials, 0)), fresh)[0]


def join_episodes(episodes: Sequence[Episodes]) -> Trials:
    """Put the episodes of trials one behind the other.

    Args:
        episodes: the first, second, ... episode of every trial, `[task, episode, time, ...]`. What
            is parallel there, tasks and episodes, are independent trials here.
    """
    parts = [_flatten(one) for one in episodes]
    return jax.tree.map(lambda *arrays: jnp.concatenate(arrays, axis=1), *parts)


def _flatten(episodes: Episodes) -> Trials:
    """[task, episode, time, ...] -> [trial, time, ...]."""
    valid = episodes.valid
    parts = (
        episodes.policy_inputs(),
        jnp.where(valid[..., None], episodes.action, 0.0),
        jnp.where(valid, episodes.reward, 0.0),
        valid,
        episodes.behaviour,
    )
    return Trials(*jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), parts))
