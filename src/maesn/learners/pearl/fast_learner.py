"""The fast learner of PEARL: posterior sampling, with a product of Gaussians as its memory."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from maesn.axes import TaskKeys
from maesn.context import Latent, held_at
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.fast import (
    AbstractFastLearner,
    AbstractSettableLatent,
    Capabilities,
    Purpose,
)
from maesn.learners.pearl.encoder import ContextEncoder, Factors
from maesn.learners.pearl.policy import SquashedPolicy
from maesn.learners.pearl.replay import transitions_of


class PearlFastState(eqx.Module):
    """State of a `PearlFastLearner`."""

    factors: Factors
    """The product of the factors of all transitions so far, `[task z]`."""
    episodes: Int[Array, ""]
    """Episodes of each task so far."""


class PearlFastLearner(AbstractFastLearner[PearlFastState], AbstractSettableLatent):
    """Draws z from its belief, acts on it for an episode, and multiplies in what it has seen."""

    policy: SquashedPolicy
    encoder: ContextEncoder
    latent_scale: Float[Array | np.ndarray, ""]
    """Root mean square of the components of z in training."""
    prior_episodes: int = 1
    """Episodes of a task whose z is drawn from the prior."""
    next_observation: bool = False
    """Whether the next observation is part of the context."""
    noisy_exploration: bool = False
    """Whether actions have the noise of training, to explore."""

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(learns_from_reward=False)

    def init(self, keys: TaskKeys) -> PearlFastState:
        """Nothing is random."""
        return PearlFastState(self.encoder.none(keys.shape[0]), jnp.asarray(0))

    def agents(self, state: PearlFastState, purpose: Purpose = "explore") -> Agents:
        """Return agents that draw one z per episode to explore.

        To be judged, they act on the posterior mean, without noise.
        """
        posterior = state.factors.posterior()
        if purpose == "deploy":
            return self.holding(posterior.mean)
        zeros = jnp.zeros_like(posterior.mean)
        begins = state.episodes < self.prior_episodes
        context = jax.tree.map(
            lambda x, y: jnp.where(begins, x, y), Latent(zeros, zeros), posterior
        )
        return Agents(self.policy, context, shares_policy=True, is_noisy=self.noisy_exploration)

    @eqx.filter_jit
    def update(self, state: PearlFastState, episodes: Episodes) -> PearlFastState:
        """Multiply in the factors of the episodes' transitions."""
        batch, valid = transitions_of(episodes)
        found = jax.vmap(self.encoder)(batch.context(self.next_observation), valid)
        played = episodes.valid.shape[1]
        return PearlFastState(state.factors.times(found), state.episodes + played)

    @property
    def latent(self) -> "PearlFastLearner":
        return self

    @property
    def size(self) -> int:
        return self.encoder.size

    @property
    def spread(self) -> float:
        """The root mean square of the latents of training, at least that of the prior."""
        return max(float(self.latent_scale), 1.0)

    def holding(self, latents: Float[ArrayLike, "task *episode z"]) -> Agents:
        """Return agents that act on given latents, without noise."""
        return Agents(self.policy, held_at(latents), shares_policy=True, is_noisy=False)

    def of_tasks(
        self, collect: Collect, keys: TaskKeys, task_index: Int[Array, " task"]
    ) -> Float[np.ndarray, "task z"]:
        """Return the posterior means after one batch of episodes on latents from the prior."""
        state = self.init(keys)
        # Without noise, as a search plays.
        agents = replace(self.agents(state), is_noisy=False)
        state = self.update(state, collect(keys, agents, task_index))
        return np.asarray(state.factors.posterior().mean, np.float64)
