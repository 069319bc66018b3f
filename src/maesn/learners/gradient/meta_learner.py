"""Learning across tasks by differentiating through learning inside them.

MAML, MAML + bias, LatentSpace and MAESN are this one learner with two slots filled differently:
the context that it conditions on, and the adaptation that it allows (`maesn.learners.presets`).
"""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import ActionKind, Key
from maesn.context import AbstractContextSettings
from maesn.experience.agent import Agent, Agents
from maesn.experience.episodes import Collect, Episodes, concatenate
from maesn.inner.adaptation import Adaptation, StepSchedule, StepSizes
from maesn.inner.advantage import AdvantageEstimator, Advantages
from maesn.learners.fast import Capabilities
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.learners.gradient.info import GradientInfo, describe_step
from maesn.learners.gradient.objective import (
    Experience,
    MetaObjective,
    MetaParameters,
    start_agents,
)
from maesn.learners.gradient.outer import AbstractOuterStep, TrustRegionOuterStep
from maesn.learners.meta import AbstractMetaLearner, Problem
from maesn.learners.meta_batch import check_enough_tasks, draw_tasks, task_keys
from maesn.numerics.mesh import check_split, over_tasks
from maesn.numerics.normalization import ObservationStatistics, no_observations
from maesn.policies import AbstractPolicySettings, GaussianMLP
from maesn.settings import check_least


class GradientState(eqx.Module):
    """State of a `GradientMetaLearner`."""

    parameters: MetaParameters
    iteration: Int[Array, ""]
    statistics: ObservationStatistics | None = None
    """Statistics of all observations so far; None unless observations are normalised."""
    opt_state: Any = None
    """State of the outer step's optimiser; None if it has none."""


class GradientMetaLearner(AbstractMetaLearner[GradientState, GradientInfo]):
    """REINFORCE inside, an outer step of choice outside: TRPO in algorithm 1 of the paper."""

    context: AbstractContextSettings[Any]
    """Settings of the context that the policy is conditioned on."""
    adaptation: Adaptation
    """The inner update."""
    policy: AbstractPolicySettings = GaussianMLP()
    """The policy's network."""
    advantage: AdvantageEstimator = AdvantageEstimator()
    """The estimator of advantages."""
    outer: AbstractOuterStep = TrustRegionOuterStep()
    """The outer step, which improves what all tasks share."""
    schedule: StepSchedule = StepSchedule()
    """Step sizes in a new task, update by update."""
    meta_batch_size: int = 20
    """Number of training tasks in a meta-iteration, drawn without replacement. Reference: with
    replacement."""
    inner_updates: int = 1
    """Number of inner updates in a meta-iteration. Each learns from new episodes."""
    outer_batches: int = 1
    """Number of batches of episodes that the outer step learns from."""
    normalize_observations: bool = False
    """Whether observations are normalised: less their mean, divided by their standard deviation.
    Paper: no."""

    def __check_init__(self) -> None:
        check_least(self, meta_batch_size=1, outer_batches=1, inner_updates=0)
        moved = self.adaptation.policy, self.adaptation.context
        if self.adaptation.context is not None and not self.context.is_adaptable:
            raise ValueError(
                f"`adaptation.context` must be None with {type(self.context).__name__}, in which "
                "there is nothing to move."
            )
        if self.inner_updates > 0 and moved == (None, None):
            raise ValueError(
                f"`inner_updates` is {self.inner_updates}, but `adaptation` moves nothing: set it "
                "to 0, or give `adaptation` a step of the policy or of the context."
            )
        self.outer.check_policy(self.policy)

    def init(self, key: Key, problem: Problem) -> GradientState:
        check_enough_tasks(problem.num_tasks, self.meta_batch_size)
        context_key, policy_key = jax.random.split(key)
        table = self.context.init(context_key, problem.num_tasks, problem.description_size)
        policy = self.policy.init(
            policy_key, problem.observation_size, problem.action_size, table.size
        )
        one_task = jax.tree.map(lambda x: x[0], self.context.start_new(table, 1))
        sizes = self.adaptation.init(Agent(policy, one_task))
        parameters = MetaParameters(policy, table, sizes)
        statistics = None
        if self.normalize_observations:
            statistics = no_observations(problem.observation_size)
        opt_state = self.outer.init(parameters)
        return GradientState(parameters, jnp.zeros((), int), statistics, opt_state)

    def weights(self, state: GradientState) -> Any:
        return state.parameters, state.statistics

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        collections = self.inner_updates + self.outer_batches
        return iterations * collections * self.meta_batch_size * episodes_per_task

    def effort(self, steps: int, iterations: int) -> int:
        # The gradient through an update of the weights takes as long again.
        return steps if self.adaptation.policy is None else 2 * steps

    @property
    def tasks_for_cores(self) -> int:
        return 1 if self.adaptation.policy is None else self.meta_batch_size

    def for_actions(self, kind: ActionKind) -> "GradientMetaLearner":
        return replace(self, policy=self.policy.for_actions(kind))

    def check_batch(self, episodes_per_task: int) -> None:
        """The inner update must be able to move."""
        check_split(self.meta_batch_size)
        needed = self.adaptation.at(0).least_episodes(self.context) if self.inner_updates else 1
        Capabilities(least_episodes=needed).check_episodes(episodes_per_task)

    def slots(self) -> tuple[Any, ...]:
        """Return the context, the parts that an inner update changes, and if training has one."""
        return (
            type(self),
            type(self.context),
            self.adaptation.policy is not None,
            self.adaptation.context is not None,
            self.inner_updates > 0,
        )

    def fast_learner(self, state: GradientState) -> GradientFastLearner:
        """Return the learner of new tasks: starts at the prior, adapts by policy gradient."""
        return GradientFastLearner(
            context=self.context,
            adaptation=self.adaptation.at(int(state.iteration)),
            advantage=self.advantage,
            schedule=self.schedule,
            policy=state.parameters.policy,
            context_table=state.parameters.context_table,
            step_sizes=state.parameters.step_sizes,
            statistics=state.statistics,
        )

    def step(
        self, key: Key, state: GradientState, collect: Collect
    ) -> tuple[GradientState, GradientInfo]:
        self._check_rows(state.parameters, collect)
        task_key, play_key, curvature_key = jax.random.split(key, 3)
        parameters, adaptation = state.parameters, self.adaptation.at(int(state.iteration))
        index = draw_tasks(task_key, collect.num_tasks, self.meta_batch_size)
        agents = self._start(state, index)
        pre: list[Experience] = []
        updated: list[Agents] = []
        for phase in range(self.inner_updates):
            keys = task_keys(play_key, phase, self.meta_batch_size)
            episodes = collect(keys, agents, index, stage=phase)
            pre.append((episodes, self._advantages(episodes)))
            agents = self._adapted(adaptation, agents, parameters.step_sizes, pre[-1])
            updated.append(agents)
        batches = []
        for phase in range(self.inner_updates, self.inner_updates + self.outer_batches):
            keys = task_keys(play_key, phase, self.meta_batch_size)
            batches.append(collect(keys, agents, index, stage=self.inner_updates))
        post = concatenate(*batches)
        rows = index, tuple(pre), post, self._advantages(post)
        return self._improve(state, adaptation, rows, tuple(updated), curvature_key)

    def _check_rows(self, parameters: MetaParameters, collect: Collect) -> None:
        """Refuse more tasks than there are contexts: JAX would silently take the last one."""
        rows = partial(self.context.init, num_tasks=collect.num_tasks)
        expected = jax.tree.leaves(jax.eval_shape(rows, jax.random.key(0)))
        found = jax.tree.leaves(parameters.context_table)
        if [x.shape for x in expected] != [x.shape for x in found]:
            raise ValueError(
                f"`collect` plays {collect.num_tasks} tasks, but `state` was made for another "
                "number: call `init` with the number of tasks that are played."
            )

    @eqx.filter_jit
    def _start(self, state: GradientState, index: Int[Array, " task"]) -> Agents:
        return start_agents(self.context, state.parameters, index, state.statistics)

    def _improve(
        self,
        state: GradientState,
        adaptation: Adaptation,
        rows: Any,
        updated: tuple[Agents, ...],
        key: Key,
    ) -> tuple[GradientState, GradientInfo]:
        """Do the outer step. Beyond this point only the meta-parameters vary."""
        parts = [agents.parts() for agents in updated]
        common, own = tuple(common for common, _ in parts), tuple(own for _, own in parts)
        shared = state, key, adaptation, common
        (after, info), _ = over_tasks(self._improved, shared, (rows, own))
        return after, info

    def _advantages(self, episodes: Episodes) -> Advantages:
        advantages: Advantages
        _, advantages = over_tasks(_estimate, self.advantage, episodes)
        return advantages

    def _adapted(
        self, adaptation: Adaptation, agents: Agents, sizes: StepSizes, experience: Experience
    ) -> Agents:
        common, own = agents.parts()
        _, own = over_tasks(_adapt, (adaptation, self.context, sizes, common), (own, *experience))
        return Agents.of_parts(common, own)

    # `over_tasks` runs the following, and the two functions at the end.
    def _improved(self, shared: Any, rows: Any) -> tuple[tuple[GradientState, GradientInfo], None]:
        state, key, adaptation, common = shared
        (index, pre, post, advantages), own = rows
        objective = MetaObjective(
            self.context, adaptation, index, pre, post, advantages, state.statistics
        )
        updated = tuple(map(Agents.of_parts, common, own))
        parameters = state.parameters
        improved, opt_state, step = self.outer(key, parameters, state.opt_state, objective, updated)
        done = state.iteration + 1
        policy = self.policy.after_iteration(improved.policy, done)
        after = GradientState(
            replace(improved, policy=policy), done, objective.statistics_after(), opt_state
        )
        return (after, describe_step(objective, parameters, improved, step)), None


# All that these return has a row per task, so their shared result is None.
def _estimate(estimator: AdvantageEstimator, episodes: Episodes) -> tuple[None, Advantages]:
    return None, estimator.of_tasks(episodes)


def _adapt(shared: Any, rows: Any) -> tuple[None, Any]:
    adaptation, context, sizes, common = shared
    own, episodes, advantages = rows
    agents = Agents.of_parts(common, own)
    return None, adaptation(agents, sizes, context, episodes, advantages).parts()[1]
