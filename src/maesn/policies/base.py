"""The interface of policies and of their inputs."""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import ActionKind, Key, ObservedReward, RecurrentState
from maesn.numerics import AbstractDistribution, Categorical, DiagonalGaussian


class PolicyInput(NamedTuple):
    """Inputs of a policy, at one step or at many.

    Feed-forward policies read the observation alone. A recurrent policy needs the rest to learn
    from its own experience (RL2). At the start of an episode, action and reward are the last ones
    of the episode before in the same trial, and 0 in the first episode of a trial.
    """

    observation: Float[Array, "*steps observation"]
    previous_action: Float[Array, "*steps action"]
    previous_reward: Float[Array, "*steps"]
    episode_start: Bool[Array, "*steps"]


class AbstractPolicy(eqx.Module):
    """A policy pi(a | input, z): arrays only."""

    @abstractmethod
    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[AbstractDistribution, RecurrentState]:
        """Return the distribution of the action at one step, and the next recurrent state."""

    def initial_recurrent_state(self) -> RecurrentState:
        """Return the state at the start of a trial; `None`, the default, if it is not recurrent."""
        return None

    @property
    def action_kind(self) -> ActionKind:
        """Whether actions are vectors of real numbers, or choices (one-hot vectors).

        It follows from `distribution`: to choose, return a `Categorical` there. The collector
        refuses a policy of another kind than that of its environment.
        """
        return "discrete" if issubclass(self.distribution, Categorical) else "continuous"

    @property
    def distribution(self) -> type[AbstractDistribution]:
        """The type of distribution that the policy returns: Gaussians, by default.

        It is known before the policy is called, because the noise of all actions is drawn first.
        """
        return DiagonalGaussian

    @property
    def observed_reward(self) -> ObservedReward:
        """The kind of reward that the policy receives as the previous one."""
        return "own"

    def seen(self, inputs: PolicyInput) -> PolicyInput:
        """Return inputs in the units in which a network reads them: as they are, by default.

        A value function beside a recurrent policy reads the same.
        """
        return inputs

    def after_episode(
        self, policy_input: PolicyInput, recurrent_state: RecurrentState
    ) -> RecurrentState:
        """Return the state that the next episode of the trial starts from: the same, by default.

        A policy that infers its task learns here what its last action led to: the input has the
        observation after the last step, not finite where physics blew up, its action and reward.
        """
        return recurrent_state

    def unroll(
        self,
        inputs: PolicyInput,
        valid: Bool[Array, "episode time"],
        z: Float[Array, "episode z"],
        recurrent_state: RecurrentState,
    ) -> tuple[AbstractDistribution, RecurrentState]:
        """Return the distributions along episodes, `[episode time]`, and the states after them.

        The same as calling the policy step by step, with z constant during an episode. Recurrent
        policies override it. Inputs must be finite, invalid steps included, which leave the
        recurrent state as it is.
        """
        # All steps along one axis. With two, XLA would copy activations before it sums a weight's
        # gradient over them, and take half as long again for that product.
        steps = jax.tree.map(lambda x: x.reshape(valid.size, *x.shape[2:]), inputs)
        fed = jnp.repeat(z, valid.shape[1], axis=0)
        flat = jax.vmap(lambda step, z: self(step, z, None)[0])(steps, fed)
        along = jax.tree.map(lambda x: x.reshape(*valid.shape, *x.shape[1:]), flat)
        return along, recurrent_state


class AbstractPolicySettings(eqx.Module):
    """Settings of a policy: builds its weights for an environment's sizes."""

    is_recurrent: ClassVar[bool] = False
    """Whether an action depends on earlier steps as well, through a recurrent state."""

    def for_actions(self, kind: ActionKind) -> "AbstractPolicySettings":
        """Return the settings of such a policy for actions of a kind.

        Explicit settings stay: a policy of choices, or an `initial_std` of the caller's own, which
        choices do not have. The collector refuses a policy that does not fit its environment.
        """
        return self

    @abstractmethod
    def init(
        self, key: Key, observation_size: int, action_size: int, z_size: int
    ) -> AbstractPolicy:
        """Return freshly initialised weights."""

    def after_iteration(self, policy: Any, iteration: Int[Array, ""]) -> Any:
        """Return what becomes of an improved policy after that many meta-iterations."""
        return policy
