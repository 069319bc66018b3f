"""How a policy's weights follow their own experience in one task: REINFORCE's step, and TRPO's."""

import math
from abc import abstractmethod
from dataclasses import replace
from typing import Any, Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.experience.agent import Agent
from maesn.experience.episodes import Episodes, Thinning
from maesn.inner.advantage import Advantages
from maesn.inner.surrogate import action_distributions, outer_loss
from maesn.numerics import AbstractDistribution, first_order_step, masked_mean
from maesn.numerics.trust_region import Evaluation, TrustRegion
from maesn.policies import AbstractPolicy
from maesn.settings import check_choice


class AbstractWeightStep(eqx.Module):
    """A step of the policy's weights, for one task. The context that they are fed stays."""

    @abstractmethod
    def sized(self, size: float) -> "AbstractWeightStep":
        """Return the rule with another size of its steps, in the rule's own measure."""

    @abstractmethod
    def init(self, policy: AbstractPolicy) -> Any:
        """Return what the rule remembers between steps, before the first one."""

    @abstractmethod
    def step(
        self, key: Key, agent: Agent, memory: Any, episodes: Episodes, advantages: Advantages
    ) -> tuple[AbstractPolicy, Any]:
        """Return moved weights and the new memory.

        Args:
            key: random key.
            agent: who played.
            memory: of the steps before.
            episodes: what it played, `[episode, ...]`.
            advantages: of those episodes.
        """


Scaling: TypeAlias = Literal["none", "adam"]


class GradientStep(AbstractWeightStep):
    """REINFORCE: θ' = θ + step_size * mean_{e,t}[∇ log π(a_t | o_t, z_e) A_t]."""

    step_size: float = 0.1
    """Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`."""
    scaling: Scaling = "none"
    """Whether Adam scales the gradient, which turns the size of the step into another one."""

    def __check_init__(self) -> None:
        check_choice("scaling", self.scaling, Scaling)
        if not 0 < self.step_size < math.inf:
            raise ValueError(f"`step_size` must be positive and finite, got {self.step_size}.")

    def sized(self, size: float) -> "GradientStep":
        """Return the rule with another `step_size`."""
        return replace(self, step_size=size)

    @property
    def _optimizer(self) -> optax.GradientTransformation:
        make = {"none": optax.sgd, "adam": optax.adam}[self.scaling]
        return make(self.step_size)

    def init(self, policy: AbstractPolicy) -> Any:
        return self._optimizer.init(policy)

    def step(
        self, key: Key, agent: Agent, memory: Any, episodes: Episodes, advantages: Advantages
    ) -> tuple[AbstractPolicy, Any]:
        def loss(policy: AbstractPolicy) -> Float[Array, ""]:
            new = action_distributions(replace(agent, policy=policy), episodes, episodes.z)
            actions = jnp.where(episodes.valid[..., None], episodes.action, 0.0)
            return -masked_mean(new.log_prob(actions) * advantages.step, episodes.valid)

        gradient = jax.grad(loss)(agent.policy)
        return first_order_step(self._optimizer, agent.policy, gradient, memory)


class TrustRegionWeightStep(AbstractWeightStep):
    """TRPO: the natural gradient step of a bounded mean KL divergence."""

    trust_region: TrustRegion = TrustRegion(damping=0.1, cg_steps=10)
    """Damping as in Stable-Baselines3 and Spinning Up: with the reference's 1e-5, the step follows
    directions that one task's small batch says nothing of, and is cut back to nearly nothing. Steps
    of conjugate gradients: Schulman et al. 2015, appendix C, and Spinning Up."""
    curvature_stride: int = 10
    """The curvature is averaged over one of so many time steps; 1 for all. Schulman et
    al. 2015, appendix C.1: a tenth of the data."""

    def __check_init__(self) -> None:
        if self.curvature_stride < 1:
            raise ValueError(f"`curvature_stride` must be at least 1, got {self.curvature_stride}.")

    def sized(self, size: float) -> "TrustRegionWeightStep":
        """Return the rule with another bound on the mean KL divergence, `trust_region.max_kl`."""
        return replace(self, trust_region=replace(self.trust_region, max_kl=size))

    def init(self, policy: AbstractPolicy) -> None:
        return None

    def step(
        self, key: Key, agent: Agent, memory: None, episodes: Episodes, advantages: Advantages
    ) -> tuple[AbstractPolicy, None]:
        def distributions(policy: AbstractPolicy, played: Episodes) -> AbstractDistribution:
            return action_distributions(replace(agent, policy=policy), played, played.z)

        def evaluate(policy: AbstractPolicy) -> Evaluation:
            new = distributions(policy, episodes)
            return Evaluation(
                loss=outer_loss(new, episodes, advantages),
                kl=masked_mean(episodes.behaviour.kl(new), episodes.valid),
            )

        time = episodes.action.shape[-2]
        thinned = episodes.every(*Thinning.draw(key, self.curvature_stride, time))
        valid = thinned.valid.astype(float)
        moved, _ = self.trust_region.step(
            agent.policy,
            evaluate,
            lambda policy: distributions(policy, thinned),
            valid / jnp.maximum(valid.sum(), 1.0),
        )
        return moved, None
