"""MAESN with a latent of your own: its prior is learned, instead of N(0, I).

    export PYTHONPATH=examples
    maesn train own_latent:maesn_learned_prior --family point --run runs/prior --iterations 60
    maesn adapt runs/prior --method own_latent:maesn_learned_prior --reward dense

Training learns a Gaussian latent for each task and, beside them, the prior that a new task starts
from. The penalty is the divergence of the latents from it, so each follows the other.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import maesn


class LatentsAndPrior(maesn.AbstractContext):
    """What training learns: a latent for each task, and the prior."""

    tasks: maesn.Latent
    prior: maesn.Latent

    @property
    def size(self) -> int:
        return self.prior.size

    def draw(self, noise: Array, description: Array) -> Float[Array, " z"]:
        return self.prior.draw(noise, description)


class LearnedPriorContext(maesn.AbstractContextSettings[maesn.AbstractContext]):
    """A Gaussian latent per training task, and a Gaussian prior that is learned with them."""

    size: int = 2
    """Components of z."""
    kl_weight: float = 0.1
    """Weight of the divergence from the prior."""

    def init(self, key: Array, num_tasks: int, description_size: int = 0) -> LatentsAndPrior:
        means = jax.random.normal(key, (num_tasks, self.size))
        zeros = jnp.zeros(self.size)
        return LatentsAndPrior(
            maesn.Latent(means, jnp.zeros_like(means)), maesn.Latent(zeros, zeros)
        )

    def start(self, table: LatentsAndPrior, task_index: Array) -> maesn.Latent:
        return maesn.Latent(table.tasks.mean[task_index], table.tasks.log_std[task_index])

    def start_new(self, table: LatentsAndPrior, num_tasks: int) -> maesn.Latent:
        prior = table.prior
        return maesn.Latent(
            *(jnp.tile(part, (num_tasks, 1)) for part in (prior.mean, prior.log_std))
        )

    def draw_loss(
        self, value: maesn.Latent, drawn: Array, episode_advantage: Array
    ) -> Float[Array, ""]:
        """Return the likelihood ratio's loss: z is the zeroth action of its episode."""
        return -jnp.mean(value.distribution.log_prob(drawn) * episode_advantage)

    def penalty(
        self, table: LatentsAndPrior, value: maesn.Latent, noise: Array
    ) -> Float[Array, ""]:
        return self.kl_weight * value.distribution.kl(table.prior.distribution)


maesn_learned_prior = maesn.maesn(context=LearnedPriorContext())
