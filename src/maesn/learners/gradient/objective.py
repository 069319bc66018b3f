"""The outer objective of gradient-based meta-learning, as a function of the meta-parameters."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.context import AbstractContext, AbstractContextSettings
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.inner.adaptation import Adaptation, StepSizes
from maesn.inner.advantage import Advantages
from maesn.inner.surrogate import outer_loss, post_distributions
from maesn.numerics import AbstractDistribution, masked_mean, mesh
from maesn.numerics.normalization import ObservationStatistics
from maesn.numerics.tasks import map_tasks
from maesn.numerics.trust_region import Candidate
from maesn.policies import AbstractPolicy

# A batch of episodes with its advantages.
Experience: TypeAlias = tuple[Episodes, Advantages]


class MetaParameters(eqx.Module):
    """The parameters that the outer step changes."""

    policy: AbstractPolicy
    """theta, from which every task starts."""
    context_table: AbstractContext
    """One context per training task, or one for all, as the context settings say."""
    step_sizes: StepSizes


def start_agents(
    context: AbstractContextSettings[Any],
    parameters: MetaParameters,
    index: Int[Array, " task"],
    statistics: ObservationStatistics | None = None,
) -> Agents:
    """Return the pre-update agents of the given training tasks."""
    started = context.start(parameters.context_table, index)
    return Agents(parameters.policy, started, shares_policy=True, statistics=statistics)


class MetaObjective(eqx.Module):
    """The outer loss of one meta-iteration as a function of the meta-parameters.

    loss = mean_i [ L_outer,i(adapted agent i) + penalty(pre-update context i) ]

    (problem (3) of section "Meta-Learning Latent Variable Policies"). Episodes and advantages are
    data: gradients run through the inner updates, but not through the sampling of episodes.
    """

    context: AbstractContextSettings[Any]
    adaptation: Adaptation
    index: Int[Array, " task"]
    """The training task of each slot."""
    pre: tuple[Experience, ...]
    """Episodes and advantages of each inner update."""
    post: Episodes
    """Episodes of the adapted agents."""
    advantages: Advantages
    """Advantages of `post`."""
    statistics: ObservationStatistics | None = None

    @property
    def rows(self) -> tuple[Any, ...]:
        """What has a row per task."""
        return self.index, self.pre, self.post, self.advantages

    def start(self, parameters: MetaParameters) -> Agents:
        """Return the agents before the inner updates."""
        return start_agents(self.context, parameters, self.index, self.statistics)

    def updated(self, parameters: MetaParameters) -> tuple[Agents, ...]:
        """Return the agents after the first inner update, after the second, and so on."""
        agents = self.start(parameters)
        updated = []
        for experience in self.pre:
            agents = self.adaptation(agents, parameters.step_sizes, self.context, *experience)
            updated.append(agents)
        return tuple(updated)

    def adapted(self, parameters: MetaParameters) -> Agents:
        """Return the agents after all inner updates."""
        return self.updated(parameters)[-1] if self.pre else self.start(parameters)

    def distributions(self, parameters: MetaParameters, episodes: Episodes) -> AbstractDistribution:
        """Return the adapted agents' action distributions, `[task, episode, time, action]`."""
        return self.adapted(parameters).map(post_distributions, episodes, how="vmap")

    def distributions_before(self, parameters: MetaParameters) -> AbstractDistribution:
        """Return likewise those of the agents before the inner updates, on what they played."""
        return self.start(parameters).map(post_distributions, self.pre[0][0], how="vmap")

    def statistics_after(self) -> ObservationStatistics | None:
        """Return the statistics after the episodes of this meta-iteration.

        Only observations that were followed by an action count.
        """
        statistics = self.statistics
        if statistics is None:
            return None
        for episodes in (*(episodes for episodes, _ in self.pre), self.post):
            statistics = statistics.with_batch(episodes.observation[..., :-1, :], episodes.valid)
        return statistics

    def evaluate(
        self, parameters: MetaParameters, largest_kl: float | Float[Array, ""] = math.inf
    ) -> Candidate:
        """Return the loss, and the mean KL from the distributions that `post` was drawn from.

        Args:
            parameters: where they are evaluated.
            largest_kl: bound on the mean KL. If some tasks alone exceed it, the others are left
                out: no divergence is negative, so the KL that is returned exceeds the bound too.
                The loss then means nothing.
        """
        tasks = self.index.shape[0]
        enough = largest_kl * tasks * mesh.num_shards()

        def goes_on(state: tuple[Int[Array, ""], Candidate]) -> Bool[Array, ""]:
            return (state[0] < tasks) & ~(state[1].kl > enough)

        def add(state: tuple[Int[Array, ""], Candidate]) -> tuple[Int[Array, ""], Candidate]:
            row = jax.tree.map(lambda x: x[state[0]], self.rows)
            found = self._alone(row).evaluate_at_once(parameters)
            return state[0] + 1, jax.tree.map(jnp.add, state[1], found)

        nothing = Candidate(jnp.zeros(()), jnp.zeros(()))
        _, total = jax.lax.while_loop(goes_on, add, (jnp.zeros((), int), nothing))
        return mesh.mean(Candidate(total.loss / tasks, total.kl / tasks))

    def loss_and_gradient(
        self, parameters: MetaParameters
    ) -> tuple[Float[Array, ""], MetaParameters]:
        """Return the loss and its gradient."""
        return self.gradient_of(lambda task, varied: task.evaluate_at_once(varied).loss, parameters)

    def gradient_of(
        self,
        loss: Callable[["MetaObjective", MetaParameters], Float[Array, ""]],
        parameters: MetaParameters,
    ) -> tuple[Float[Array, ""], MetaParameters]:
        """Return the mean of a loss over all tasks, and its gradient.

        `loss` takes the objective of a single task, and the parameters. Each task is differentiated
        separately. Reverse mode through all tasks at once would return the same, but store the
        activations of all of them.
        """

        def differentiate(*row: Any) -> tuple[Float[Array, ""], MetaParameters]:
            task = self._alone(row)
            return jax.value_and_grad(lambda varied: loss(task, varied))(parameters)

        # In turn, because the activations of one task fit in a CPU's cache; those of all do not.
        found = map_tasks(differentiate, *self.rows, how="serial")
        averages: tuple[Float[Array, ""], MetaParameters] = mesh.mean(
            jax.tree.map(lambda x: x.mean(0), found)
        )
        return averages

    def evaluate_at_once(self, parameters: MetaParameters) -> Candidate:
        """Return the same as `evaluate`, with all tasks at once instead of one after another."""
        return jax.tree.map(jnp.mean, self.of_tasks(parameters))

    def of_tasks(self, parameters: MetaParameters) -> Candidate:
        """Return the loss and the KL of every task, `[task]`; `evaluate` returns their means."""
        new = self.distributions(parameters, self.post)
        kl = map_tasks(masked_mean, self.post.behaviour.kl(new), self.post.valid, how="vmap")
        losses = map_tasks(outer_loss, new, self.post, self.advantages, how="vmap")
        return Candidate(losses + self.penalties(parameters), kl)

    def penalties(self, parameters: MetaParameters) -> Float[Array, " task"]:
        """Return the penalty of every task's pre-update context."""
        table = parameters.context_table
        played = self.pre[0][0] if self.pre else self.post
        penalties: Array = map_tasks(
            lambda one, noise: self.context.penalty(table, one, noise),
            self.context.start(table, self.index),
            played.noise,
            how="vmap",
        )
        return penalties

    def _alone(self, row: tuple[Any, ...]) -> "MetaObjective":
        """Return the objective of a single task, from its row of `rows`."""
        index, pre, post, advantages = jax.tree.map(lambda x: x[None], row)
        return replace(self, index=index, pre=pre, post=post, advantages=advantages)
