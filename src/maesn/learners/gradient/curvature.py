"""The distributions whose Fisher information is the curvature of the outer step."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from maesn.experience.agent import Agent, Agents
from maesn.experience.episodes import Episodes, Thinning
from maesn.inner.adaptation import StepSizes
from maesn.inner.surrogate import post_distributions
from maesn.learners.gradient.objective import Experience, MetaObjective, MetaParameters
from maesn.numerics import AbstractDistribution, multiply
from maesn.numerics.mesh import num_shards
from maesn.numerics.tasks import map_tasks


def sampled_distributions(
    objective: MetaObjective,
    parameters: MetaParameters,
    updated: tuple[Agents, ...],
    outer: Thinning,
    inner: Thinning,
) -> AbstractDistribution:
    """Return the adapted agents' action distributions at some of their steps, for J'FJ.

    Their values are exact. Their derivative with respect to `parameters` takes the inner updates'
    own derivative, above all the Hessian of the inner loss, from some of the steps before them:

        J = dpi/d(adapted) (I - step size * H),  H ~ mean over sampled steps of the Hessian

    With strides of 1 all is exact. Inner updates that depend on whole episodes alone, such as that
    of a latent by likelihood ratio, are exact with any stride.

    The derivative by the step sizes, which is the gradient, is of the same sample as the Hessian,
    although the exact one is at hand: weights and step sizes that undo each other, as those of a
    bias do, then undo each other in J too. Mixing the two has made all steps fail on a small
    problem (`tests/learners/test_presets.py`).

    Args:
        objective: the problem.
        parameters: what the distributions are differentiated with respect to.
        updated: `objective.updated(parameters)`, the exact values. They are not differentiated, so
            that those who played will do, and need not be computed again.
        outer: which steps after the last update the distributions are of.
        inner: which steps before an update the Hessian is of.

    Returns:
        Distributions `[task, episode, time, action]`, of the steps of `post.every(*outer)`.
    """
    agents = objective.start(parameters)
    is_small = objective.adaptation.policy is None and objective.context.is_pathwise
    move = _moved_contexts if is_small else _moved
    exact_stages = jax.lax.stop_gradient(updated)
    for (episodes, advantages), exact in zip(objective.pre, exact_stages, strict=True):
        thinned = episodes.every(*inner), advantages.every(*inner)
        agents = move(objective, agents, parameters.step_sizes, thinned, exact)
    return agents.map(post_distributions, objective.post.every(*outer), how="vmap")


def step_weights(episodes: Episodes) -> Float[Array, "task episode time"]:
    """Return the weight of each step in a mean over all tasks of means over valid steps."""
    valid = episodes.valid.astype(float)
    per_task = jnp.maximum(valid.sum((1, 2), keepdims=True), 1.0)
    return valid / (per_task * valid.shape[0] * num_shards())


def _moved(
    objective: MetaObjective,
    agents: Agents,
    sizes: StepSizes,
    thinned: Experience,
    exact: Agents,
) -> Agents:
    """Return `exact`, with the derivative that an inner update has on the thinned episodes."""
    moved = objective.adaptation(agents, sizes, objective.context, *thinned)
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

    def jacobian_of(agent: Agent, *experience: Any) -> Float[Array, "context parameter"]:
        flat, unravel = ravel_pytree((agent.policy, agent.context, fixed_sizes))

        def moved(varied: Float[Array, " parameter"]) -> Float[Array, " context"]:
            policy, start, step_sizes = unravel(varied)
            _, context = objective.adaptation.moved_parts(
                replace(agent, policy=policy, context=start),
                step_sizes,
                objective.context,
                *experience,
            )
            return ravel_pytree(context)[0]

        return jax.jacrev(moved)(flat)

    def linear(jacobian: Float[Array, "context parameter"], start: Any) -> Any:
        varied, _ = ravel_pytree((agents.policy, start, sizes))
        _, unravel = ravel_pytree(start)
        return unravel(multiply(jacobian, varied - jax.lax.stop_gradient(varied)))

    # One task after the other: every row of a Jacobian takes as much memory as a gradient.
    jacobians = fixed.map(jacobian_of, *thinned)
    differences = map_tasks(linear, jacobians, agents.context, how="vmap")
    return replace(agents, context=jax.tree.map(jnp.add, exact.context, differences))
