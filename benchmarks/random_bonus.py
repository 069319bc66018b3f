"""The control of curiosity: a bonus that says nothing of what was found out."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.learners.wrappers.curiosity import CuriosityBonus, Scale, Transitions
from maesn.networks import BayesianNetwork


class RandomBonus(CuriosityBonus):
    """Adds random numbers, exponentially distributed, by the same rule as information gains."""

    def information_gains(
        self, key: Key, network: BayesianNetwork, scale: Scale, seen: Transitions
    ) -> Float[Array, " transition"]:
        """Return random numbers; 0 where invalid."""
        return jnp.where(seen.valid, jax.random.exponential(key, seen.valid.shape), 0.0)


def curiosities(weight: float) -> dict[str, CuriosityBonus]:
    """Return VIME's curiosity and its control, by the names of their methods.

    Args:
        weight: bonus of a transition whose gain, or random number, is typical.
    """
    return {
        "random_bonus": RandomBonus(weight=weight, updates=0),
        "vime": CuriosityBonus(weight=weight),
    }
