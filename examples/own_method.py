"""A meta-learner of your own: Reptile (Nichol et al. 2018, https://arxiv.org/abs/1803.02999).

    export PYTHONPATH=examples
    maesn train own_method:Reptile --family point --run runs/reptile --iterations 100
    maesn adapt runs/reptile --method own_method:Reptile --reward dense

In each of several tasks the policy takes a few steps of policy gradient. Then the common weights
move towards the mean of what the tasks have made of them. No gradient runs through the steps.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

import maesn


class ReptileState(eqx.Module):
    """What changes in training: arrays only."""

    policy: maesn.AbstractPolicy
    iteration: Int[Array, ""]


class ReptileInfo(eqx.Module):
    """What a meta-iteration tells a person: scalars, logged by these names."""

    return_before: Float[Array, ""]
    """Mean return before the steps."""
    return_after: Float[Array, ""]
    """Mean return after all but the last of them."""


class Reptile(maesn.AbstractMetaLearner[ReptileState, ReptileInfo]):
    """Weights from which a few steps of policy gradient lead far."""

    policy: maesn.AbstractPolicySettings = maesn.GaussianMLP()
    """The policy's network."""
    improvement: maesn.PolicyImprovement = maesn.PolicyImprovement(
        maesn.TrustRegionStep(maesn.TrustRegion(max_kl=0.05, damping=0.1))
    )
    """The policy gradient inside a task."""
    inner_updates: int = 3
    """Updates in each task, each on episodes of its own."""
    meta_batch_size: int = 10
    """Training tasks per meta-iteration."""
    rate: float = 0.5
    """Share of the way to the mean of the tasks' weights that one meta-iteration goes."""

    def init(self, key: Array, problem: maesn.Problem) -> ReptileState:
        sizes = problem.observation_size, problem.action_size
        return ReptileState(self.policy.init(key, *sizes, 0), jnp.zeros((), int))

    def fast_learner(self, state: ReptileState) -> maesn.FineTuning:
        return maesn.FineTuning(
            maesn.FixedPolicy(state.policy), self.improvement, after=0, least_batch=1
        )

    def step(
        self, key: Array, state: ReptileState, collect: maesn.Collect
    ) -> tuple[ReptileState, ReptileInfo]:
        task_key, play_key, learn_key = jax.random.split(key, 3)
        tasks = maesn.draw_tasks(task_key, collect.num_tasks, self.meta_batch_size)
        learner = self.fast_learner(state)
        learned = learner.init(maesn.task_keys(learn_key, 0, self.meta_batch_size))
        returns = []
        for update in range(self.inner_updates):
            keys = maesn.task_keys(play_key, update, self.meta_batch_size)
            episodes = collect(keys, learner.agents(learned), tasks, stage=update)
            returns.append(episodes.undiscounted_return.mean())
            learned = learner.update(learned, episodes)
        per_task = learner.agents(learned).policy  # a leading axis `task`
        policy = jax.tree.map(
            lambda w, ws: w + self.rate * (ws.mean(0) - w), state.policy, per_task
        )
        return ReptileState(policy, state.iteration + 1), ReptileInfo(returns[0], returns[-1])

    def iteration(self, state: ReptileState) -> Int[Array, ""]:
        return state.iteration

    def weights(self, state: ReptileState) -> maesn.AbstractPolicy:
        return state.policy

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        return iterations * self.inner_updates * self.meta_batch_size * episodes_per_task

    def for_actions(self, kind: str) -> "Reptile":
        return replace(self, policy=self.policy.for_actions(kind))
