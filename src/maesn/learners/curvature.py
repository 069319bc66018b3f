"""The distributions whose Fisher information is the curvature of the outer step."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from maesn.adaptation import StepSizes
from maesn.agent import Agents
from maesn.episodes import Thinning
from maesn.learners.objective import Experience, MetaObjective, MetaParameters, start_agents
from maesn.numerics import AbstractDistribution, multiply
from maesn.surrogate import post_distributions


def sampled_distributions(
    objective: MetaObjective,
    parameters: MetaParameters,
    path: tuple[Agents, ...],
    outer: Thinning,
    inner: Thinning,
) -> AbstractDistribution:
    """Return the adapted agents' action distributions at some of their steps, for J'FJ.

    Their values are exact. Their derivative with respect to `parameters` takes the inner steps'
    own derivative, above all the Hessian of the inner loss, from some of the steps before them:

        J = dpi/d(adapted) (I - step size * H),  H ~ mean over sampled steps of the Hessian

    With strides of 1 all is exact. Inner steps that depend on whole episodes alone, such as that
    of a latent by likelihood ratio, are exact with any stride.

    The derivative by the step sizes, which is the gradient, is of the same sample as the Hessian,
    although the exact one is at hand: weights and step sizes that undo each other, as those of a
    bias do, then undo each other in J too. Mixing the two has made all steps fail on a small
    problem (`tests/learners/test_presets.py`).

    Args:
        objective: the problem.
        parameters: what the distributions are differentiated with respect to.
        path: `objective.path(parameters)`, the exact values: those who played are at hand.
        outer: which steps after the last update the distributions are of.
        inner: which steps before an update the Hessian is of.

    Returns:
        Distributions `[task, episode, time, action]`, of the steps of `post.every(*outer)`.
    """
    agents = start_agents(objective.context, parameters, objective.index, objective.statistics)
    is_small = objective.adaptation.policy is None and objective.context.is_pathwise
    move = _moved_contexts if is_small else _moved
    for experience, exact in zip(objective.pre, path[1:], strict=True):
        thinned = _thin(experience, inner)
        agents = move(objective, agents, parameters.step_sizes, thinned, exact)
    return agents.vmap(post_distributions)(objective.post.every(*outer))


def _moved(
    objective: MetaObjective,
    agents: Agents,
    sizes: StepSizes,
    thinned: Experience,
    exact: Agents,
) -> Agents:
    """Return the exact agents after an inner step, with its derivative on thinned episodes."""
    moved = _inner_step(objective, agents, sizes, thinned)
    # Exactly the value: x + 0.
    return jax.tree.map(lambda x, y: x + (y - jax.lax.stop_gradient(y)), exact, moved)


def _moved_contexts(
    objective: MetaObjective,
    agents: Agents,
    sizes: StepSizes,
    thinned: Experience,
    exact: Agents,
) -> Agents:
    """Return what `_moved` does, for contexts that move alone, along a gradient through the policy.

    A context has few components, so the few rows of its Jacobian are written down. Otherwise every
    product that the conjugate gradients ask for would run through the Hessian, there and back.
    """
    fixed, fixed_sizes = jax.lax.stop_gradient((agents, sizes))

    def jacobian_of(task: tuple[Any, Experience]) -> Float[Array, "context parameter"]:
        context, alone = jax.tree.map(lambda x: x[None], task)
        flat, unravel = ravel_pytree((fixed.policy, context, fixed_sizes))

        def moved(varied: Float[Array, " parameter"]) -> Float[Array, " context"]:
            policy, start, step_sizes = unravel(varied)
            agent = replace(fixed, policy=policy, context=start)
            return ravel_pytree(_inner_step(objective, agent, step_sizes, alone).context)[0]

        return jax.jacrev(moved)(flat)

    def linear(jacobian: Float[Array, "context parameter"], start: Any) -> Any:
        varied, _ = ravel_pytree((agents.policy, start, sizes))
        _, unravel = ravel_pytree(start)
        return unravel(multiply(jacobian, varied - jax.lax.stop_gradient(varied)))

    # Task by task: every row of a Jacobian takes as much memory as a gradient.
    jacobians = jax.lax.map(jacobian_of, (fixed.context, thinned))
    differences = jax.vmap(linear)(jacobians, agents.context)
    return replace(agents, context=jax.tree.map(jnp.add, exact.context, differences))


def _inner_step(
    objective: MetaObjective, agents: Agents, sizes: StepSizes, experience: Experience
) -> Agents:
    return objective.adaptation(agents, sizes, objective.context, *experience)


def _thin(experience: Experience, thinning: Thinning) -> Experience:
    episodes, advantages = experience
    return episodes.every(*thinning), advantages.every(*thinning)
