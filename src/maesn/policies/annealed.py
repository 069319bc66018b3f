"""A Gaussian policy whose noise falls during meta-training."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import ActionKind, Key
from maesn.policies.base import AbstractPolicySettings
from maesn.policies.feed_forward import GaussianMLP, GaussianMLPPolicy


class AnnealedGaussianMLP(AbstractPolicySettings):
    """A `GaussianMLP` whose standard deviation has an upper bound that falls.

        bound(i) = final_std ^ ((i - first) / (last - first)),   first <= i <= last

    There is no bound before, and it stays at `final_std` afterwards. Noise costs return in a new
    task, where the latent explores, and a trust region lowers it slowly: the reference's settings
    leave 0.9 of 1 on `ant` after 300 meta-iterations. But it helps to learn, so the bound should
    fall late. The paper has none.
    """

    network: GaussianMLP = GaussianMLP()
    """The policy, but for the bound."""
    final_std: float = 0.25
    """Bound on the standard deviation of every action at the end."""
    first_iteration: int = 250
    """Meta-iteration in which the bound is 1, and begins to fall. A shorter run has no bound."""
    last_iteration: int = 300
    """Meta-iteration from which on it is `final_std`."""

    def __check_init__(self) -> None:
        if not 0 < self.final_std <= 1:
            raise ValueError(f"`final_std` must lie in (0, 1], got {self.final_std}.")
        if not 0 <= self.first_iteration < self.last_iteration:
            raise ValueError(
                "`first_iteration` must be at least 0 and before `last_iteration`, got "
                f"{self.first_iteration} and {self.last_iteration}."
            )

    def for_actions(self, kind: ActionKind) -> AbstractPolicySettings:
        """Return settings without a bound for actions that are choices."""
        return self if kind == "continuous" else self.network.for_actions(kind)

    def init(
        self, key: Key, observation_size: int, action_size: int, z_size: int
    ) -> GaussianMLPPolicy:
        return self.network.init(key, observation_size, action_size, z_size)

    def after_iteration(
        self, policy: GaussianMLPPolicy, iteration: Int[Array, ""]
    ) -> GaussianMLPPolicy:
        """Return the policy within the bound of an iteration."""
        share = (iteration - self.first_iteration) / (self.last_iteration - self.first_iteration)
        bound = jnp.where(share < 0, jnp.inf, jnp.minimum(share, 1.0) * math.log(self.final_std))
        limited = jnp.minimum(policy.log_std, bound.astype(policy.log_std.dtype))
        return eqx.tree_at(lambda x: x.log_std, policy, limited)
