"""The inner and the outer loss on problems whose gradients are known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.context import Latent, LatentContext
from maesn.experience.agent import Agent
from maesn.experience.episodes import Episodes
from maesn.inner.advantage import Advantages
from maesn.inner.surrogate import (
    action_distributions,
    inner_loss,
    outer_loss,
    post_distributions,
)
from maesn.networks.mlp import MLP, Linear
from maesn.numerics import DiagonalGaussian
from maesn.policies import GaussianMLPPolicy

# One step: z ~ N(MEAN, diag(STD^2)), a ~ N(w·z + b, s^2), and a reward -(a - c)^2. So
#     J = -(w·mean + b - c)^2 - sum_i w_i^2 std_i^2 - s^2,
#     dJ/dmean_i = -2 (w·mean + b - c) w_i   and   dJ/dlog std_i = -2 w_i^2 std_i^2.
WEIGHT, OFFSET, ACTION_STD, TARGET = np.array([1.5, -0.5]), 0.3, 0.6, 2.0
MEAN, STD = np.array([0.4, -0.2]), np.array([0.8, 1.2])
MEAN_GRADIENT = -2 * (WEIGHT @ MEAN + OFFSET - TARGET) * WEIGHT
LOG_STD_GRADIENT = -2 * WEIGHT**2 * STD**2
EPISODES = 400_000


def linear_agent() -> Agent:
    """The policy sees an observation too, but gives it no weight."""
    layer = Linear(jnp.asarray([[0.0], *WEIGHT[:, None]], float), jnp.asarray([OFFSET], float))
    policy = GaussianMLPPolicy(MLP((layer,)), jnp.asarray([np.log(ACTION_STD)], float))
    return Agent(policy, Latent(jnp.asarray(MEAN, float), jnp.asarray(np.log(STD), float)))


def one_step_episodes(agent: Agent, count: int) -> Episodes:
    """Play the problem, one step an episode."""
    noise_key, action_key = jax.random.split(jax.random.key(0))
    noise = jax.random.normal(noise_key, (count, 2))
    drawn = jax.vmap(agent.context.draw)(noise, jnp.zeros((len(noise), 0)))
    mean = drawn @ jnp.asarray(WEIGHT, float) + OFFSET
    action = mean + ACTION_STD * jax.random.normal(action_key, (count,))
    log_std = jnp.full((count, 1, 1), np.log(ACTION_STD), float)
    return Episodes(
        observation=jnp.ones((count, 2, 1)),
        action=action[:, None, None],
        reward=-((action - TARGET) ** 2)[:, None],
        goal_reward=jnp.zeros((count, 1)),
        valid=jnp.ones((count, 1), bool),
        solved=jnp.zeros((count, 1), bool),
        solved_at_start=jnp.zeros(count, bool),
        terminated=jnp.zeros(count, bool),
        noise=noise,
        description=jnp.zeros((len(noise), 0)),
        z=drawn,
        behaviour=DiagonalGaussian(mean[:, None, None], log_std),
        trial_end=None,
    )


@pytest.mark.parametrize("gradient", ["likelihood_ratio", "reparameterized"])
def test_both_inner_gradients_estimate_the_gradient_of_the_return(gradient: str) -> None:
    agent, context = linear_agent(), LatentContext(2, gradient=gradient)
    episodes = one_step_episodes(agent, EPISODES)

    @jax.jit
    @jax.vmap
    def ascent_per_episode(episode: Episodes) -> Latent:
        """Each episode alone estimates the gradient, so their spread tells the error."""
        # Less a constant baseline, which has no bias and cuts the variance.
        advantage = episode.reward[0] + 3.0
        advantages = Advantages(advantage[None, None], advantage[None])
        batch = jax.tree.map(lambda x: x[None], episode)
        slope = jax.grad(
            lambda value: inner_loss(Agent(agent.policy, value), context, batch, advantages)
        )(agent.context)
        return jax.tree.map(jnp.negative, slope)

    ascent = ascent_per_episode(episodes)
    for estimates, truth in ((ascent.mean, MEAN_GRADIENT), (ascent.log_std, LOG_STD_GRADIENT)):
        samples = np.float64(estimates)
        error = samples.std(axis=0) / np.sqrt(EPISODES)
        # Precise enough to tell the truth from zero, from half and from twice of it.
        assert (error < 0.05 * np.abs(truth)).all()
        np.testing.assert_array_less(np.abs(samples.mean(axis=0) - truth), 4 * error)


def test_the_likelihood_ratio_keeps_the_latent_that_was_played() -> None:
    # Elsewhere on the line search the latent has moved; what was played has not.
    agent = linear_agent()
    episodes = one_step_episodes(agent, 3)
    moved = Agent(agent.policy, Latent(agent.context.mean + 1.0, agent.context.log_std))
    advantages = Advantages(jnp.ones((3, 1)), jnp.zeros(3))
    for gradient, shift in (("likelihood_ratio", 0.0), ("reparameterized", 1.0)):
        context = LatentContext(2, gradient=gradient)
        new = action_distributions(moved, episodes, episodes.z + shift)
        wanted = -new.log_prob(episodes.action).mean()
        found = inner_loss(moved, context, episodes, advantages)
        np.testing.assert_allclose(found, wanted, rtol=1e-5)


def test_outer_loss_by_hand() -> None:
    # Densities of a unit Gaussian: moving the mean from 0 to 1/2 multiplies the density of action
    # x by exp(x/2 - 1/8); nothing is clipped. The step after the end counts for nothing.
    action = jnp.asarray([[[1.0], [-2.0]], [[6.0], [jnp.nan]]])
    old = DiagonalGaussian(jnp.asarray([[[0.0], [0.0]], [[0.0], [jnp.nan]]]), jnp.zeros((2, 2, 1)))
    new = DiagonalGaussian(jnp.full((2, 2, 1), 0.5), jnp.zeros((2, 2, 1)))
    episodes = one_step_episodes(linear_agent(), 2)
    episodes = eqx.tree_at(
        lambda e: (e.action, e.behaviour, e.valid),
        episodes,
        (action, old, jnp.asarray([[True, True], [True, False]])),
    )
    advantages = Advantages(jnp.asarray([[1.0, -0.5], [2.0, 0.0]]), jnp.zeros(2))
    ratios = np.exp(np.array([1.0, -2.0, 6.0]) / 2 - 1 / 8)
    expected = -(ratios @ np.array([1.0, -0.5, 2.0])) / 3
    np.testing.assert_allclose(jax.jit(outer_loss)(new, episodes, advantages), expected, rtol=1e-6)


def test_agents_that_have_not_moved_give_the_distributions_that_were_played() -> None:
    agent = linear_agent()
    episodes = one_step_episodes(agent, 5)
    again = jax.jit(post_distributions)(agent, episodes)
    np.testing.assert_allclose(again.mean, episodes.behaviour.mean, rtol=1e-5)
    np.testing.assert_allclose(again.log_std, episodes.behaviour.log_std, rtol=1e-6)
    np.testing.assert_allclose(episodes.behaviour.kl(again), 0.0, atol=1e-10)


def test_the_outer_loss_reaches_the_latent_through_the_redrawn_z() -> None:
    """d mean action/d mean = w and d mean action/d log std = w std eps."""
    agent = linear_agent()
    episodes = one_step_episodes(agent, 4)
    advantage = jnp.asarray([1.0, -0.5, 2.0, 0.3])
    advantages = Advantages(advantage[:, None], advantage)

    def loss(value: Latent) -> jax.Array:
        new = post_distributions(Agent(agent.policy, value), episodes)
        return outer_loss(new, episodes, advantages)

    slope = jax.jit(jax.grad(loss))(agent.context)
    deviation = np.asarray(episodes.action - episodes.behaviour.mean)[:, 0, 0]
    score = np.asarray(advantage) * deviation / ACTION_STD**2
    expected_mean = -np.mean(score) * WEIGHT
    expected_log_std = -np.mean(score[:, None] * STD * np.asarray(episodes.noise), 0) * WEIGHT
    np.testing.assert_allclose(slope.mean, expected_mean, rtol=1e-4)
    np.testing.assert_allclose(slope.log_std, expected_log_std, rtol=1e-4)
