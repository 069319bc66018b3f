"""Advantages: a linear value function fitted per task, and generalised advantage estimation."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.experience.episodes import Episodes, Thinning
from maesn.numerics import (
    discounted_returns,
    generalized_advantages,
    multiply,
    ridge_regression,
    standardize,
)
from maesn.numerics.tasks import map_tasks
from maesn.runtime.baseline import FEATURE_CLIP, FEATURE_TIME_SCALE
from maesn.settings import check_number, check_positive


class Advantages(eqx.Module):
    """Advantages of one task's episodes, standardised over the task."""

    step: Float[Array, "*batch episode time"]
    """A_t of every action; 0 where invalid."""
    episode: Float[Array, "*batch episode"]
    """A_0 of the draw of z, the zeroth action of the episode."""

    def every(self, stride: int, offset: int | Array) -> "Advantages":
        """Return the advantages of the steps that `Episodes.every` returns."""
        return Advantages(Thinning(stride, offset).take(self.step, -1), self.episode)


class AdvantageEstimator(eqx.Module):
    """Generalised advantage estimation with a linear value function.

    The value function is fitted anew to each task's batch, by ridge regression of the discounted
    returns on rllab's features. It keeps no state. Default values follow the reference.
    """

    discount: float = 0.99
    """Discount factor gamma of the rewards."""
    gae_lambda: float = 1.0
    """Lambda of generalised advantage estimation. 1: the advantage is return minus value."""
    ridge: float = 1e-5
    """Weight of the penalty on squared coefficients in the fit of the value function."""
    drifts: bool = False
    """Whether to learn from a task's episodes if all of them have the same rewards. Reference: yes.

    Such episodes do not tell good actions from bad ones. But the value function does not fit
    them exactly, and standardised advantages make its small errors large: a trust region step then
    has its full length, in a random direction. If all rewards are 0, the fit is exact and nothing
    moves."""

    def __check_init__(self) -> None:
        check_number("discount", self.discount, 0, 1)
        check_number("gae_lambda", self.gae_lambda, 0, 1)
        check_positive(self, "ridge")

    def __call__(self, episodes: Episodes) -> Advantages:
        """Return the advantages of one task, from its episodes `[episode, time, ...]`.

        The episode's advantage is the discounted return minus the value at t = 0, standardised
        over the task's episodes; the steps' advantages are standardised over all valid steps.
        All advantages are 0 where all of several episodes have the same rewards (a sparse reward
        without control costs, before the goal is found), unless the estimator `drifts`.
        """
        reward = jnp.where(episodes.valid, episodes.reward, 0.0)
        returns = jax.vmap(discounted_returns, in_axes=(0, 0, None))(
            reward, episodes.valid, self.discount
        )
        value = self._fitted_values(episodes, returns)
        # The value after the last step is 0: an episode that ran out of time counts as complete.
        step = jax.vmap(generalized_advantages, in_axes=(0, 0, 0, None, None))(
            reward, value, episodes.valid, self.discount, self.gae_lambda
        )
        episode = returns[:, 0] - value[:, 0]
        informative = self.drifts | _rewards_differ(reward)
        every_episode = jnp.ones_like(episode, dtype=bool)
        return Advantages(
            step=jnp.where(informative, standardize(step, episodes.valid), 0.0),
            episode=jnp.where(informative, standardize(episode, every_episode), 0.0),
        )

    def of_tasks(self, episodes: Episodes) -> Advantages:
        """Return the advantages of every task, `[task, ...]`."""
        # Not by `vmap`: on the CPU, XLA hangs in batched products of some sizes (25 tasks, 5000
        # steps and 56 features, with jaxlib 0.10.2).
        advantages: Advantages = map_tasks(self, episodes, how="serial")
        return advantages

    def _fitted_values(
        self, episodes: Episodes, returns: Float[Array, "episode time"]
    ) -> Float[Array, "episode time"]:
        features = _features(episodes.observation[:, : returns.shape[1]], episodes.valid)
        rows = features.reshape(-1, features.shape[-1])
        weight = episodes.valid.reshape(-1).astype(rows.dtype)
        coefficients = ridge_regression(rows, returns.reshape(-1), weight, self.ridge)
        return multiply(features, coefficients)


def _rewards_differ(reward: Float[Array, "episode time"]) -> Bool[Array, ""]:
    """Whether some episode's rewards differ from those of the first. Invalid steps hold 0.

    True for a single episode, whose steps can be compared with each other.
    """
    return jnp.any(reward != reward[:1]) | (reward.shape[0] == 1)


def _features(
    observation: Float[Array, "episode time observation"], valid: Bool[Array, "episode time"]
) -> Float[Array, "episode time feature"]:
    """Return [o, o^2, t, t^2, t^3, 1] with o clipped and t in hundreds of steps."""
    clipped = jnp.clip(observation, -FEATURE_CLIP, FEATURE_CLIP)
    clipped = jnp.where(valid[..., None], clipped, 0.0)
    time = jnp.arange(valid.shape[1], dtype=clipped.dtype) / FEATURE_TIME_SCALE
    powers = jnp.stack([time, time**2, time**3, jnp.ones_like(time)], axis=-1)
    powers = jnp.broadcast_to(powers, (*valid.shape, 4))
    return jnp.concatenate([clipped, clipped**2, powers], axis=-1)
