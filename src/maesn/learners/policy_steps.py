"""Policy gradient steps on a policy's weights: REINFORCE, PPO or TRPO, one slot."""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.learners.trials import Trials
from maesn.numerics import (
    AbstractDistribution,
    MinibatchDescent,
    first_order_step,
    if_finite,
    masked_mean,
)
from maesn.numerics.trust_region import Candidate, TrustRegion, TrustRegionInfo
from maesn.policies import AbstractPolicy
from maesn.settings import check_choice, check_number, check_positive


class AbstractPolicyStep(eqx.Module):
    """Improves a policy on trials that it has played."""

    @property
    def minibatches(self) -> int:
        """Number of parts that the trials are cut into."""
        return 1

    @abstractmethod
    def init(self, policy: AbstractPolicy) -> Any:
        """Return the optimiser's state before the first step."""

    @abstractmethod
    def __call__(
        self,
        key: Key,
        policy: AbstractPolicy,
        opt_state: Any,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, Any, Any]:
        """Return the improved policy, the optimiser's state, and what happened.

        Args:
            key: random key.
            policy: has played the trials.
            opt_state: state of the optimiser.
            trials: the trials to learn from.
            advantages: the advantage of every step; ignored where invalid.
        """


Scaling: TypeAlias = Literal["none", "adam"]


class GradientStepInfo(eqx.Module):
    """Info of one `GradientStep`."""

    loss: Float[Array, ""]
    """Loss before the step."""
    gradient_norm: Float[Array, ""]
    accepted: Bool[Array, ""]
    """False if the result was not finite: weights and optimiser stay as they were."""


class GradientStep(AbstractPolicyStep):
    """REINFORCE: θ' = θ + step_size * mean_t[∇ log π(a_t) A_t], over all steps of all trials."""

    step_size: float = 0.1
    """Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`."""
    scaling: Scaling = "none"
    """`adam` for a gradient that Adam scales: the size of the step then means something else."""

    def __check_init__(self) -> None:
        check_choice("scaling", self.scaling, Scaling)
        check_positive(self, "step_size")

    @property
    def _optimizer(self) -> optax.GradientTransformation:
        make = {"none": optax.sgd, "adam": optax.adam}[self.scaling]
        return make(self.step_size)

    def init(self, policy: AbstractPolicy) -> Any:
        return self._optimizer.init(policy)

    def __call__(
        self,
        key: Key,
        policy: AbstractPolicy,
        opt_state: Any,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, Any, GradientStepInfo]:
        def loss(varied: AbstractPolicy) -> Float[Array, ""]:
            log_prob = trials.distributions(varied).log_prob(trials.action)
            return -masked_mean(log_prob * advantages, trials.valid)

        value, gradient = jax.value_and_grad(loss)(policy)
        moved = first_order_step(self._optimizer, policy, gradient, opt_state)
        new, accepted = if_finite(moved, (policy, opt_state))
        return *new, GradientStepInfo(value, optax.tree.norm(gradient), accepted)


class ProximalInfo(eqx.Module):
    """Info of one `ProximalStep`."""

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
    run through all of their steps.
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
        check_number("entropy_weight", self.entropy_weight, 0)

    @property
    def minibatches(self) -> int:
        return self.descent.minibatches

    def init(self, policy: AbstractPolicy) -> Any:
        return self.descent.init(policy)

    def __call__(
        self,
        key: Key,
        policy: AbstractPolicy,
        opt_state: Any,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, Any, ProximalInfo]:
        def loss(
            varied: AbstractPolicy, batch: tuple[Trials, Array]
        ) -> tuple[Float[Array, ""], ProximalInfo]:
            return self.loss(batch[0].distributions(varied), *batch)

        *new, info = self.descent.run(key, policy, opt_state, loss, (trials, advantages))
        (improved, opt_state), accepted = if_finite(tuple(new), (policy, opt_state))
        return improved, opt_state, replace(info, accepted=accepted)

    def loss(
        self,
        new: AbstractDistribution,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[Float[Array, ""], ProximalInfo]:
        """Return the loss L at distributions `new`, `[trial time action]`, and what is logged."""
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
    """TRPO (Schulman et al. 2015), with the surrogate -mean_t ρ_t A_t."""

    trust_region: TrustRegion = TrustRegion(damping=1e-2, cg_steps=10)
    """Damping ours: with the outer step's 1e-5, the step follows directions that a tenth of the
    trials say nothing of. Steps of conjugate gradients: Schulman et al. 2015, appendix C."""
    curvature_stride: int = 10
    """The curvature is averaged over one of so many time steps, or of so many trials if the policy
    is recurrent; 1 for all. Schulman et al. 2015, appendix C.1: a tenth of the data."""

    def __check_init__(self) -> None:
        check_number("curvature_stride", self.curvature_stride, 1)

    def sized(self, size: float) -> "TrustRegionStep":
        """Return the same step with another bound on the mean KL divergence."""
        return replace(self, trust_region=replace(self.trust_region, max_kl=size))

    def init(self, policy: AbstractPolicy) -> None:
        return None

    def __call__(
        self,
        key: Key,
        policy: AbstractPolicy,
        opt_state: None,
        trials: Trials,
        advantages: Float[Array, "trial time"],
    ) -> tuple[AbstractPolicy, None, TrustRegionInfo]:
        def evaluate(varied: AbstractPolicy) -> Candidate:
            new = trials.distributions(varied)
            gain = masked_mean(probability_ratio(new, trials) * advantages, trials.valid)
            return Candidate(-gain, masked_mean(trials.behaviour.kl(new), trials.valid))

        is_recurrent = policy.initial_recurrent_state() is not None
        draw = trials.sample_trials if is_recurrent else trials.sample_steps
        sample = draw(key, self.curvature_stride)
        weight = sample.valid.astype(float)
        improved, info = self.trust_region.step(
            policy,
            evaluate,
            jax.value_and_grad(lambda varied: evaluate(varied).loss),
            sample.distributions,
            weight / jnp.maximum(weight.sum(), 1.0),
        )
        return improved, None, info


def probability_ratio(new: AbstractDistribution, trials: Trials) -> Float[Array, "trial time"]:
    """Return ρ_t = π(a_t) / π_old(a_t); 1 where invalid."""
    old_log_prob = trials.behaviour.log_prob(trials.action)
    difference = new.log_prob(trials.action) - old_log_prob
    return jnp.exp(jnp.where(trials.valid, difference, 0.0))
