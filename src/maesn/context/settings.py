"""Settings of contexts: where they start, their penalty, and how z is differentiated."""

from abc import abstractmethod
from typing import ClassVar, Generic, Literal, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.axes import Key
from maesn.context.values import AbstractContext, Bias, Latent, Nothing, TaskDescription
from maesn.numerics import DiagonalGaussian
from maesn.settings import check_choice, check_least, check_number

Value = TypeVar("Value", bound=AbstractContext)


class AbstractContextSettings(eqx.Module, Generic[Value]):
    """Settings of a context: where it starts, its penalty, and how its z is differentiated."""

    is_adaptable: ClassVar[bool] = True
    """Whether a context has parameters that an inner update can move."""

    @abstractmethod
    def init(self, key: Key, num_tasks: int, description_size: int = 0) -> Value:
        """Return the table that training learns: a row per training task, or one for all."""

    @abstractmethod
    def start(self, table: Value, task_index: Int[Array, " task"]) -> Value:
        """Return the pre-update contexts of the given training tasks, stacked over `task`."""

    @abstractmethod
    def start_new(self, table: Value, num_tasks: int) -> Value:
        """Return the contexts that unseen tasks start from, stacked over `task`."""

    @property
    def is_pathwise(self) -> bool:
        """Whether the inner gradient of the context runs through the policy.

        The inner loss then draws z again, from the recorded noise; else z is as it was played.
        """
        return False

    def draw_loss(
        self,
        value: Value,
        drawn: Float[Array, "episode z"],
        episode_advantage: Float[Array, " episode"],
    ) -> Float[Array, ""]:
        """Return the part of the inner loss that treats z as the zeroth action: 0 by default."""
        return jnp.zeros(())

    def penalty(
        self, table: Value, value: Value, noise: Float[Array, "episode noise"]
    ) -> Float[Array, ""]:
        """Return the penalty of one task's pre-update context in the outer loss: 0 by default.

        The table may hold more than contexts, such as a prior. The recorded noise of each z is for
        a penalty that is estimated from draws.
        """
        return jnp.zeros(())


class _FixedContext(AbstractContextSettings[Value]):
    """Nothing in it is learned or adapted: every task starts from the table as it is."""

    is_adaptable: ClassVar[bool] = False

    def start(self, table: Value, task_index: Int[Array, " task"]) -> Value:
        return table

    def start_new(self, table: Value, num_tasks: int) -> Value:
        return table


class NoContext(_FixedContext[Nothing]):
    """No context: the policy sees observations alone."""

    def init(self, key: Key, num_tasks: int, description_size: int = 0) -> Nothing:
        return Nothing()


class OracleContext(_FixedContext[TaskDescription]):
    """The task itself: the policy sees the description of its task, without a penalty."""

    def init(self, key: Key, num_tasks: int, description_size: int = 0) -> TaskDescription:
        return TaskDescription(description_size)


class BiasContext(AbstractContextSettings[Bias]):
    """A deterministic vector, shared by all tasks before adaptation (appendix "Ablation Study").

    Its inner gradient runs through the policy (pathwise), and it has no penalty.
    """

    is_pathwise = True

    size: int = 8
    """Number of components of the bias. Reference: 8 on ant."""

    def __check_init__(self) -> None:
        check_number("size", self.size, 0)

    def init(self, key: Key, num_tasks: int, description_size: int = 0) -> Bias:
        return Bias(jnp.zeros(self.size))

    def start(self, table: Bias, task_index: Int[Array, " task"]) -> Bias:
        return self.start_new(table, task_index.shape[0])

    def start_new(self, table: Bias, num_tasks: int) -> Bias:
        return Bias(jnp.broadcast_to(table.value, (num_tasks, self.size)))


LatentGradient: TypeAlias = Literal["likelihood_ratio", "reparameterized"]


class LatentContext(AbstractContextSettings[Latent]):
    """A Gaussian latent per training task; one z is drawn per episode.

    The latent is the zeroth action of an episode (z, a_0, ..., a_{T-1}). Its inner gradient is the
    likelihood ratio of section "Using the Latent Spaces for Exploration", or the reparameterised
    gradient that the same section names as the alternative. The outer loss contains the penalty
    `kl_weight * KL(N(mean, std^2) || N(0, I))` of the pre-update latent.
    """

    size: int = 2
    """Number of components of the latent z. Reference: 2 in all reported runs."""
    kl_weight: float = 0.1
    """Weight of the KL divergence to the prior. Reference: 0.1 on wheeled and ant."""
    initial_spread: float = 1.0
    """Standard deviation of the latents' means before training. Reference: 1."""
    gradient: LatentGradient = "likelihood_ratio"
    """Estimator of the inner gradient of the latent. Reference: likelihood ratio."""

    def __check_init__(self) -> None:
        check_least(self, size=1, kl_weight=0, initial_spread=0)
        check_choice("gradient", self.gradient, LatentGradient)

    @property
    def is_pathwise(self) -> bool:
        return self.gradient == "reparameterized"

    def init(self, key: Key, num_tasks: int, description_size: int = 0) -> Latent:
        shape = (num_tasks, self.size)
        return Latent(self.initial_spread * jax.random.normal(key, shape), jnp.zeros(shape))

    def start(self, table: Latent, task_index: Int[Array, " task"]) -> Latent:
        return Latent(table.mean[task_index], table.log_std[task_index])

    def start_new(self, table: Latent, num_tasks: int) -> Latent:
        """Return the prior N(0, I) for every task (section "Using the Latent Spaces ...")."""
        zeros = jnp.zeros((num_tasks, self.size))
        return Latent(zeros, zeros)

    def draw_loss(
        self,
        value: Latent,
        drawn: Float[Array, "episode z"],
        episode_advantage: Float[Array, " episode"],
    ) -> Float[Array, ""]:
        """Return -mean_e[log q(z_e) A_e], the likelihood-ratio surrogate of the latent."""
        if self.gradient == "reparameterized":
            return jnp.zeros(())
        return -jnp.mean(value.distribution.log_prob(drawn) * episode_advantage)

    def penalty(
        self, table: Latent, value: Latent, noise: Float[Array, "episode noise"]
    ) -> Float[Array, ""]:
        return self.kl_weight * value.distribution.kl(DiagonalGaussian.standard(value.mean.shape))
