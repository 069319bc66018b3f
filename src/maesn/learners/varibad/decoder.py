"""The decoder: what rewards, and what transitions, a latent m predicts."""

import math
from typing import Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.learners.varibad.steps import Steps
from maesn.networks import MLP, init_mlp
from maesn.settings import check_choice, check_positive, check_sizes

# gaussian: the reward itself. bernoulli: whether it is positive.
Likelihood: TypeAlias = Literal["gaussian", "bernoulli"]


class Decoder(eqx.Module):
    """The networks of the decoder."""

    reward: MLP
    transition: MLP | None
    """None if transitions are not decoded."""


class BeliefDecoderSettings(eqx.Module):
    """Settings of a `Decoder`, and what it predicts.

    A surprise is -log p up to the constant of a Gaussian, so it is never negative.
    """

    hidden_sizes: tuple[int, ...] = (32, 32)
    """Widths of the hidden layers. Reference: two layers of 32 on GridNavi; 64 and 32 elsewhere."""
    likelihood: Likelihood = "gaussian"
    """What is predicted of a reward: its value, or whether it is positive. Reference: its value;
    on GridNavi, whether the goal is there."""
    cells: tuple[int, ...] = ()
    """Where observations are cells of a grid, the numbers of cells a side: the decoder then has one
    output for the reward of each cell, and sees m alone. Reference on GridNavi: 5 x 5. Empty: it
    sees m, the observation, the action, and the next observation."""
    reward_std: float = 0.7
    """Standard deviation of a Gaussian reward, in its unit. sqrt(1/2) makes the squared error of
    the reference."""
    transitions: bool = False
    """Whether the next observation is decoded as well, for tasks that differ in dynamics."""
    transition_std: float = 0.7
    """Standard deviation of every component of it."""

    def __check_init__(self) -> None:
        check_choice("likelihood", self.likelihood, Likelihood)
        check_positive(self, "reward_std", "transition_std")
        check_sizes(self, "hidden_sizes", "cells")

    def init(self, key: Key, latent_size: int, observation_size: int, action_size: int) -> Decoder:
        """Return freshly initialised weights.

        Raises:
            ValueError: observations have another number of components than `cells`.
        """
        if self.cells and len(self.cells) != observation_size:
            raise ValueError(
                f"`decoder.cells` is {self.cells}, which needs observations of {len(self.cells)} "
                f"components, but they have {observation_size}."
            )
        reward_key, transition_key = jax.random.split(key)
        seen = latent_size + observation_size + action_size
        inputs = latent_size if self.cells else seen + observation_size
        outputs = math.prod(self.cells)  # 1 for no cells
        transition = (
            init_mlp(transition_key, (seen, *self.hidden_sizes, observation_size))
            if self.transitions
            else None
        )
        return Decoder(init_mlp(reward_key, (inputs, *self.hidden_sizes, outputs)), transition)

    def rewards(
        self, decoder: Decoder, m: Float[Array, " m"], steps: Steps
    ) -> Float[Array, " step"]:
        """Return the predicted rewards of steps `[step, ...]`: means, or logits."""
        if self.cells:
            cell = tuple(jnp.round(steps.next_observation).astype(int).T)
            return decoder.reward(m)[jnp.ravel_multi_index(cell, self.cells, mode="clip")]
        return _predict(decoder.reward, m, steps.observation, steps.action, steps.next_observation)[
            :, 0
        ]

    def expected(
        self,
        decoder: Decoder,
        places: Float[Array, "place observation"],
        action_size: int,
        m: Float[Array, " m"],
    ) -> Float[Array, " place"]:
        """Return the rewards of staying at places, or the chances that they are positive."""
        number = len(places)
        nothing = jnp.zeros((number, action_size))
        stays = Steps(places, nothing, jnp.zeros(number), places, jnp.ones(number, bool))
        predicted = self.rewards(decoder, m, stays)
        return jax.nn.sigmoid(predicted) if self.likelihood == "bernoulli" else predicted

    def surprise(
        self, decoder: Decoder, m: Float[Array, " m"], steps: Steps
    ) -> Float[Array, " step"]:
        """Return -log p(r, o' | o, a, m) of steps `[step, ...]`, in nats."""
        predicted = self.rewards(decoder, m, steps)
        if self.likelihood == "bernoulli":
            is_positive = (steps.reward > 0).astype(float)
            surprise = optax.sigmoid_binary_cross_entropy(predicted, is_positive)
        else:
            surprise = 0.5 * ((predicted - steps.reward) / self.reward_std) ** 2
        if decoder.transition is None:
            return surprise
        expected = _predict(decoder.transition, m, steps.observation, steps.action)
        error = (expected - steps.next_observation) / self.transition_std
        return surprise + 0.5 * jnp.sum(error**2, axis=-1)


def _predict(
    network: MLP, m: Float[Array, " m"], *seen: Float[Array, "step _"]
) -> Float[Array, "step outputs"]:
    def one(*parts: Float[Array, " _"]) -> Float[Array, " outputs"]:
        return network(jnp.concatenate([m, *parts]))

    return jax.vmap(one)(*seen)
