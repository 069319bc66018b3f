"""The outer objective of gradient-based meta-learning, as a function of the meta-parameters."""

from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.context import AbstractContext, AbstractContextSettings
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.inner.adaptation import Adaptation, StepSizes
from maesn.inner.advantage import Advantages
from maesn.inner.surrogate import outer_loss, post_distributions
from maesn.numerics import AbstractDistribution, masked_mean
from maesn.numerics.normalization import ObservationStatistics
from maesn.numerics.trust_region import Evaluation
from maesn.policies import AbstractPolicy

# A batch of episodes with its advantages.
Experience: TypeAlias = tuple[Episodes, Advantages]


class MetaParameters(eqx.Module):
    """All that the outer step changes."""

    policy: AbstractPolicy
    """theta, where every task starts from."""
    context: AbstractContext
    """One context per training task, or one for all, as the context's rule says."""
    step_sizes: StepSizes


def start_agents(
    context: AbstractContextSettings[Any],
    parameters: MetaParameters,
    index: Int[Array, " task"],
    statistics: ObservationStatistics | None = None,
) -> Agents:
    """Return the pre-update agents of the given training tasks."""
    started = context.start(parameters.context, index)
    return Agents(parameters.policy, started, shares_policy=True, statistics=statistics)


class MetaObjective(eqx.Module):
    """The outer loss of one meta-iteration as a function of the meta-parameters.

    loss = mean_i [ L_outer,i(adapted agent i) + penalty(pre-update context i) ]

    (problem (3) of section "Meta-Learning Latent Variable Policies"). Episodes and advantages are
    data: gradients run through the inner updates, but not through the sampling before them.
    """

    context: AbstractContextSettings[Any]
    adaptation: Adaptation
    index: Int[Array, " task"]
    pre: tuple[Experience, ...]
    post: Episodes
    advantages: Advantages
    statistics: ObservationStatistics | None = None

    def start(self, parameters: MetaParameters) -> Agents:
        """Return the agents before the inner updates."""
        return start_agents(self.context, parameters, self.index, self.statistics)

    def updated(self, parameters: MetaParameters) -> tuple[Agents, ...]:
        """Return the agents after every inner update."""
        agents, sizes = [self.start(parameters)], parameters.step_sizes
        for episodes, advantages in self.pre:
            agents.append(self.adaptation(agents[-1], sizes, self.context, episodes, advantages))
        return tuple(agents[1:])

    def adapted(self, parameters: MetaParameters) -> Agents:
        """Return the agents after all inner updates."""
        return (self.start(parameters), *self.updated(parameters))[-1]

    def distributions(self, parameters: MetaParameters, episodes: Episodes) -> AbstractDistribution:
        """Return the adapted agents' action distributions, `[task, episode, time, action]`."""
        return self.adapted(parameters).vmap(post_distributions)(episodes)

    def statistics_after(self) -> ObservationStatistics | None:
        """Return the statistics, with all that was observed before an action taken in."""
        statistics = self.statistics
        if statistics is None:
            return None
        for played in (*(episodes for episodes, _ in self.pre), self.post):
            statistics = statistics.with_batch(played.observation[..., :-1, :], played.valid)
        return statistics

    def one_by_one(self, function: Callable[["MetaObjective"], Any]) -> Any:
        """Return `function(objective of one task alone)`, task after task, stacked over `task`.

        The activations of one task fit in a CPU's cache, those of all do not.
        """

        def one(row: Any) -> Any:
            index, pre, post, advantages = jax.tree.map(lambda x: x[None], row)
            task = MetaObjective(
                self.context, self.adaptation, index, pre, post, advantages, self.statistics
            )
            return function(task)

        return jax.lax.map(one, (self.index, self.pre, self.post, self.advantages))

    def evaluate(self, parameters: MetaParameters) -> Evaluation:
        """Return the loss, and the mean KL from the distributions that were played.

        Only the loss is to be differentiated. Each task's gradient is then taken at once, because
        reverse mode through the loop would store the activations of all tasks.
        """

        @jax.custom_vjp
        def evaluate(parameters: MetaParameters) -> Evaluation:
            return _mean_over_tasks(self.one_by_one(lambda task: task.evaluate_at_once(parameters)))

        def forward(parameters: MetaParameters) -> tuple[Evaluation, MetaParameters]:
            def differentiate(task: MetaObjective) -> tuple[Evaluation, MetaParameters]:
                def loss(varied: MetaParameters) -> tuple[Float[Array, ""], Evaluation]:
                    evaluation = task.evaluate_at_once(varied)
                    return evaluation.loss, evaluation

                slope, evaluation = jax.grad(loss, has_aux=True)(parameters)
                return evaluation, slope

            evaluation, slope = _mean_over_tasks(self.one_by_one(differentiate))
            return evaluation, slope

        def backward(slope: MetaParameters, cotangent: Evaluation) -> tuple[MetaParameters]:
            return (jax.tree.map(lambda x: cotangent.loss * x, slope),)

        evaluate.defvjp(forward, backward)
        return evaluate(parameters)

    def evaluate_at_once(self, parameters: MetaParameters) -> Evaluation:
        """Return the same by one pass over all tasks, to be differentiated at will."""
        new = self.distributions(parameters, self.post)
        surrogate = jax.vmap(outer_loss)(new, self.post, self.advantages)
        divergence = self.post.behaviour.kl(new)
        return Evaluation(
            loss=jnp.mean(surrogate + self.penalties(parameters)),
            kl=jnp.mean(jax.vmap(masked_mean)(divergence, self.post.valid)),
        )

    def task_losses(self, parameters: MetaParameters) -> Float[Array, " task"]:
        """Return every task's part of the loss."""
        new = self.distributions(parameters, self.post)
        surrogate = jax.vmap(outer_loss)(new, self.post, self.advantages)
        return surrogate + self.penalties(parameters)

    def penalties(self, parameters: MetaParameters) -> Float[Array, " task"]:
        """Return what each task's pre-update context is charged."""
        context = self.context.start(parameters.context, self.index)
        return jax.vmap(self.context.penalty, axis_size=self.index.shape[0])(context)


def _mean_over_tasks(stacked: Any) -> Any:
    return jax.tree.map(lambda x: x.mean(0), stacked)
