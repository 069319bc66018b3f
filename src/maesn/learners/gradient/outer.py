"""Outer steps: how the meta-parameters improve on the episodes of one meta-iteration."""

from abc import abstractmethod
from functools import partial
from typing import Any, Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.experience.agent import Agents
from maesn.experience.episodes import Thinning
from maesn.inner.surrogate import clipped_loss
from maesn.learners.gradient.curvature import sampled_distributions, step_weights
from maesn.learners.gradient.objective import MetaObjective, MetaParameters
from maesn.numerics import first_order_step, if_finite
from maesn.numerics.tasks import map_tasks
from maesn.numerics.trust_region import TrustRegion, TrustRegionInfo
from maesn.policies import AbstractPolicySettings
from maesn.settings import check_choice, check_least, check_number, check_positive


class AbstractOuterStep(eqx.Module):
    """Improves the meta-parameters: the slot `outer` of a `GradientMetaLearner`."""

    def check_policy(self, policy: AbstractPolicySettings) -> None:
        """Refuse a policy that the step cannot improve.

        Raises:
            ValueError: it cannot.
        """

    def init(self, parameters: MetaParameters) -> Any:
        """Return the optimiser's state before the first step; None if it has none."""
        return None

    @abstractmethod
    def __call__(
        self,
        key: Key,
        parameters: MetaParameters,
        opt_state: Any,
        objective: MetaObjective,
        updated: tuple[Agents, ...],
    ) -> tuple[MetaParameters, Any, Any]:
        """Return improved parameters, the optimiser's state, and scalars to log.

        The scalars have the fields `accepted`, False if nothing has changed, and `loss_before`.

        Args:
            key: random key.
            parameters: the parameters before the step.
            opt_state: state of the optimiser.
            objective: the problem, on the episodes of this meta-iteration.
            updated: `objective.updated(parameters)`, which the episodes were played by.
        """


class TrustRegionOuterStep(AbstractOuterStep):
    """TRPO on the meta-parameters (Schulman et al. 2015), the outer step of the paper."""

    trust_region: TrustRegion = TrustRegion()
    """Direction and length of the outer step."""
    curvature_stride: int = 20
    """Distance between the time steps that the curvature is averaged over. 1: all steps, as the
    reference. Neighbouring steps resemble each other; 20 suits episodes of 50 to 200 steps."""
    hessian_stride: int | None = None
    """The same distance for the Hessian of the inner loss. None: `curvature_stride`. The Hessian is
    part of the curvature where an inner update runs through the policy
    (`maesn.learners.gradient.curvature`). Its terms nearly cancel, so it needs more steps."""

    def __check_init__(self) -> None:
        check_least(self, curvature_stride=1, hessian_stride=1)

    def check_policy(self, policy: AbstractPolicySettings) -> None:
        for name in ("curvature_stride", "hessian_stride"):
            stride = getattr(self, name)
            if stride is not None and stride > 1 and policy.is_recurrent:
                raise ValueError(
                    f"`outer.{name}` is {stride}, but a recurrent policy needs all steps of an "
                    "episode: set it to 1."
                )

    def __call__(
        self,
        key: Key,
        parameters: MetaParameters,
        opt_state: None,
        objective: MetaObjective,
        updated: tuple[Agents, ...],
    ) -> tuple[MetaParameters, None, TrustRegionInfo]:
        outer, inner = self._thinnings(key, objective.post.valid)
        improved, info = self.trust_region.step(
            parameters,
            partial(objective.evaluate, largest_kl=self.trust_region.max_kl),
            objective.loss_and_gradient,
            lambda varied: sampled_distributions(objective, varied, updated, outer, inner),
            step_weights(objective.post.every(*outer)),
        )
        return improved, None, info

    def _thinnings(
        self, key: Key, valid: Bool[Array, "task episode time"]
    ) -> tuple[Thinning, Thinning]:
        """Draw the time steps of the curvature: of the outer loss, and of the inner updates."""
        if self.hessian_stride is None:
            both = Thinning.draw(key, self.curvature_stride, valid)
            return both, both
        outer_key, inner_key = jax.random.split(key)
        outer = Thinning.draw(outer_key, self.curvature_stride, valid)
        return outer, Thinning.draw(inner_key, self.hessian_stride, valid)


Optimizer: TypeAlias = Literal["adam", "rmsprop", "sgd"]


class FirstOrderInfo(eqx.Module):
    """Info of one outer step that follows gradients."""

    accepted: Bool[Array, ""]
    """False if the result was not finite: nothing has changed."""
    loss_before: Float[Array, ""]
    loss_after: Float[Array, ""]
    kl: Float[Array, ""]
    """Mean KL(old || new) of the adapted agents' action distributions."""
    gradient_norm: Float[Array, ""]
    """Norm of the first gradient."""


class FirstOrderOuterStep(AbstractOuterStep):
    """Follows the gradient of the outer loss with an optimiser of Optax."""

    optimizer: Optimizer = "adam"
    """Name of the optimiser."""
    learning_rate: float = 1e-3
    """Learning rate of the optimiser."""
    steps: int = 1
    """Gradient steps per meta-iteration, all on the same episodes."""

    def __check_init__(self) -> None:
        check_choice("optimizer", self.optimizer, Optimizer)
        check_positive(self, "learning_rate")
        check_number("steps", self.steps, 1)

    def loss(self, task: MetaObjective, parameters: MetaParameters) -> Float[Array, ""]:
        """Return the loss to descend.

        Args:
            task: the objective of a single task.
            parameters: what the loss is differentiated with respect to.
        """
        return task.evaluate_at_once(parameters).loss

    @property
    def _transformation(self) -> optax.GradientTransformation:
        make = {"adam": optax.adam, "rmsprop": optax.rmsprop, "sgd": optax.sgd}[self.optimizer]
        return make(self.learning_rate)

    def init(self, parameters: MetaParameters) -> optax.OptState:
        return self._transformation.init(parameters)

    def __call__(
        self,
        key: Key,
        parameters: MetaParameters,
        opt_state: optax.OptState,
        objective: MetaObjective,
        updated: tuple[Agents, ...],
    ) -> tuple[MetaParameters, optax.OptState, FirstOrderInfo]:
        def descend(now: tuple[MetaParameters, optax.OptState], _: None) -> tuple[Any, Any]:
            loss, gradient = objective.gradient_of(self.loss, now[0])
            moved = first_order_step(self._transformation, now[0], gradient, now[1])
            return moved, (loss, optax.tree.norm(gradient))

        before = parameters, opt_state
        moved, (losses, norms) = jax.lax.scan(descend, before, length=self.steps)
        (improved, opt_state), accepted = if_finite(moved, before)
        after = objective.evaluate(improved)
        info = FirstOrderInfo(
            accepted=accepted,
            loss_before=losses[0],
            loss_after=after.loss,
            kl=after.kl,
            gradient_norm=norms[0],
        )
        return improved, opt_state, info


class ProximalOuterStep(FirstOrderOuterStep):
    """PPO on the meta-parameters (Schulman et al. 2017): several steps on a clipped objective.

    Clip, learning rate and number of steps are those of ProMP (Rothfuss et al. 2019,
    https://arxiv.org/abs/1810.06784).
    """

    steps: int = 5
    clip: float = 0.3
    """Probability ratios count only within [1 - clip, 1 + clip]."""

    def __check_init__(self) -> None:
        if not 0 < self.clip < 1:
            raise ValueError(f"`clip` must lie in (0, 1), got {self.clip}.")

    def loss(self, task: MetaObjective, parameters: MetaParameters) -> Float[Array, ""]:
        new = task.distributions(parameters, task.post)
        loss = partial(clipped_loss, clip=self.clip)
        clipped = map_tasks(loss, new, task.post, task.advantages, how="vmap")
        return jnp.mean(clipped + task.penalties(parameters))
