"""How a policy is improved on trials: PPO or TRPO, one slot."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.learners.recurrent.trials import Trials
from maesn.numerics import AbstractDistribution, MinibatchDescent, if_finite, masked_mean
from maesn.numerics.trust_region import Evaluation, TrustRegion, TrustRegionInfo
from maesn.policies import AbstractPolicy


class AbstractPolicyStep(eqx.Module):
    """Improves a policy on trials that it has played."""

    @property
    @abstractmethod
    def minibatches(self) -> int:
        """Number of parts that the trials are cut into."""

    @abstractmethod
    def init(self, policy: AbstractPolicy) -> Any:
        """Return the optimiser's state before the first step."""

    @abstractmethod
    def __call__(
        self,
        key: Key,
        policy: AbstractPolicy,
        state: Any,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, Any, Any]:
        """Return the improved policy, the optimiser's state, and what happened.

        Args:
            key: random key.
            policy: has played the trials.
            state: of the optimiser.
            trials: what was played.
            advantages: of every step; ignored where invalid.
        """


class ProximalInfo(eqx.Module):
    """What happened in one `ProximalStep`."""

    accepted: Bool[Array, ""]
    """False if the improved weights were not finite: nothing has changed."""
    loss: Float[Array, ""]
    """Mean of the last pass."""
    kl: Float[Array, ""]
    """Mean KL(old || new) of the action distributions in the last pass."""
    clipped: Float[Array, ""]
    """Share of the steps whose ratio was beyond the clip in the last pass."""


class ProximalStep(AbstractPolicyStep):
    """PPO (Schulman et al. 2017, equation 7), https://arxiv.org/abs/1707.06347.

        L = -mean_t min(ρ_t A_t, clip(ρ_t, 1 - ε, 1 + ε) A_t) - w mean_t H(π_t)

    with ρ_t = π(a_t) / π_old(a_t) and the entropy H. A minibatch holds whole trials, and gradients
    run through all of their memory.
    """

    clip: float = 0.2
    """ε. PPO's own, and that of garage's and Meta-World's RL2."""
    entropy_weight: float = 0.0
    """w, a bonus per nat."""
    descent: MinibatchDescent = MinibatchDescent()
    """How the loss is minimised."""

    def __check_init__(self) -> None:
        if not 0 < self.clip < 1:
            raise ValueError(f"`clip` must lie in (0, 1), got {self.clip}.")
        if not self.entropy_weight >= 0:
            raise ValueError(f"`entropy_weight` must be at least 0, got {self.entropy_weight}.")

    @property
    def minibatches(self) -> int:
        return self.descent.minibatches

    def init(self, policy: AbstractPolicy) -> Any:
        return self.descent.init(policy)

    def __call__(
        self,
        key: Key,
        policy: AbstractPolicy,
        state: Any,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, Any, ProximalInfo]:
        def loss(
            varied: AbstractPolicy, batch: tuple[Trials, Array]
        ) -> tuple[Float[Array, ""], ProximalInfo]:
            return self.loss(batch[0].distributions(varied), *batch)

        improved, new_state, info = self.descent.run(key, policy, state, loss, (trials, advantages))
        (improved, state), accepted = if_finite((improved, new_state), (policy, state))
        return improved, state, eqx.tree_at(lambda told: told.accepted, info, accepted)

    def loss(
        self,
        new: AbstractDistribution,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[Float[Array, ""], ProximalInfo]:
        """Return L, and what is to be known of it.

        Args:
            new: distributions that vary, `[trial time action]`.
            trials: what was played.
            advantages: A_t.
        """
        valid = trials.valid
        ratio = probability_ratio(new, trials)
        bounded = jnp.clip(ratio, 1.0 - self.clip, 1.0 + self.clip)
        gain = masked_mean(jnp.minimum(ratio * advantages, bounded * advantages), valid)
        value = -gain - self.entropy_weight * masked_mean(new.entropy(), valid)
        return value, ProximalInfo(
            accepted=jnp.ones((), bool),
            loss=value,
            kl=masked_mean(trials.behaviour.kl(new), valid),
            clipped=masked_mean((ratio != bounded).astype(ratio.dtype), valid),
        )


class TrustRegionStep(AbstractPolicyStep):
    """TRPO, the step of Duan et al. (2016), with the surrogate -mean_t ρ_t A_t."""

    trust_region: TrustRegion = TrustRegion(damping=1e-2, cg_steps=10)
    """Damping ours: with the outer step's 1e-5, the step follows directions that a tenth of the
    trials say nothing of. Steps of conjugate gradients: Schulman et al. 2015, appendix C."""
    curvature_stride: int = 10
    """The curvature is averaged over one of so many trials; 1 for all."""

    def __check_init__(self) -> None:
        if self.curvature_stride < 1:
            raise ValueError(f"`curvature_stride` must be at least 1, got {self.curvature_stride}.")

    @property
    def minibatches(self) -> int:
        return 1

    def init(self, policy: AbstractPolicy) -> None:
        return None

    def __call__(
        self,
        key: Key,
        policy: AbstractPolicy,
        state: None,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, None, TrustRegionInfo]:
        def evaluate(varied: AbstractPolicy) -> Evaluation:
            new = trials.distributions(varied)
            gain = masked_mean(probability_ratio(new, trials) * advantages, trials.valid)
            return Evaluation(-gain, masked_mean(trials.behaviour.kl(new), trials.valid))

        sample = self._sample(key, trials)
        weight = sample.valid.astype(float)
        weight = weight / jnp.maximum(weight.sum(), 1.0)
        improved, info = self.trust_region.step(policy, evaluate, sample.distributions, weight)
        return improved, None, info

    def _sample(self, key: Key, trials: Trials) -> Trials:
        """Draw the trials that the curvature is averaged over."""
        count = trials.valid.shape[0]
        rows = jax.random.permutation(key, count)[: max(count // self.curvature_stride, 1)]
        return jax.tree.map(lambda x: x[rows], trials)


def probability_ratio(new: AbstractDistribution, trials: Trials) -> Float[Array, "trial time"]:
    """Return ρ_t = π(a_t) / π_old(a_t); 1 where invalid."""
    old_log_prob = trials.behaviour.log_prob(trials.action)
    difference = new.log_prob(trials.action) - old_log_prob
    return jnp.exp(jnp.where(trials.valid, difference, 0.0))
