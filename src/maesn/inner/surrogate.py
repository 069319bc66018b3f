"""Losses whose gradients are policy gradients: the inner and the outer one."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.context import AbstractContextSettings
from maesn.experience.agent import Agent
from maesn.experience.episodes import Episodes
from maesn.inner.advantage import Advantages
from maesn.numerics import AbstractDistribution, masked_mean


def inner_loss(
    agent: Agent, context: AbstractContextSettings[Any], episodes: Episodes, advantages: Advantages
) -> Float[Array, ""]:
    """REINFORCE on one task, with the draw of z as the zeroth action.

        L = -mean_{e,t}[log pi(a_t | o_t, z_e) A_t] - mean_e[log q(z_e) A_{e,0}]

    (Equations (4) to (6) of section "Meta-Learning Latent Variable Policies", with the likelihood
    ratio of section "Using the Latent Spaces for Exploration"; advantages as in the reference.)
    The gradient is taken with respect to the agent, which played the episodes before the step.
    """
    if context.is_pathwise:
        new = post_distributions(agent, episodes)
    else:
        # The z that were played. Drawn again from the noise, they would agree at the current
        # parameters, but not along the line search of the outer step.
        new = action_distributions(agent, episodes, episodes.z)
    log_prob = new.log_prob(_actions(episodes))
    action_loss = -masked_mean(log_prob * advantages.step, episodes.valid)
    return action_loss + context.draw_loss(agent.context, episodes.z, advantages.episode)


def outer_loss(
    new: AbstractDistribution, episodes: Episodes, advantages: Advantages
) -> Float[Array, ""]:
    """The likelihood-ratio surrogate of the return of one task's adapted agent.

        L = -mean_{e,t}[ pi'(a_t | o_t, z'_e) / pi_old(a_t | o_t, z_e) * A_t ]

    where z' is redrawn from the adapted context with the recorded noise (`post_distributions`).
    `new` are the distributions under the parameters that vary, `[episode, time, action]`; the
    adapted agent played the episodes.
    """
    return -masked_mean(_ratio(new, episodes) * advantages.step, episodes.valid)


def clipped_loss(
    new: AbstractDistribution, episodes: Episodes, advantages: Advantages, clip: float
) -> Float[Array, ""]:
    """The same with clipped probability ratios (PPO, Schulman et al. 2017, equation 7).

    L = -mean_{e,t}[ min(r A_t, clip(r, 1 - clip, 1 + clip) A_t) ]

    where r are the ratios.
    """
    ratio = _ratio(new, episodes)
    bounded = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)
    gain = jnp.minimum(ratio * advantages.step, bounded * advantages.step)
    return -masked_mean(gain, episodes.valid)


def post_distributions(agent: Agent, episodes: Episodes) -> AbstractDistribution:
    """Return the adapted agent's action distributions on its own episodes.

    The path through z is differentiable: z' = draw(adapted context, recorded noise).
    """
    drawn = jax.vmap(agent.context.draw)(episodes.noise, episodes.description)
    return action_distributions(agent, episodes, drawn)


def action_distributions(
    agent: Agent, episodes: Episodes, drawn: Float[Array, "episode z"]
) -> AbstractDistribution:
    """Return the policy's distribution at every step, `[episode, time, action]`, with these z."""
    inputs = agent.perceive(episodes.policy_inputs())
    trial = episodes.trial_start
    state = None if trial is None else trial.recurrent_state
    return agent.policy.unroll(inputs, episodes.valid, drawn, state)[0]


def _ratio(new: AbstractDistribution, episodes: Episodes) -> Float[Array, "episode time"]:
    """Return the probability of each action over the one it was drawn with; 1 where invalid."""
    actions = _actions(episodes)
    old_log_prob = episodes.behaviour.log_prob(actions)
    return jnp.exp(jnp.where(episodes.valid, new.log_prob(actions) - old_log_prob, 0.0))


def _actions(episodes: Episodes) -> Float[Array, "episode time action"]:
    return jnp.where(episodes.valid[..., None], episodes.action, 0.0)
