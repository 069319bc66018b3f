"""The encoder: a posterior over the latent m of a task after every step of a trial.

Zintgraf et al. 2020, https://arxiv.org/abs/1910.08348, section 3:

    q_t = q(m | h_t) = N(μ(h_t), σ²(h_t)),   h_{t+1} = GRU(embed(a_t, r_t, o_{t+1}), h_t),   h_0 = 0

q_0, before any step, is learned as well. The belief is kept across the episodes of a trial.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.learners.varibad.steps import Steps
from maesn.networks import GRU, MLP, Linear, init_gru, init_mlp
from maesn.numerics import DiagonalGaussian
from maesn.settings import check_least, check_sizes


class BeliefEncoder(eqx.Module):
    """The networks of the posterior."""

    embedding: tuple[Linear, ...]
    """Rectified linear layers before the recurrent layer."""
    gru: GRU
    head: MLP
    """h -> μ and log σ, side by side."""

    @property
    def latent_size(self) -> int:
        """Number of components of m."""
        return self.head.layers[-1].bias.shape[-1] // 2

    def initial(self) -> Float[Array, " hidden"]:
        """Return h_0 = 0."""
        return jnp.zeros(self.gru.hidden_size)

    def advance(
        self,
        hidden: Float[Array, " hidden"],
        action: Float[Array, " action"],
        reward: Float[Array, ""],
        next_observation: Float[Array, " observation"],
    ) -> Float[Array, " hidden"]:
        """Return h after one more step."""
        return self.gru(self._embedded(action, reward, next_observation), hidden)

    def posterior(self, hidden: Float[Array, " hidden"]) -> DiagonalGaussian:
        """Return q(m | h)."""
        mean, log_std = jnp.split(self.head(hidden), 2)
        return DiagonalGaussian(mean, log_std)

    def posteriors(self, steps: Steps) -> DiagonalGaussian:
        """Return q_0 ... q_T of one trial `[time, ...]`, one more than there are steps.

        A step that is not valid does not change the belief.
        """
        x = jax.vmap(self._embedded)(steps.action, steps.reward, steps.next_observation)
        states, _ = self.gru.unroll(x, steps.valid, self.initial())
        return jax.vmap(self.posterior)(jnp.concatenate([self.initial()[None], states]))

    def _embedded(
        self, action: Array, reward: Array, next_observation: Array
    ) -> Float[Array, " embedded"]:
        x = jnp.concatenate([action, reward[None], next_observation])
        for layer in self.embedding:
            x = jax.nn.relu(layer(x))
        return x


class BeliefEncoderSettings(eqx.Module):
    """Settings of a `BeliefEncoder`."""

    latent_size: int = 5
    """Components of m. Reference: 5; 10 on AntGoal."""
    encoder_sizes: tuple[int, ...] = (32,)
    """Widths of the layers before the recurrent layer. (Reference: one layer each for action,
    observation and reward, of 16 components together on GridNavi, 64 on point goals.)"""
    hidden_size: int = 64
    """Components of h. Reference: 64 on GridNavi; 128 elsewhere."""
    readout_sizes: tuple[int, ...] = ()
    """Widths of the hidden layers between h and the posterior. Reference: none."""

    def __check_init__(self) -> None:
        check_least(self, hidden_size=1, latent_size=1)
        check_sizes(self, "encoder_sizes", "readout_sizes")

    def init(self, key: Key, observation_size: int, action_size: int) -> BeliefEncoder:
        """Return freshly initialised weights."""
        embedding_key, gru_key, head_key = jax.random.split(key, 3)
        sizes = (action_size + 1 + observation_size, *self.encoder_sizes)
        embedding = init_mlp(embedding_key, sizes).layers if self.encoder_sizes else ()
        head = init_mlp(head_key, (self.hidden_size, *self.readout_sizes, 2 * self.latent_size))
        return BeliefEncoder(embedding, init_gru(gru_key, sizes[-1], self.hidden_size), head)
