"""Learning across tasks by differentiating through learning inside them.

MAML, MAML + bias, LatentSpace and MAESN are this one learner with two slots filled differently:
the context that it conditions on, and the adaptation that it allows (`maesn.learners.presets`).
"""

from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.adaptation import Adaptation, StepSchedule, StepSizes
from maesn.advantage import AdvantageEstimator, Advantages
from maesn.agent import Agent, Agents
from maesn.axes import Key, TaskKeys
from maesn.context import AbstractContext, AbstractContextValue
from maesn.episodes import Episodes, concatenate
from maesn.learners.base import AbstractMetaLearner
from maesn.learners.fast import GradientFastLearner
from maesn.numerics import AbstractDistribution, DiagonalGaussian, masked_mean
from maesn.policies import AbstractPolicy, AbstractPolicySettings, GaussianMLP
from maesn.rollout import Collect
from maesn.surrogate import outer_loss, post_distributions
from maesn.trust_region import Evaluation, TrustRegion, TrustRegionInfo

# A batch of episodes with its advantages.
Experience: TypeAlias = tuple[Episodes, Advantages]


class MetaParameters(eqx.Module):
    """All that the outer step changes."""

    policy: AbstractPolicy
    """theta, where every task starts from."""
    context: AbstractContextValue
    """One context per training task, or one for all, as the context's rule says."""
    step_sizes: StepSizes


class GradientState(eqx.Module):
    """State of a `GradientMetaLearner`."""

    parameters: MetaParameters
    iteration: Int[Array, ""]


class GroupShares(eqx.Module):
    """Shares of the squared length of the outer step that fall on each group; they sum to 1.

    Directions in which the policy has no curvature are held by damping alone, so it is worth a
    look which group the step spends itself on.
    """

    policy: Float[Array, ""]
    context: Float[Array, ""]
    step_sizes: Float[Array, ""]


class GradientInfo(eqx.Module):
    """What a human wants to know of one meta-iteration: scalars only."""

    return_before: Float[Array, ""]
    """Mean undiscounted return before the inner updates."""
    return_after: Float[Array, ""]
    """Mean undiscounted return after them."""
    success_after: Float[Array, ""]
    """Share of the episodes after adaptation that reach the goal region."""
    penalty: Float[Array, ""]
    """Mean penalty of the pre-update contexts (weighted KL to the prior)."""
    action_std: Float[Array, ""]
    """Mean standard deviation of the actions after adaptation."""
    trust_region: TrustRegionInfo
    shares: GroupShares
    step_sizes: StepSizes
    """Mean of the learned step sizes of every array of parameters."""
    nonfinite_tasks: Int[Array, ""]
    """Number of tasks whose surrogate loss was not finite; the step was then rejected."""


class GradientMetaLearner(AbstractMetaLearner[GradientState, GradientInfo]):
    """REINFORCE inside, TRPO outside (algorithm 1 of the paper)."""

    context: AbstractContext
    """What the policy is conditioned on."""
    adaptation: Adaptation
    """What an inner step changes."""
    policy: AbstractPolicySettings = GaussianMLP()
    """The policy's network."""
    advantage: AdvantageEstimator = AdvantageEstimator()
    """How rewards become advantages."""
    trust_region: TrustRegion = TrustRegion()
    """The outer step."""
    schedule: StepSchedule = StepSchedule()
    """Step sizes in a new task, update by update."""
    meta_batch_size: int = 20
    """Training tasks per meta-iteration, drawn without replacement. (The reference draws with
    replacement.)"""
    inner_updates: int = 1
    """Inner updates per meta-iteration, each on episodes of its own."""
    outer_batches: int = 1
    """Batches of episodes that the outer step learns from."""
    curvature_stride: int = 5
    """The curvature of the trust region is averaged over every so-manieth time step."""

    def __check_init__(self) -> None:
        for name in ("meta_batch_size", "outer_batches", "curvature_stride"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1, got {getattr(self, name)}.")
        if self.inner_updates < 0:
            raise ValueError(f"`inner_updates` must be at least 0, got {self.inner_updates}.")

    def init(
        self, key: Key, observation_size: int, action_size: int, num_tasks: int
    ) -> GradientState:
        """See `AbstractMetaLearner.init`.

        Raises:
            ValueError: the training set holds fewer tasks than one meta-batch.
        """
        if num_tasks < self.meta_batch_size:
            raise ValueError(
                f"`meta_batch_size` is {self.meta_batch_size}, but the training set holds only "
                f"{num_tasks} tasks. Tasks are drawn without replacement: lower it or add tasks."
            )
        context_key, policy_key = jax.random.split(key)
        context = self.context.init(context_key, num_tasks)
        policy = self.policy.init(policy_key, observation_size, action_size, context.size)
        one_task = jax.tree.map(lambda x: x[0], self.context.start_new(context, 1))
        sizes = self.adaptation.init(Agent(policy, one_task))
        parameters = MetaParameters(policy, context, sizes)
        return GradientState(parameters, jnp.zeros((), int))

    def iteration(self, state: GradientState) -> Int[Array, ""]:
        return state.iteration

    def fast_learner(self, state: GradientState) -> GradientFastLearner:
        """Return the learner of new tasks: starts at the prior, adapts by policy gradient."""
        return GradientFastLearner(
            context=self.context,
            adaptation=self.adaptation,
            advantage=self.advantage,
            schedule=self.schedule,
            policy=state.parameters.policy,
            learned_context=state.parameters.context,
            step_sizes=state.parameters.step_sizes,
        )

    def step(
        self, key: Key, state: GradientState, collect: Collect
    ) -> tuple[GradientState, GradientInfo]:
        """See `AbstractMetaLearner.step`."""
        task_key, play_key, curvature_key = jax.random.split(key, 3)
        parameters, adaptation = state.parameters, self.adaptation.at(int(state.iteration))
        index = jax.random.choice(
            task_key, collect.num_tasks, (self.meta_batch_size,), replace=False
        )
        agents = self._start(parameters, index)
        pre: list[Experience] = []
        for phase in range(self.inner_updates):
            episodes = collect(_task_keys(play_key, phase, index.shape[0]), agents, index)
            advantages = self._advantages(episodes)
            agents = self._adapt(adaptation, agents, parameters.step_sizes, episodes, advantages)
            pre.append((episodes, advantages))
        post = self._play_outer(play_key, agents, index, collect)
        improved, info = self._improve(
            adaptation,
            parameters,
            index,
            (*pre, (post, self._advantages(post))),
            curvature_key,
        )
        return GradientState(improved, state.iteration + 1), info

    def _play_outer(
        self, key: Key, agents: Agents, index: Int[Array, " task"], collect: Collect
    ) -> Episodes:
        """Collect the episodes that the outer step learns from."""
        keys = [
            _task_keys(key, self.inner_updates + batch, index.shape[0])
            for batch in range(self.outer_batches)
        ]
        post = collect(keys[0], agents, index)
        for batch_keys in keys[1:]:
            post = concatenate(post, collect(batch_keys, agents, index))
        return post

    @eqx.filter_jit
    def _start(self, parameters: MetaParameters, index: Int[Array, " task"]) -> Agents:
        return self._agents(parameters, index)

    def _agents(self, parameters: MetaParameters, index: Int[Array, " task"]) -> Agents:
        """Return the pre-update agents of the given training tasks."""
        context = self.context.start(parameters.context, index)
        return Agents(parameters.policy, context, shares_policy=True)

    @eqx.filter_jit
    def _advantages(self, episodes: Episodes) -> Advantages:
        return jax.vmap(self.advantage)(episodes)

    @eqx.filter_jit
    def _adapt(
        self,
        adaptation: Adaptation,
        agents: Agents,
        sizes: StepSizes,
        episodes: Episodes,
        advantages: Advantages,
    ) -> Agents:
        return adaptation(agents, sizes, self.context, episodes, advantages)

    @eqx.filter_jit
    def _improve(
        self,
        adaptation: Adaptation,
        parameters: MetaParameters,
        index: Int[Array, " task"],
        played: tuple[Experience, ...],
        key: Key,
    ) -> tuple[MetaParameters, GradientInfo]:
        """Do the outer step. Beyond this point only the meta-parameters vary."""
        *pre, (post, advantages) = played
        objective = MetaObjective(self, adaptation, index, tuple(pre), post, advantages)
        offset = jax.random.randint(key, (), 0, self.curvature_stride)
        thinned = post.every(self.curvature_stride, offset)
        improved, step = self.trust_region.step(
            parameters,
            objective.evaluate,
            lambda varied: objective.distributions(varied, thinned),
            _step_weights(thinned),
        )
        return improved, self._info(objective, parameters, improved, step)

    def _info(
        self,
        objective: "MetaObjective",
        old: MetaParameters,
        new: MetaParameters,
        step: TrustRegionInfo,
    ) -> GradientInfo:
        first = objective.pre[0][0] if objective.pre else objective.post
        losses = objective.task_losses(old)
        return GradientInfo(
            return_before=first.undiscounted_return.mean(),
            return_after=objective.post.undiscounted_return.mean(),
            success_after=objective.post.solved.any(-1).mean(),
            penalty=objective.penalties(old).mean(),
            action_std=_mean_std(objective.post.behaviour),
            trust_region=step,
            shares=_group_shares(old, new),
            step_sizes=jax.tree.map(jnp.mean, new.step_sizes),
            nonfinite_tasks=jnp.sum(~jnp.isfinite(losses)),
        )


class MetaObjective(eqx.Module):
    """The outer loss of one meta-iteration as a function of the meta-parameters.

    loss = mean_i [ L_outer,i(adapted agent i) + penalty(pre-update context i) ]

    (problem (3) of section "Meta-Learning Latent Variable Policies"). Episodes and advantages are
    data: gradients run through the inner updates, but not through the sampling before them.
    """

    learner: GradientMetaLearner
    adaptation: Adaptation
    index: Int[Array, " task"]
    pre: tuple[Experience, ...]
    post: Episodes
    advantages: Advantages

    def adapted(self, parameters: MetaParameters) -> Agents:
        """Return the agents after all inner updates."""
        agents = self.learner._agents(parameters, self.index)
        for episodes, advantages in self.pre:
            agents = self.adaptation(
                agents, parameters.step_sizes, self.learner.context, episodes, advantages
            )
        return agents

    def distributions(
        self, parameters: MetaParameters, episodes: Episodes
    ) -> AbstractDistribution:
        """Return the adapted agents' action distributions, `[task, episode, time, action]`."""
        return self.adapted(parameters).vmap(post_distributions)(episodes)

    def evaluate(self, parameters: MetaParameters) -> Evaluation:
        """Return the loss, and the mean KL from the distributions that were played."""
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
        context = self.learner.context.start(parameters.context, self.index)
        return jax.vmap(self.learner.context.penalty, axis_size=self.index.shape[0])(context)


def _task_keys(key: Key, phase: int, num_slots: int) -> TaskKeys:
    """Return one key per task slot, for one of the collections of a meta-iteration."""
    phase_key = jax.random.fold_in(key, phase)
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(phase_key, jnp.arange(num_slots))


def _step_weights(episodes: Episodes) -> Float[Array, "task episode time"]:
    """Return the weight of each step in a mean over tasks of means over valid steps."""
    valid = episodes.valid.astype(float)
    per_task = jnp.maximum(valid.sum((1, 2), keepdims=True), 1.0)
    return valid / (per_task * valid.shape[0])


def _group_shares(old: MetaParameters, new: MetaParameters) -> GroupShares:
    def squared(before: Any, after: Any) -> Float[Array, ""]:
        parts = jax.tree.map(lambda a, b: jnp.sum((b - a) ** 2), before, after)
        return sum(jax.tree.leaves(parts), jnp.zeros(()))

    policy = squared(old.policy, new.policy)
    context = squared(old.context, new.context)
    sizes = squared(old.step_sizes, new.step_sizes)
    total = policy + context + sizes
    scale = jnp.where(total > 0, 1.0 / jnp.where(total > 0, total, 1.0), 0.0)
    return GroupShares(policy * scale, context * scale, sizes * scale)


def _mean_std(behaviour: AbstractDistribution) -> Float[Array, ""]:
    assert isinstance(behaviour, DiagonalGaussian)
    return jnp.exp(behaviour.log_std).mean()
