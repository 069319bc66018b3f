"""The policy of VariBAD: acts on an observation and on the belief about the task."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ObservedReward, RecurrentState
from maesn.learners.varibad.encoder import BeliefEncoder
from maesn.numerics import AbstractDistribution, DiagonalGaussian
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy, PolicyInput


class BeliefState(NamedTuple):
    """Recurrent state of a `BeliefPolicy`."""

    hidden: Float[Array, "*batch hidden"]
    """h of the encoder."""
    policy: RecurrentState
    """State of the policy that acts on the belief; None if it is not recurrent."""


class BeliefPolicy(AbstractPolicy):
    """pi(a_t | o_t, μ_t, log σ_t), with the mean and spread of the posterior q_t.

    The first observation of an episode changes no belief; the last one does, when the episode is
    over.
    """

    encoder: BeliefEncoder
    policy: AbstractPolicy
    """Acts on [o, μ, log σ], normalised, in place of an observation."""
    statistics: ObservationStatistics
    """Of [o, μ, log σ] in training."""
    observed_reward: ObservedReward = eqx.field(static=True, default="own")

    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[AbstractDistribution, RecurrentState]:
        before, inner = recurrent_state
        after = self._advance(policy_input, before)
        hidden = jnp.where(policy_input.episode_start, before, after)
        seen = self.hyper_state(policy_input.observation, self.encoder.posterior(hidden))
        actions, inner = self.policy(policy_input._replace(observation=seen), z, inner)
        return actions, BeliefState(hidden, inner)

    def hyper_state(
        self, observation: Float[Array, "*batch observation"], belief: DiagonalGaussian
    ) -> Float[Array, "*batch seen"]:
        """Return [o, μ, log σ], normalised: what the policy acts on."""
        return self.statistics.normalized(side_by_side(observation, belief))

    def initial_recurrent_state(self) -> BeliefState:
        return BeliefState(self.encoder.initial(), self.policy.initial_recurrent_state())

    def after_episode(
        self, policy_input: PolicyInput, recurrent_state: RecurrentState
    ) -> RecurrentState:
        before, inner = recurrent_state
        is_finite = jnp.isfinite(policy_input.observation).all()
        finite = policy_input._replace(
            observation=jnp.where(is_finite, policy_input.observation, 0.0)
        )
        return BeliefState(jnp.where(is_finite, self._advance(finite, before), before), inner)

    def _advance(
        self, policy_input: PolicyInput, hidden: Float[Array, " hidden"]
    ) -> Float[Array, " hidden"]:
        return self.encoder.advance(
            hidden,
            policy_input.previous_action,
            policy_input.previous_reward,
            policy_input.observation,
        )

    @property
    def distribution(self) -> type[AbstractDistribution]:
        return self.policy.distribution


def side_by_side(
    observation: Float[Array, "*batch observation"], belief: DiagonalGaussian
) -> Float[Array, "*batch seen"]:
    """Return [o, μ, log σ]: the hyper-state of an agent that does not know its task."""
    return jnp.concatenate([observation, belief.mean, belief.log_std], axis=-1)
