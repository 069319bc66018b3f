"""The distributions whose Fisher information is the curvature of the outer step."""

from functools import partial

import jax
from jaxtyping import Array, Int

from maesn.agent import Agents
from maesn.learners.objective import MetaObjective, MetaParameters, start_agents
from maesn.numerics import AbstractDistribution
from maesn.surrogate import post_distributions


def sampled_distributions(
    objective: MetaObjective,
    parameters: MetaParameters,
    stride: int,
    offset: int | Int[Array, ""],
) -> AbstractDistribution:
    """Return the adapted agents' action distributions at every `stride`-th step, for J'FJ.

    Their values are exact. Their derivative with respect to `parameters` takes the inner steps'
    own derivative, the Hessian of the inner loss, from every `stride`-th step of the episodes
    before the update too:

        J = dpi/d(adapted) (I - step size * H),  H ~ mean over sampled steps of the Hessian

    With a stride of 1 all is exact. Inner steps that depend on whole episodes alone, such as that
    of a latent by likelihood ratio, are exact with any stride.

    Args:
        objective: the problem; all its steps are used for the values of the inner updates.
        parameters: what the distributions are differentiated with respect to.
        stride: one of so many time steps is used.
        offset: the first step, as `Episodes.every` takes it.

    Returns:
        Distributions `[task, episode, time, action]`, of the steps of `post.every(stride, offset)`.
    """
    agents = start_agents(objective.context, parameters, objective.index, objective.statistics)
    for episodes, advantages in objective.pre:
        step = partial(objective.adaptation, context=objective.context)
        sampled = step(
            agents,
            parameters.step_sizes,
            episodes=episodes.every(stride, offset),
            advantages=advantages.every(stride, offset),
        )
        fixed_agents, fixed_sizes = jax.lax.stop_gradient((agents, parameters.step_sizes))
        exact = step(fixed_agents, fixed_sizes, episodes=episodes, advantages=advantages)
        agents = _with_derivative(exact, sampled)
    return agents.vmap(post_distributions)(objective.post.every(stride, offset))


def _with_derivative(value: Agents, derivative: Agents) -> Agents:
    """Return the first agents, which vary with the parameters as the second ones do."""
    return jax.tree.map(
        # Exactly the value: x + 0.
        lambda x, y: x + (y - jax.lax.stop_gradient(y)),
        value,
        derivative,
    )
