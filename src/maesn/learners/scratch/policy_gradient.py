"""Learning a task from scratch: REINFORCE and TRPO, and whatever goes on from a given policy.

Nothing is meta-learned here. `PolicyGradient` is a fast learner like the ones that meta-learning
produces, and the same evaluator draws its curve.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import TaskKeys
from maesn.context import Nothing
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.inner.advantage import AdvantageEstimator
from maesn.learners.base import AbstractFastLearner, Purpose, SavedContexts, refuse_saved
from maesn.learners.scratch.weight_steps import (
    AbstractWeightStep,
    GradientStep,
    TrustRegionWeightStep,
)
from maesn.learners.wrappers.bonus import BonusFastLearner
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.policies import AbstractPolicySettings, GaussianMLP


class PolicyGradientState(eqx.Module):
    """State of a policy gradient in many tasks, each with weights of its own."""

    agents: Agents
    memory: Any
    """What the rule remembers, one per task."""
    keys: TaskKeys
    """Of all further draws of each task."""
    update: Int[Array, ""]
    """Number of updates so far."""


def refuse_recurrent(name: str, owner: object, *, is_recurrent: bool) -> None:
    """Refuse recurrent policies: the steps of the weights here judge every time step by itself.

    Args:
        name: of the argument.
        owner: what was given for it.
        is_recurrent: whether its policy is.

    Raises:
        ValueError: it is.
    """
    if is_recurrent:
        raise ValueError(
            f"`{name}` must not be recurrent, got {type(owner).__name__}: the policy gradient in "
            "one task judges every step by itself."
        )


class PolicyImprovement(eqx.Module):
    """Policy gradient on the weights of agents that are given; their contexts stay."""

    rule: AbstractWeightStep = TrustRegionWeightStep()
    """The step of the weights."""
    advantage: AdvantageEstimator = AdvantageEstimator()
    """How rewards become advantages."""

    def begin(self, keys: TaskKeys, agents: Agents) -> PolicyGradientState:
        """Return the state that begins with these agents, each with a copy of its weights."""
        policy, memory = agents.vmap(lambda agent, _: (agent.policy, self.rule.init(agent.policy)))(
            keys
        )
        owners = replace(agents, policy=policy, shares_policy=False)
        return PolicyGradientState(owners, memory, keys, jnp.zeros((), int))

    @eqx.filter_jit
    def __call__(self, state: PolicyGradientState, episodes: Episodes) -> PolicyGradientState:
        """Move every task's weights once, by what its agent has played."""
        advantages = self.advantage.of_tasks(episodes)
        keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(state.keys, state.update)
        # At once, all tasks would wait for the longest line search.
        policy, memory = state.agents.one_by_one(
            lambda agent, key, memory, played, judged: self.rule.step(
                key, agent, memory, played, judged
            )
        )(keys, state.memory, episodes, advantages)
        moved = replace(state.agents, policy=policy)
        return PolicyGradientState(moved, memory, state.keys, state.update + 1)


class PolicyGradient(AbstractFastLearner[PolicyGradientState]):
    """Starts with fresh weights in every task, and follows the policy gradient."""

    observation_size: int
    """Components of an observation."""
    action_size: int
    """Components of an action, or number of choices."""
    policy: AbstractPolicySettings = GaussianMLP()
    """The policy's network."""
    improvement: PolicyImprovement = PolicyImprovement()
    """How the weights follow their experience."""

    def __check_init__(self) -> None:
        refuse_recurrent("policy", self.policy, is_recurrent=self.policy.is_recurrent)

    def init(self, keys: TaskKeys, saved: SavedContexts | None = None) -> PolicyGradientState:
        refuse_saved(self, saved)
        split = jax.vmap(jax.random.split)(keys)
        policy = jax.vmap(
            lambda key: self.policy.init(key, self.observation_size, self.action_size, 0)
        )(split[:, 0])
        agents = Agents(policy, Nothing(), shares_policy=False)
        return self.improvement.begin(split[:, 1], agents)

    def agents(self, state: PolicyGradientState, purpose: Purpose = "explore") -> Agents:
        return state.agents

    def update(self, state: PolicyGradientState, episodes: Episodes) -> PolicyGradientState:
        """Take one step in every task."""
        return self.improvement(state, episodes)


IMPROVEMENTS = {
    "trpo": PolicyImprovement(TrustRegionWeightStep()),
    "reinforce": PolicyImprovement(GradientStep()),
}
"""How a policy's weights can follow the gradient of one task, by name."""


def reinforce(
    observation_size: int,
    action_size: int,
    *,
    step_size: float = GradientStep().step_size,
    **settings: Any,
) -> PolicyGradient:
    """REINFORCE with a fixed step size (Williams 1992): the paper's "VPG".

    Args:
        observation_size: components of an observation.
        action_size: components of an action, or number of choices.
        step_size: of every update. Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`.
        settings: others of `PolicyGradient`.
    """
    improvement = PolicyImprovement(GradientStep(step_size))
    return PolicyGradient(observation_size, action_size, improvement=improvement, **settings)


def trpo(
    observation_size: int,
    action_size: int,
    *,
    max_kl: float = TrustRegionWeightStep().trust_region.max_kl,
    **settings: Any,
) -> PolicyGradient:
    """TRPO (Schulman et al. 2015) that drifts where all episodes are paid the same.

    A family without control costs pays all episodes the same until one reaches the goal. Steps in
    random directions are then a search of policies, which finds goals that the noise of actions
    alone does not (docs/methods/scratch.md). The published runs drifted, by their implementation.

    Args:
        observation_size: components of an observation.
        action_size: components of an action, or number of choices.
        max_kl: bound on the mean KL divergence of an update. Published: 0.01.
        settings: others of `PolicyGradient`.
    """
    rule = TrustRegionWeightStep().sized(max_kl)
    improvement = PolicyImprovement(rule, AdvantageEstimator(drifts=True))
    return PolicyGradient(observation_size, action_size, improvement=improvement, **settings)


def vime(
    observation_size: int,
    action_size: int,
    *,
    max_kl: float = TrustRegionWeightStep().trust_region.max_kl,
    curiosity: CuriosityBonus | None = None,
    **settings: Any,
) -> BonusFastLearner:
    """VIME (Houthooft et al. 2016): TRPO that is paid for what it finds out.

    It does not drift: with a bonus no two episodes are paid the same. (With a weight of 0 it stands
    still where `trpo` drifts.)

    Args:
        observation_size: components of an observation.
        action_size: components of an action, or number of choices.
        max_kl: bound on the mean KL divergence of an update. Published: 0.01.
        curiosity: what it is paid; None for the usual.
        settings: others of `PolicyGradient`.
    """
    improvement = PolicyImprovement(TrustRegionWeightStep().sized(max_kl))
    learner = PolicyGradient(observation_size, action_size, improvement=improvement, **settings)
    paid = CuriosityBonus() if curiosity is None else curiosity
    return BonusFastLearner(learner, paid, observation_size, action_size)


SCRATCH: dict[str, Callable[..., AbstractFastLearner[Any]]] = {
    "reinforce": reinforce,
    "vpg": reinforce,
    "trpo": trpo,
    "vime": vime,
}
"""Methods that begin anew in every task. Each takes the sizes of observation and action."""
