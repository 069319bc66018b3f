"""What every policy sees and returns."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
from jaxtyping import Array, Bool, Float

from maesn.axes import Carry, Key
from maesn.numerics import AbstractDistribution


class PolicyInput(NamedTuple):
    """What a policy may base its action on at time t of one episode.

    Feed-forward policies read the observation alone. The rest is what a policy with memory needs
    to learn from its own experience (RL2), and it costs nothing where it is not read.
    """

    observation: Float[Array, " observation"]
    previous_action: Float[Array, " action"]
    previous_reward: Float[Array, ""]
    episode_start: Bool[Array, ""]


class AbstractPolicy(eqx.Module):
    """A policy pi(a | input, context): arrays only."""

    @abstractmethod
    def __call__(
        self, policy_input: PolicyInput, context: Float[Array, " context"], carry: Carry
    ) -> tuple[AbstractDistribution, Carry]:
        """Return the distribution of the action at one step, and the new memory."""

    @abstractmethod
    def initial_carry(self) -> Carry:
        """Return the memory at the start of a trial; `None` for a policy without one."""


class AbstractPolicySettings(eqx.Module):
    """Settings of a policy: builds its weights for an environment's sizes."""

    @abstractmethod
    def init(
        self, key: Key, observation_size: int, action_size: int, context_size: int
    ) -> AbstractPolicy:
        """Return freshly initialised weights."""
