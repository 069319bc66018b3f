"""Recurrent policies: RL2 (Duan et al. 2016, section 2.2)."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import ActionKind, Key, ObservedReward, RecurrentState
from maesn.networks import RecurrentNetwork, init_recurrent_network
from maesn.numerics import AbstractDistribution, Categorical, DiagonalGaussian
from maesn.policies.base import AbstractPolicy, AbstractPolicySettings, PolicyInput
from maesn.policies.feed_forward import gaussian, initial_log_std
from maesn.settings import check_choice, check_number, check_positive, check_sizes

# A policy that amplifies its action before would play ever larger ones. Actions begin with a
# standard deviation of 1.
LARGEST_ACTION = 100.0


class Head(eqx.Module):
    """Turns one output for each component of an action into a distribution.

    N(outputs, diag(exp(log_std)^2)), or one choice, with the outputs as logits.
    """

    log_std: Float[Array, "*batch action"] | None
    """State-independent; None for choices."""

    def __call__(self, outputs: Float[Array, " action"]) -> AbstractDistribution:
        if self.log_std is None:
            return Categorical(outputs)
        return gaussian(outputs, self.log_std)


class RecurrentPolicy(AbstractPolicy):
    """pi(a_t | x_0 ... x_t, z) with x_t = (o_t, a_{t-1}, r_{t-1}, start_t).

    The recurrent state summarises observations, actions and rewards since the trial began. The
    outputs of the network are the means of a Gaussian or the logits of a choice.
    """

    network: RecurrentNetwork
    head: Head
    observed_reward: ObservedReward = eqx.field(static=True, default="own")
    symlog: bool = eqx.field(static=True, default=False)

    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[AbstractDistribution, RecurrentState]:
        features = input_features(self.seen(policy_input), z)
        outputs, after = self.network(features, recurrent_state)
        return self.head(outputs), after

    def initial_recurrent_state(self) -> Float[Array, " hidden"]:
        return self.network.initial_recurrent_state()

    @property
    def distribution(self) -> type[AbstractDistribution]:
        return DiagonalGaussian if self.head.log_std is not None else Categorical

    def seen(self, inputs: PolicyInput) -> PolicyInput:
        if not self.symlog:
            return inputs
        numbers = inputs.observation, inputs.previous_action, inputs.previous_reward
        o, a, r = (jnp.sign(x) * jnp.log1p(jnp.abs(x)) for x in numbers)
        return PolicyInput(o, a, r, inputs.episode_start)

    def unroll(
        self,
        inputs: PolicyInput,
        valid: Bool[Array, "episode time"],
        z: Float[Array, "episode z"],
        recurrent_state: RecurrentState,
    ) -> tuple[AbstractDistribution, RecurrentState]:
        along_time = jax.vmap(input_features, in_axes=(0, None))
        features = jax.vmap(along_time)(self.seen(inputs), z)
        outputs, after = jax.vmap(self.network.unroll)(features, valid, recurrent_state)
        return jax.vmap(jax.vmap(self.head))(outputs), after


class Recurrent(AbstractPolicySettings):
    """Settings of `RecurrentPolicy`."""

    is_recurrent: ClassVar[bool] = True
    hyper: ClassVar[bool] = False
    """Whether the recurrent state makes the weights of the readout."""

    action_kind: ActionKind = "continuous"
    """Real numbers, or choices."""
    encoder_sizes: tuple[int, ...] = ()
    """Widths of rectified linear layers before the recurrent layer."""
    hidden_size: int = 64
    """Components of the recurrent state. garage's RL2: 64."""
    readout_sizes: tuple[int, ...] = ()
    """Widths of the hidden layers behind the recurrent layer. RL2 paper: none."""
    initial_std: float = 1.0
    """Standard deviation of continuous actions at the start."""
    observed_reward: ObservedReward = "own"
    """Which reward the policy receives: `own` for the reward of the world that it plays in, as in
    the paper (dense in training, sparse in new tasks), or `sparse` for the sparse one in both."""

    def __check_init__(self) -> None:
        check_sizes(self, "encoder_sizes", "readout_sizes")
        check_number("hidden_size", self.hidden_size, 1)
        check_positive(self, "initial_std")
        check_choice("action_kind", self.action_kind, ActionKind)
        check_choice("observed_reward", self.observed_reward, ObservedReward)

    @property
    def symlog(self) -> bool:
        """Whether the network reads `sign(x) log(1 + |x|)` of its inputs."""
        return False

    def for_actions(self, kind: ActionKind) -> "Recurrent":
        if kind == "continuous" or self.initial_std != Recurrent.initial_std:
            return self
        return replace(self, action_kind=kind)

    def init(
        self, key: Key, observation_size: int, action_size: int, z_size: int
    ) -> RecurrentPolicy:
        network = init_recurrent_network(
            key,
            input_size(observation_size, action_size, z_size),
            action_size,
            encoder_sizes=self.encoder_sizes,
            hidden_size=self.hidden_size,
            readout_sizes=self.readout_sizes,
            hyper=self.hyper,
        )
        is_discrete = self.action_kind == "discrete"
        log_std = None if is_discrete else initial_log_std(action_size, self.initial_std)
        return RecurrentPolicy(network, Head(log_std), self.observed_reward, self.symlog)


class HyperRecurrent(Recurrent):
    """Settings of a `RecurrentPolicy` whose recurrent state makes the weights of its readout.

        π(a_t | x_0 ... x_t) from y_t = mlp_w(e_t),   w = w_0 + W h_t,   W = 0 at the start

    Source: Beck et al. 2023, "Recurrent Hypernetworks are Surprisingly Strong in Meta-RL",
    https://arxiv.org/abs/2309.14970. `readout_sizes` are the widths of mlp_w, whose input does not
    hold h_t. `maesn.networks.HyperMLP` has the start.
    """

    hyper: ClassVar[bool] = True

    readout_sizes: tuple[int, ...] = (32,)
    """Widths of the hidden layers that are made. Their GridNavi: one layer of 32."""

    symlog: bool = False
    """Whether the network reads `sign(x) log(1 + |x|)` of observation, action and reward (Hafner et
    al. 2023, "Mastering diverse domains through world models", equation 9). Gates of a recurrent
    layer do not react where inputs are large, such as the speeds of wheels."""


def input_size(observation_size: int, action_size: int, z_size: int = 0) -> int:
    """Return the number of components of `input_features`."""
    return observation_size + action_size + 2 + z_size


def input_features(policy_input: PolicyInput, z: Float[Array, " z"]) -> Float[Array, " inputs"]:
    """Return [o_t, a_{t-1}, r_{t-1}, start_t, z] of one step; a within +-`LARGEST_ACTION`."""
    action = jnp.clip(policy_input.previous_action, -LARGEST_ACTION, LARGEST_ACTION)
    scalars = [policy_input.previous_reward, policy_input.episode_start.astype(z.dtype)]
    return jnp.concatenate([policy_input.observation, action, jnp.stack(scalars), z])
