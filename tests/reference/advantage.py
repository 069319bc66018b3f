"""Returns, the linear baseline, and advantages of one task's episodes."""

from dataclasses import dataclass

import numpy as np

from reference.parameters import Array


@dataclass(frozen=True)
class Episode:
    """One episode of n steps."""

    observation: Array
    """`[n, observation]`."""
    action: Array
    """`[n, action]`."""
    reward: Array
    """`[n]`."""
    noise: Array
    """eps, the standard normal draw behind z."""
    latent: Array
    """z, as it was played."""
    mean: Array
    """Mean of the distribution that each action was drawn from, `[n, action]`."""
    log_std: Array
    """Its log standard deviation, `[n, action]`."""


@dataclass(frozen=True)
class Experience:
    """One task's episodes with their standardised advantages: data, never differentiated."""

    episodes: list[Episode]
    step_advantages: list[Array]
    """A_t, one array per episode."""
    episode_advantages: Array
    """A_0 of the draw of z, `[episode]`."""


@dataclass(frozen=True)
class AdvantageSettings:
    discount: float = 0.99
    gae_lambda: float = 1.0
    ridge: float = 1e-5


def discounted_returns(reward: Array, discount: float) -> Array:
    """Return G_t = sum_k discount^k r_{t+k}."""
    steps = len(reward)
    return np.array(
        [
            sum(discount ** (later - t) * reward[later] for later in range(t, steps))
            for t in range(steps)
        ]
    )


def features(observation: Array) -> Array:
    """Return o clipped to [-10, 10], its square, t/100, its square and cube, and 1, per step."""
    clipped = np.clip(observation, -10, 10)
    time = np.arange(len(observation))[:, None] / 100
    return np.hstack([clipped, clipped**2, time, time**2, time**3, np.ones_like(time)])


def fit_baseline(rows: Array, target: Array, ridge: float) -> Array:
    """Return argmin_w |target - rows w|^2 + ridge |w|^2, as least squares with extra rows."""
    size = rows.shape[1]
    extended = np.vstack([rows, np.sqrt(ridge) * np.eye(size)])
    return np.linalg.lstsq(extended, np.append(target, np.zeros(size)), rcond=None)[0]


def generalized_advantages(
    reward: Array, value: Array, discount: float, gae_lambda: float
) -> Array:
    """Return A_t = sum_k (discount gae_lambda)^k delta_{t+k}; no reward after the last step."""
    next_value = np.append(value[1:], 0.0)
    return discounted_returns(reward + discount * next_value - value, discount * gae_lambda)


def standardize(values: Array) -> Array:
    return (values - np.mean(values)) / (np.std(values) + 1e-8)


def experience(episodes: list[Episode], settings: AdvantageSettings) -> Experience:
    """Fit the baseline to one task's episodes and evaluate it on the same episodes."""
    returns = [discounted_returns(e.reward, settings.discount) for e in episodes]
    rows = np.vstack([features(e.observation) for e in episodes])
    coefficients = fit_baseline(rows, np.concatenate(returns), settings.ridge)
    values = [features(e.observation) @ coefficients for e in episodes]
    steps = [
        generalized_advantages(e.reward, value, settings.discount, settings.gae_lambda)
        for e, value in zip(episodes, values, strict=True)
    ]
    first = np.array([g[0] - value[0] for g, value in zip(returns, values, strict=True)])
    ends = np.cumsum([len(e.reward) for e in episodes])
    standardized = np.split(standardize(np.concatenate(steps)), ends[:-1])
    return Experience(episodes, standardized, standardize(first))
