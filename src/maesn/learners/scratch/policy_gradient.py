"""Policy gradient in one task: REINFORCE and TRPO, from scratch or from given weights.

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

from maesn.axes import Key, TaskKeys
from maesn.context import Nothing
from maesn.experience.agent import Agent, Agents
from maesn.experience.episodes import Episodes
from maesn.inner.advantage import AdvantageEstimator, Advantages
from maesn.learners.fast import AbstractFastLearner, Purpose
from maesn.learners.policy_steps import AbstractPolicyStep, GradientStep, TrustRegionStep
from maesn.learners.trials import trials_of
from maesn.learners.wrappers.bonus import BonusFastLearner
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.numerics.tasks import map_tasks
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import (
    AbstractPolicy,
    AbstractPolicySettings,
    AnnealedGaussianMLP,
    GaussianMLP,
)

# Damping as in Stable-Baselines3 and Spinning Up: with the reference's 1e-5, the step follows
# directions that one task's small batch says nothing of, and is cut back to nearly nothing. Steps
# of conjugate gradients: Schulman et al. 2015, appendix C, and Spinning Up.
TRPO = TrustRegionStep(TrustRegion(damping=0.1, cg_steps=10))


EVERY_STEP = "the policy gradient in one task judges every step by itself."
"""Why a policy must not be recurrent."""


class PolicyGradientState(eqx.Module):
    """State of a policy gradient in many tasks, each with weights of its own."""

    agents: Agents
    opt_state: Any
    """States of the policy steps, one per task."""
    keys: TaskKeys
    """One key per task, for all later draws."""
    update: Int[Array, ""]
    """Number of updates so far."""


class PolicyImprovement(eqx.Module):
    """Policy gradient on the weights of given agents. Their contexts do not change."""

    rule: AbstractPolicyStep = TRPO
    """The step of the weights."""
    advantage: AdvantageEstimator = AdvantageEstimator()
    """The estimator of advantages."""

    def begin(self, keys: TaskKeys, agents: Agents) -> PolicyGradientState:
        """Return the initial state: these agents, each with its own copy of the weights."""
        policy, opt_state = agents.map(
            lambda agent, _: (agent.policy, self.rule.init(agent.policy)), keys, how="vmap"
        )
        agents = replace(agents, policy=policy, shares_policy=False)
        return PolicyGradientState(agents, opt_state, keys, jnp.zeros((), int))

    @eqx.filter_jit
    def __call__(self, state: PolicyGradientState, episodes: Episodes) -> PolicyGradientState:
        """Take one step in every task, on its agent's episodes."""
        advantages = self.advantage.of_tasks(episodes)
        keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(state.keys, state.update)

        def improve(
            agent: Agent, key: Key, opt_state: Any, own: Episodes, own_advantages: Advantages
        ) -> tuple[AbstractPolicy, Any]:
            trials = trials_of(agent, own)
            return self.rule(key, agent.policy, opt_state, trials, own_advantages.step)[:2]

        # In turn: all at once, every task would wait for the longest line search.
        policy, opt_state = state.agents.map(improve, keys, state.opt_state, episodes, advantages)
        moved = replace(state.agents, policy=policy)
        return PolicyGradientState(moved, opt_state, state.keys, state.update + 1)


class PolicyGradient(AbstractFastLearner[PolicyGradientState]):
    """Starts with fresh weights in every task, and follows the policy gradient."""

    observation_size: int
    """Components of an observation."""
    action_size: int
    """Components of an action, or number of choices."""
    policy: AbstractPolicySettings = GaussianMLP()
    """The policy's network."""
    improvement: PolicyImprovement = PolicyImprovement()
    """The policy gradient method."""

    def __check_init__(self) -> None:
        if self.policy.is_recurrent:
            raise ValueError(
                f"`policy` must not be recurrent, got {type(self.policy).__name__}: {EVERY_STEP}"
            )
        if isinstance(self.policy, AnnealedGaussianMLP):
            raise ValueError("`policy` must not be annealed: there are no meta-iterations here.")

    def init(self, keys: TaskKeys) -> PolicyGradientState:
        split = jax.vmap(jax.random.split)(keys)
        policy = map_tasks(
            lambda key: self.policy.init(key, self.observation_size, self.action_size, 0),
            split[:, 0],
            how="vmap",
        )
        agents = Agents(policy, Nothing(), shares_policy=False)
        return self.improvement.begin(split[:, 1], agents)

    def agents(self, state: PolicyGradientState, purpose: Purpose = "explore") -> Agents:
        return state.agents

    def update(self, state: PolicyGradientState, episodes: Episodes) -> PolicyGradientState:
        """Take one step in every task."""
        return self.improvement(state, episodes)


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
        step_size: size of every update. Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`.
        settings: others of `PolicyGradient`.
    """
    improvement = PolicyImprovement(GradientStep(step_size))
    return PolicyGradient(observation_size, action_size, improvement=improvement, **settings)


def trpo(
    observation_size: int,
    action_size: int,
    *,
    max_kl: float = TRPO.trust_region.max_kl,
    **settings: Any,
) -> PolicyGradient:
    """TRPO (Schulman et al. 2015) that drifts where all episodes have the same rewards.

    Without control costs this is so until an episode reaches the goal. Steps in random directions
    are then a search among policies, which finds goals that the noise of actions alone does not
    (docs/explanation/methods/scratch.md). The published runs drifted, by their implementation.

    Args:
        observation_size: components of an observation.
        action_size: components of an action, or number of choices.
        max_kl: bound on the mean KL divergence of an update. Published: 0.01.
        settings: others of `PolicyGradient`.
    """
    improvement = PolicyImprovement(TRPO.sized(max_kl), AdvantageEstimator(drifts=True))
    return PolicyGradient(observation_size, action_size, improvement=improvement, **settings)


def vime(
    observation_size: int,
    action_size: int,
    *,
    max_kl: float = TRPO.trust_region.max_kl,
    curiosity: CuriosityBonus | None = None,
    **settings: Any,
) -> BonusFastLearner:
    """VIME (Houthooft et al. 2016): TRPO with a curiosity bonus.

    It does not drift: with a bonus no two episodes have the same rewards. (With a weight of 0 it
    stands still where `trpo` drifts.)

    Args:
        observation_size: components of an observation.
        action_size: components of an action, or number of choices.
        max_kl: bound on the mean KL divergence of an update. Published: 0.01.
        curiosity: the bonus; None for the usual one.
        settings: others of `PolicyGradient`.
    """
    improvement = PolicyImprovement(TRPO.sized(max_kl))
    learner = PolicyGradient(observation_size, action_size, improvement=improvement, **settings)
    bonus = CuriosityBonus() if curiosity is None else curiosity
    return BonusFastLearner(learner, bonus, observation_size, action_size)


SCRATCH: dict[str, Callable[..., AbstractFastLearner[Any]]] = {
    "reinforce": reinforce,
    "vpg": reinforce,
    "trpo": trpo,
    "vime": vime,
}
"""Methods that begin anew in every task. Each takes the sizes of observation and action."""
