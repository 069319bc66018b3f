"""What every policy sees and returns."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import ActionKind, Carry, Key, ObservedReward
from maesn.numerics import AbstractDistribution


class PolicyInput(NamedTuple):
    """What a policy may base its action on, at one step or at many.

    Feed-forward policies read the observation alone. The rest is what a policy with memory needs
    to learn from its own experience (RL2), and it costs nothing where it is not read. At the start
    of an episode, action and reward are those of the episode before in the same trial; 0 in the
    first one.
    """

    observation: Float[Array, "*steps observation"]
    previous_action: Float[Array, "*steps action"]
    previous_reward: Float[Array, "*steps"]
    episode_start: Bool[Array, "*steps"]


class AbstractPolicy(eqx.Module):
    """A policy pi(a | input, context): arrays only."""

    @abstractmethod
    def __call__(
        self, policy_input: PolicyInput, context: Float[Array, " context"], carry: Carry
    ) -> tuple[AbstractDistribution, Carry]:
        """Return the distribution of the action at one step, and the new memory."""

    @abstractmethod
    def initial_recurrent_state(self) -> Carry:
        """Return the memory at the start of a trial; `None` for a policy without one."""

    @property
    def action_kind(self) -> ActionKind:
        """Whether actions are vectors of real numbers, or choices (one-hot vectors).

        This decides the distribution that a policy returns: `DiagonalGaussian`, or `Categorical`.
        """
        return "continuous"

    @property
    def observed_reward(self) -> ObservedReward:
        """Which reward the policy is shown as the previous one."""
        return "paid"

    def unroll(
        self,
        inputs: PolicyInput,
        valid: Bool[Array, "episode time"],
        context: Float[Array, "episode context"],
        carry: Carry,
    ) -> tuple[AbstractDistribution, Carry]:
        """Return the distributions along episodes, `[episode time]`, and the memory after each.

        The same as calling the policy step by step. A policy without memory needs no more than
        this; one with memory overrides it.

        Args:
            inputs: of every step, with leading axes `episode time`. Must be finite where invalid,
                too.
            valid: where it is false, the memory is kept as it is.
            context: what the policy is fed throughout each episode.
            carry: memory before the first step of each episode.
        """
        # All steps along one axis: XLA would copy activations before it sums a weight's gradient
        # over two, and take half as long again for that product.
        steps = jax.tree.map(lambda x: x.reshape(valid.size, *x.shape[2:]), inputs)
        fed = jnp.repeat(context, valid.shape[1], axis=0)
        asked = jax.vmap(lambda policy_input, z: self(policy_input, z, None)[0])(steps, fed)
        return jax.tree.map(lambda x: x.reshape(*valid.shape, *x.shape[1:]), asked), carry


class AbstractPolicySettings(eqx.Module):
    """Settings of a policy: builds its weights for an environment's sizes."""

    @property
    def is_recurrent(self) -> bool:
        """Whether the policy remembers earlier steps."""
        return False

    def for_actions(self, kind: ActionKind) -> "AbstractPolicySettings":
        """Return the settings of such a policy for actions of a kind.

        Only what was not said otherwise is changed. A policy of choices stays one, and so does one
        with a standard deviation of its own, which choices do not have: whoever plays them where
        that does not fit refuses them by name.

        Args:
            kind: of the actions that are needed.
        """
        return self

    @abstractmethod
    def init(
        self, key: Key, observation_size: int, action_size: int, context_size: int
    ) -> AbstractPolicy:
        """Return freshly initialised weights."""
