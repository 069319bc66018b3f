"""Variational inference: what encoder and decoder learn from whole trials.

Zintgraf et al. 2020, section 3.1, equations 6 to 8. For every prefix t of a trial τ of T steps,

    ELBO_t = E_{m ~ q_t}[ Σ_k log p(r_k | o_k, a_k, o_{k+1}, m) ] - w KL(q_t || q_{t-1})

where q_{-1} = N(0, I), and k runs over *all* steps of the trial, those to come included: a belief
is good if it predicts what will be seen. The loss is minus the mean over the prefixes.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Key
from maesn.learners.varibad.decoder import BeliefDecoderSettings, Decoder
from maesn.learners.varibad.encoder import BeliefEncoder
from maesn.learners.varibad.steps import Steps
from maesn.numerics import DiagonalGaussian, Ring, first_order_step, if_finite, masked_mean
from maesn.settings import check_least, check_positive


class InferenceInfo(eqx.Module):
    """Means over prefixes and trials, of the last gradient steps."""

    elbo: Float[Array, ""]
    """ELBO with w = 1, up to the constant of a Gaussian likelihood, in nats."""
    reconstruction: Float[Array, ""]
    """-Σ_k log p of it: what the belief does not predict of a trial."""
    belief_kl: Float[Array, ""]
    """KL(q_t || q_{t-1}), in nats: what a step tells."""
    belief_std: Float[Array, ""]
    """Mean standard deviation of q_t."""


class Draws(NamedTuple):
    """What is drawn for the loss of a trial."""

    noise: Float[Array, "time_plus_1 m"]
    """Standard normal, of m ~ q_t."""
    prefixes: Int[Array, " prefix"]
    """Prefixes t whose m is decoded."""
    decoded: Int[Array, " step"]
    """Steps k that are decoded."""


class BeliefInference(eqx.Module):
    """Settings of the training of encoder and decoder."""

    kl_weight: float = 0.1
    """w. Reference: 0.25 on GridNavi, 1 on AntGoal, 15 on point goals. There the divergence is
    summed over the trials of a batch, so its own weights, 0.01, 0.1 and 1, are times its size."""
    prefixes: int = 50
    """Prefixes of a trial that are decoded from, drawn at random. Reference: all; HyperX on point
    goals: 50."""
    decoded_steps: int = 50
    """Steps of a trial that are decoded from each of them, drawn at random. The same sources."""
    buffer_trials: int = 10_000
    """Trials that are kept to learn from; fewer if they would take more than 150 MB. Reference:
    1e5 on GridNavi, else 1e4."""
    batch_size: int = 25
    """Trials of a gradient step. Reference: 25 on GridNavi, 15 on point goals, 10 on AntGoal."""
    updates: int = 3
    """Gradient steps of a meta-iteration. Reference: 3; 5 on AntGoal."""
    learning_rate: float = 1e-3
    """Learning rate of Adam. Reference: 1e-3."""

    def __check_init__(self) -> None:
        check_least(
            self, prefixes=1, decoded_steps=1, buffer_trials=1, batch_size=1, updates=1, kl_weight=0
        )
        check_positive(self, "learning_rate")

    def init(self, encoder: BeliefEncoder, decoder: Decoder) -> Any:
        """Return the state of Adam before the first step."""
        return optax.adam(self.learning_rate).init((encoder, decoder))

    def loss(
        self,
        encoder: BeliefEncoder,
        decoding: BeliefDecoderSettings,
        decoder: Decoder,
        steps: Steps,
        draws: Draws,
    ) -> tuple[Float[Array, ""], InferenceInfo]:
        """Return minus the mean of ELBO_t over the prefixes of one trial `[time, ...]`."""
        valid, exists = steps.valid, jnp.append(True, steps.valid)
        belief = encoder.posteriors(steps)
        m = belief.sample_from_noise(draws.noise)[draws.prefixes]
        some = jax.tree.map(lambda x: x[draws.decoded], steps)
        surprise = jax.vmap(lambda one: decoding.surprise(decoder, one, some))(m)
        pairs = exists[draws.prefixes][:, None] & some.valid[None]
        # The draws stand for all steps of the trial.
        reconstruction = masked_mean(surprise, pairs) * valid.sum().astype(float)
        kl = masked_mean(belief.kl(previous(belief)), exists)
        std = masked_mean(belief.std().mean(-1), exists)
        info = InferenceInfo(-reconstruction - kl, reconstruction, kl, std)
        return reconstruction + self.kl_weight * kl, info

    def draw(self, key: Key, time: int, latent_size: int) -> Draws:
        """Draw what the loss of a trial of so many steps needs."""
        noise_key, prefix_key, step_key = jax.random.split(key, 3)
        return Draws(
            jax.random.normal(noise_key, (time + 1, latent_size)),
            jax.random.permutation(prefix_key, time + 1)[: self.prefixes],
            jax.random.permutation(step_key, time)[: self.decoded_steps],
        )

    def learn(
        self,
        key: Key,
        encoder: BeliefEncoder,
        decoding: BeliefDecoderSettings,
        decoder: Decoder,
        opt_state: Any,
        buffer: Ring,
    ) -> tuple[BeliefEncoder, Decoder, Any, InferenceInfo, Bool[Array, ""]]:
        """Take the gradient steps of a meta-iteration.

        Returns:
            Encoder, decoder, state of Adam, averages over the steps, and whether all is finite: if
            not, nothing has changed.
        """

        def mean_loss(networks: Any, steps: Steps, draws: Draws) -> Any:
            def one(steps: Steps, draws: Draws) -> Any:
                return self.loss(networks[0], decoding, networks[1], steps, draws)

            losses, infos = jax.vmap(one)(steps, draws)
            return losses.mean(), jax.tree.map(lambda x: x.mean(), infos)

        def update(now: Any, update_key: Key) -> Any:
            networks, opt_state = now
            trial_key, draw_key = jax.random.split(update_key)
            steps = buffer.sample(trial_key, self.batch_size)
            keys = jax.random.split(draw_key, self.batch_size)
            time, size = steps.valid.shape[1], encoder.latent_size
            draws = jax.vmap(lambda one: self.draw(one, time, size))(keys)
            gradient, info = jax.grad(mean_loss, has_aux=True)(networks, steps, draws)
            adam = optax.adam(self.learning_rate)
            return first_order_step(adam, networks, gradient, opt_state), info

        before = ((encoder, decoder), opt_state)
        after, infos = jax.lax.scan(update, before, jax.random.split(key, self.updates))
        ((encoder, decoder), opt_state), accepted = if_finite(after, before)
        return encoder, decoder, opt_state, jax.tree.map(lambda x: x.mean(), infos), accepted


def previous(belief: DiagonalGaussian) -> DiagonalGaussian:
    """Return N(0, I), q_0, ... q_{T-1} of q_0 ... q_T."""

    def shifted(x: Float[Array, "time m"]) -> Float[Array, "time m"]:
        return jnp.concatenate([jnp.zeros_like(x[:1]), x[:-1]])

    return DiagonalGaussian(shifted(belief.mean), shifted(belief.log_std))
