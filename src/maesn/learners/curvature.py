"""The distributions whose Fisher information is the curvature of the outer step."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from maesn.adaptation import StepSizes
from maesn.agent import Agents
from maesn.axes import Key
from maesn.learners.objective import Experience, MetaObjective, MetaParameters, start_agents
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
    moves_context_alone = objective.adaptation.policy is None and objective.context.is_pathwise
    take_step = _step_of_few if moves_context_alone else _step
    for experience in objective.pre:
        agents = take_step(objective, agents, parameters.step_sizes, experience, inner)
    return agents.vmap(post_distributions)(objective.post.every(*outer))


def _step(
    objective: MetaObjective,
    agents: Agents,
    sizes: StepSizes,
    experience: Experience,
    inner: Thinning,
) -> Agents:
    """Return the agents after an inner step, whose derivative is one on the thinned episodes."""
    episodes, advantages = experience
    step = partial(objective.adaptation, context=objective.context)
    thinned, judged = episodes.every(*inner), advantages.every(*inner)
    derivative = step(agents, sizes, episodes=thinned, advantages=judged)
    fixed_agents, fixed_sizes = jax.lax.stop_gradient((agents, sizes))
    value = step(fixed_agents, fixed_sizes, episodes=episodes, advantages=advantages)
    return jax.tree.map(
        # Exactly the value: x + 0.
        lambda x, y: x + (y - jax.lax.stop_gradient(y)),
        value,
        derivative,
    )


def _step_of_few(
    objective: MetaObjective,
    agents: Agents,
    sizes: StepSizes,
    experience: Experience,
    inner: Thinning,
) -> Agents:
    """Return the same where a context moves alone: its Jacobian is written down, once.

    It has as many rows as a context has components. Otherwise every product that the conjugate
    gradients ask for would run through the Hessian, forwards and backwards.
    """
    episodes, advantages = experience
    step = partial(objective.adaptation, context=objective.context)
    fixed, fixed_sizes = jax.lax.stop_gradient((agents, sizes))
    value = step(fixed, fixed_sizes, episodes=episodes, advantages=advantages).context

    def jacobian(task: Any) -> Float[Array, "context parameter"]:
        context, played, judged = jax.tree.map(lambda x: x[None], task)
        flat, unravel = ravel_pytree((fixed.policy, context, fixed_sizes))

        def moved(varied: Float[Array, " parameter"]) -> Float[Array, " context"]:
            policy, start, step_sizes = unravel(varied)
            agent = replace(fixed, policy=policy, context=start)
            after = step(agent, step_sizes, episodes=played, advantages=judged)
            return ravel_pytree(after.context)[0]

        return jax.jacrev(moved)(flat)

    def vary(jacobian: Float[Array, "context parameter"], start: Any, value: Any) -> Any:
        varied, _ = ravel_pytree((agents.policy, start, sizes))
        flat, unravel = ravel_pytree(value)
        return unravel(flat + jacobian @ (varied - jax.lax.stop_gradient(varied)))

    # Task by task: a row of the Jacobian takes as much memory as a gradient.
    jacobians = jax.lax.map(
        jacobian, (fixed.context, episodes.every(*inner), advantages.every(*inner))
    )
    return replace(agents, context=jax.vmap(vary)(jacobians, agents.context, value))
