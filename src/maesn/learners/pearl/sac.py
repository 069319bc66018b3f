"""Soft actor-critic with a state value, in the form of PEARL's reference.

Haarnoja et al. 2018, https://arxiv.org/abs/1801.01290. With reward scale c, discount γ, the twin
critics Q_1 and Q_2, the value V and its slow copy V':

    Q_i(o, a, z) -> c r + γ (1 - terminal) V'(o', z)
    V(o, z)      -> min_i Q_i(o, a~, z) - log π(a~ | o, z),    a~ ~ π
    π minimises E[log π(a~ | o, z) - min_i Q_i(o, a~, z)]
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from maesn.axes import Key, ObservedReward
from maesn.learners.pearl.policy import SquashedPolicy
from maesn.learners.pearl.replay import Batch
from maesn.networks import MLP, init_mlp
from maesn.numerics import first_order_step
from maesn.settings import check_least, check_number, check_positive, check_sizes

Encoder = TypeVar("Encoder")

# Factor on the policy's last weights at the start: the mean is then 0 and σ is 1 everywhere.
FIRST_SCALE = 1e-2


class ActorCritic(eqx.Module):
    """The networks of soft actor-critic."""

    policy: SquashedPolicy
    q: tuple[MLP, MLP]
    """Q_1 and Q_2, of observation, action and z side by side."""
    value: MLP
    """V, of observation and z side by side."""
    target: MLP
    """V', which follows V slowly."""


class Optimisers(NamedTuple):
    """States of Adam."""

    critic: Any
    """Of Q_1, Q_2 and the encoder."""
    value: Any
    policy: Any


class SoftLosses(eqx.Module):
    """Losses of one gradient step, or their mean over several."""

    q: Float[Array, ""]
    """Mean squared error of both critics, added up."""
    value: Float[Array, ""]
    """Mean squared error of V."""
    policy: Float[Array, ""]
    """Mean of log π - min Q, and the penalties."""
    entropy: Float[Array, ""]
    """Mean of -log π of the drawn actions, in nats."""


class SoftActorCritic(eqx.Module):
    """Settings of soft actor-critic, and its gradient step."""

    hidden_sizes: tuple[int, ...] = (300, 300, 300)
    """Widths of the hidden layers of policy, critics and value. Reference: three layers of 300."""
    batch_size: int = 256
    """Transitions of each task in a gradient step. Reference: 256."""
    discount: float = 0.99
    """gamma, the weight of a reward one step later. Reference: 0.99; 0.9 on point goals."""
    reward_scale: float = 5.0
    """Factor on rewards; the larger, the less the entropy of actions counts. Reference: 5; 100 on
    point goals."""
    learning_rate: float = 3e-4
    """Learning rate of Adam, for all networks. Reference: 3e-4."""
    target_rate: float = 0.005
    """Share of the way to V that its slow copy goes in each gradient step. Reference: 0.005."""
    output_penalty: float = 1e-3
    """Weight of the mean squares of the policy's μ and log σ in its loss. Reference: 1e-3."""

    def __check_init__(self) -> None:
        check_least(self, batch_size=1, output_penalty=0)
        check_positive(self, "reward_scale", "learning_rate")
        check_sizes(self, "hidden_sizes")
        for name in ("discount", "target_rate"):
            check_number(name, getattr(self, name), 0, 1)

    def init(
        self, key: Key, observation_size: int, action_size: int, z_size: int, shown: ObservedReward
    ) -> ActorCritic:
        """Return freshly initialised networks; V' begins as V.

        Args:
            key: random key.
            observation_size: components of an observation.
            action_size: components of an action.
            z_size: components of z.
            shown: kind of reward that the episodes of the policy record for the context.
        """
        policy_key, first, second, value_key = jax.random.split(key, 4)
        inputs, hidden = observation_size + z_size, self.hidden_sizes
        q_sizes = (inputs + action_size, *hidden, 1)
        value = init_mlp(value_key, (inputs, *hidden, 1))
        mlp = init_mlp(policy_key, (inputs, *hidden, 2 * action_size)).scaled(-1, FIRST_SCALE)
        return ActorCritic(
            SquashedPolicy(mlp, shown),
            (init_mlp(first, q_sizes), init_mlp(second, q_sizes)),
            value,
            value,
        )

    def init_optimisers(self, networks: ActorCritic, encoder: Any) -> Optimisers:
        """Return the states of Adam before the first step."""
        adam = optax.adam(self.learning_rate)
        return Optimisers(
            adam.init((networks.q, encoder)), adam.init(networks.value), adam.init(networks.policy)
        )

    def q_loss(
        self, q: tuple[MLP, MLP], target: MLP, batch: Batch, z: Float[Array, "transition z"]
    ) -> Float[Array, ""]:
        """Return the mean squared errors of both critics, added up.

        Its gradient with respect to z is what an encoder learns from; the target has none.
        """
        following = predict(target, batch.next_observation, z)
        wanted = self.reward_scale * batch.reward
        wanted = wanted + self.discount * (1.0 - batch.terminal) * following
        wanted = jax.lax.stop_gradient(wanted)
        errors = (predict(one, batch.observation, batch.action, z) - wanted for one in q)
        return sum((jnp.mean(error**2) for error in errors), jnp.zeros(()))

    def policy_loss(
        self,
        policy: SquashedPolicy,
        q: tuple[MLP, MLP],
        observation: Float[Array, "transition observation"],
        z: Float[Array, "transition z"],
        noise: Float[Array, "transition action"],
    ) -> tuple[Float[Array, ""], tuple[Float[Array, " transition"], Float[Array, ""]]]:
        """Return the loss of the policy; the soft values min Q - log π, and the entropy."""
        actions = jax.vmap(policy.actions)(observation, z)
        drawn, log_prob = actions.sample_and_log_prob(noise)
        least = jnp.minimum(*(predict(one, observation, drawn, z) for one in q))
        outputs = jnp.mean(actions.mean**2) + jnp.mean(actions.log_std**2)
        loss = jnp.mean(log_prob - least) + self.output_penalty * outputs
        return loss, (least - log_prob, -jnp.mean(log_prob))

    def step(
        self,
        key: Key,
        networks: ActorCritic,
        encoder: Encoder,
        optimisers: Optimisers,
        batch: Batch,
        infer: Callable[[Encoder], tuple[Float[Array, "transition z"], Float[Array, ""]]],
    ) -> tuple[ActorCritic, Encoder, Optimisers, SoftLosses]:
        """Take one gradient step: the critics with the encoder, then value and policy.

        Args:
            key: draws the actions.
            networks: the networks before the step.
            encoder: what z depends on; it learns from the critics alone.
            optimisers: states of Adam.
            batch: transitions `[transition, ...]`.
            infer: encoder -> z of every transition, and a penalty on it.
        """

        def critic_loss(moved: Any) -> Any:
            q, encoder = moved
            z, penalty = infer(encoder)
            loss = self.q_loss(q, networks.target, batch, z)
            return loss + penalty, (loss, z)

        adam = optax.adam(self.learning_rate)
        critics = (networks.q, encoder)
        gradient, (q_loss, z) = jax.grad(critic_loss, has_aux=True)(critics)
        (q, encoder), critic_state = first_order_step(adam, critics, gradient, optimisers.critic)

        noise = jax.random.normal(key, batch.action.shape)
        slope = jax.value_and_grad(self.policy_loss, has_aux=True)
        (policy_loss, (soft, entropy)), gradient = slope(
            networks.policy, q, batch.observation, z, noise
        )
        policy, policy_state = first_order_step(adam, networks.policy, gradient, optimisers.policy)

        def value_error(value: MLP) -> Float[Array, ""]:
            return jnp.mean((predict(value, batch.observation, z) - soft) ** 2)

        value_loss, gradient = jax.value_and_grad(value_error)(networks.value)
        value, value_state = first_order_step(adam, networks.value, gradient, optimisers.value)
        target = jax.tree.map(
            lambda slow, fast: slow + self.target_rate * (fast - slow), networks.target, value
        )
        states = Optimisers(critic_state, value_state, policy_state)
        losses = SoftLosses(q_loss, value_loss, policy_loss, entropy)
        return ActorCritic(policy, q, value, target), encoder, states, losses


def predict(network: MLP, *inputs: Float[Array, "transition _"]) -> Float[Array, " transition"]:
    """Return the number that a network gives for each row of its inputs, side by side."""
    return jax.vmap(network)(jnp.concatenate(inputs, axis=-1))[:, 0]
