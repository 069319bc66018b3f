"""Discounted returns, advantages and masked statistics of one episode.

Time runs over t in [0, T-1]. `valid` marks the n <= T steps that were really played: t in [0, n-1].
What the arrays hold beyond them, NaN included, changes neither a result nor its gradient,
and every result is 0 there.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def discounted_returns(
    reward: Float[Array, "time"],
    valid: Bool[Array, "time"],
    discount: float | Float[Array, ""],
) -> Float[Array, "time"]:
    """Discounted return-to-go of every step.

        G_t = Σ_k γᵏ r_{t+k},  k in [0, n-1-t],   that is   G_t = r_t + γ G_{t+1},  G_n = 0

    Source: Sutton and Barto, "Reinforcement Learning" (2nd ed.), equation 3.11.

    Args:
        reward: r_t, t in [0, T-1], the reward for the action taken at step t.
        valid: true for t in [0, n-1].
        discount: γ in [0, 1].

    Returns:
        G_t for t in [0, n-1], then 0.
    """
    return _discounted_sum(jnp.where(valid, reward, 0.0), discount)


def generalized_advantages(
    reward: Float[Array, "time"],
    value: Float[Array, "time"],
    valid: Bool[Array, "time"],
    discount: float | Float[Array, ""],
    gae_lambda: float | Float[Array, ""],
) -> Float[Array, "time"]:
    """Generalised advantage estimates.

        δ_t = r_t + γ V_{t+1} - V_t
        A_t = δ_t + γλ A_{t+1},  A_n = 0,   for t in [0, n-1]

    where V_n = 0: there is no reward after the last valid step. With λ = 1, A_t = G_t - V_t; with
    λ = 0, A_t = δ_t.

    Source: Schulman et al., "High-dimensional continuous control using generalized advantage
    estimation" (2016), equations 11 to 16, https://arxiv.org/abs/1506.02438.

    Args:
        reward: r_t, t in [0, T-1], the reward for the action taken at step t.
        value: V_t, t in [0, T-1], estimated before the action of step t.
        valid: true for t in [0, n-1].
        discount: γ in [0, 1].
        gae_lambda: λ in [0, 1]; 0 trusts the values (bias), 1 the sampled rewards (variance).

    Returns:
        A_t for t in [0, n-1], then 0.
    """
    next_valid = jnp.roll(valid, -1).at[-1].set(False)
    next_value = jnp.where(next_valid, jnp.roll(value, -1), 0.0)
    difference = jnp.where(valid, reward + discount * next_value - value, 0.0)
    return _discounted_sum(difference, discount * gae_lambda)


def trial_advantages(
    reward: Float[Array, "time"],
    value: Float[Array, "time"],
    valid: Bool[Array, "time"],
    discount: float | Float[Array, ""],
    gae_lambda: float | Float[Array, ""],
) -> Float[Array, "time"]:
    """Generalised advantage estimates over a trial: several episodes, one behind the other.

    As `generalized_advantages`, but with gaps: an episode that ended early is followed by invalid
    steps, and then by the next episode. The recursion runs over the valid steps as if they were
    neighbours. So exploration in an early episode is credited with the rewards of later ones,
    discounted by the steps between (Duan et al. 2016, section 2.2).

    Args:
        reward: r_t, t in [0, T-1], over all episodes of the trial.
        value: V_t, estimated before the action of step t.
        valid: true where a step was played.
        discount: γ in [0, 1].
        gae_lambda: λ in [0, 1].

    Returns:
        A_t where valid, else 0.
    """

    def step(
        following: tuple[Float[Array, ""], Float[Array, ""]], now: tuple[Array, Array, Array]
    ) -> tuple[tuple[Float[Array, ""], Float[Array, ""]], Float[Array, ""]]:
        next_value, next_advantage = following
        gained, expected, is_valid = now
        delta = gained + discount * next_value - expected
        advantage = delta + discount * gae_lambda * next_advantage
        passed_on = (
            jnp.where(is_valid, expected, next_value),
            jnp.where(is_valid, advantage, next_advantage),
        )
        return passed_on, jnp.where(is_valid, advantage, 0.0)

    end = (jnp.zeros((), value.dtype), jnp.zeros((), value.dtype))
    _, advantages = jax.lax.scan(step, end, (reward, value, valid), reverse=True)
    return advantages


def masked_mean(values: Float[Array, "*shape"], valid: Bool[Array, "*shape"]) -> Float[Array, ""]:
    """Mean of the valid elements, Σ_i m_i x_i / Σ_i m_i.

    Args:
        values: x_i.
        valid: the mask m_i; where it is false, `values` is ignored.

    Returns:
        The mean; 0 where no element is valid.
    """
    total = jnp.sum(jnp.where(valid, values, 0.0))
    count = jnp.sum(valid, dtype=values.dtype)
    return total / jnp.maximum(count, 1.0)


def standardize(
    values: Float[Array, "*shape"],
    valid: Bool[Array, "*shape"],
    epsilon: float = 1e-8,
) -> Float[Array, "*shape"]:
    """Shift and scale the valid elements to mean 0 and (population) standard deviation 1.

        y_i = (x_i - mean(x)) / (std(x) + ε),  mean and std over the valid elements

    If all valid elements are equal, every result is 0 up to rounding.

    Args:
        values: x_i.
        valid: where it is false, `values` is ignored and the result is 0.
        epsilon: ε, in the unit of `values`. The default is the one of the reference
            implementation's advantages.
    """
    deviation = jnp.where(valid, values, 0.0) - masked_mean(values, valid)
    # The mean is rounded, so equal values leave a common deviation of the same size as their
    # standard deviation, and their quotient would be of order 1. Centring twice removes it.
    deviation = jnp.where(valid, deviation - masked_mean(deviation, valid), 0.0)
    variance = masked_mean(deviation**2, valid)
    # The derivative of sqrt at 0 is infinite, also in the branch that `where` does not select.
    is_spread = variance > 0.0
    std = jnp.where(is_spread, jnp.sqrt(jnp.where(is_spread, variance, 1.0)), 0.0)
    return deviation / (std + epsilon)


def _discounted_sum(
    terms: Float[Array, "time"], decay: float | Float[Array, ""]
) -> Float[Array, "time"]:
    """The recursion y_t = x_t + a y_{t+1} for t in [0, T-1], with y_T = 0."""

    def step(
        following: Float[Array, ""], term: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        current = term + decay * following
        return current, current

    _, sums = jax.lax.scan(step, jnp.zeros((), terms.dtype), terms, reverse=True)
    return sums
