"""The distributions whose Fisher information is the curvature of the outer step."""

from functools import partial
from typing import NamedTuple

import jax
from jaxtyping import Array, Int

from maesn.agent import Agents
from maesn.axes import Key
from maesn.learners.objective import MetaObjective, MetaParameters, start_agents
from maesn.numerics import AbstractDistribution
from maesn.surrogate import post_distributions


class Thinning(NamedTuple):
    """Every `stride`-th time step of an episode, from the one at `offset` on."""

    stride: int
    offset: int | Int[Array, ""]

    @staticmethod
    def draw(key: Key, stride: int, time: int) -> "Thinning":
        """Return a thinning of `time` steps, with which every step can be drawn."""
        stride = min(stride, time)
        # Also where the stride does not divide the horizon.
        return Thinning(stride, jax.random.randint(key, (), 0, stride + time % stride))


def sampled_distributions(
    objective: MetaObjective, parameters: MetaParameters, outer: Thinning, inner: Thinning
) -> AbstractDistribution:
    """Return the adapted agents' action distributions at some of their steps, for J'FJ.

    Their values are exact. Their derivative with respect to `parameters` takes the inner steps'
    own derivative, the Hessian of the inner loss, from some of the steps before the update alone:

        J = dpi/d(adapted) (I - step size * H),  H ~ mean over sampled steps of the Hessian

    With strides of 1 all is exact. Inner steps that depend on whole episodes alone, such as that
    of a latent by likelihood ratio, are exact with any stride.

    Args:
        objective: the problem; all its steps are used for the values of the inner updates.
        parameters: what the distributions are differentiated with respect to.
        outer: which steps after the last update the distributions are of.
        inner: which steps before an update the Hessian is of.

    Returns:
        Distributions `[task, episode, time, action]`, of the steps of `post.every(*outer)`.
    """
    agents = start_agents(objective.context, parameters, objective.index, objective.statistics)
    for episodes, advantages in objective.pre:
        step = partial(objective.adaptation, context=objective.context)
        sampled = step(
            agents,
            parameters.step_sizes,
            episodes=episodes.every(*inner),
            advantages=advantages.every(*inner),
        )
        fixed_agents, fixed_sizes = jax.lax.stop_gradient((agents, parameters.step_sizes))
        exact = step(fixed_agents, fixed_sizes, episodes=episodes, advantages=advantages)
        agents = _with_derivative(exact, sampled)
    return agents.vmap(post_distributions)(objective.post.every(*outer))


def _with_derivative(value: Agents, derivative: Agents) -> Agents:
    """Return the first agents, which vary with the parameters as the second ones do."""
    return jax.tree.map(
        # Exactly the value: x + 0.
        lambda x, y: x + (y - jax.lax.stop_gradient(y)),
        value,
        derivative,
    )
