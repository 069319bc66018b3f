"""What changes while PEARL trains, and what a meta-iteration tells of it."""

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.learners.pearl.encoder import ContextEncoder
from maesn.learners.pearl.replay import Replay
from maesn.learners.pearl.sac import ActorCritic, Optimisers, SoftLosses


class Networks(eqx.Module):
    """What is trained by gradients, and the scale of z that results."""

    encoder: ContextEncoder
    actor_critic: ActorCritic
    latent_scale: Float[Array, ""]
    """Root mean square of the components of z in the last gradient steps."""

    def agents(self, belief: Latent) -> Agents:
        """Return agents with noise in their actions, which draw z from a belief on each task."""
        return Agents(self.actor_critic.policy, belief, shares_policy=True)


class PearlState(eqx.Module):
    """State of a `PearlMetaLearner`."""

    networks: Networks
    optimisers: Optimisers
    replay: Replay
    iteration: Int[Array, ""]


class PearlInfo(eqx.Module):
    """Info of one meta-iteration: scalars only."""

    return_before: Float[Array, ""]
    """Mean undiscounted return of the episodes with z from the prior."""
    return_after: Float[Array, ""]
    """Mean undiscounted return of the last episodes, with z from the posterior if any are."""
    success_after: Float[Array, ""]
    """Share of the last episodes that reach the goal region."""
    kl: Float[Array, ""]
    """Mean divergence of the posterior of a task from the prior, in nats."""
    latent_std: Float[Array, ""]
    """Mean standard deviation of the posteriors."""
    losses: SoftLosses
    """Means over the gradient steps."""
    accepted: Bool[Array, ""]
    """False if the gradient steps led to numbers that are not finite: all networks stay."""
