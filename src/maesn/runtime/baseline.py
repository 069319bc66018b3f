"""From recorded episodes to the advantages of their draws of z, in double precision.

The mathematics of `maesn.inner.advantage`, for episodes of any lengths. Only the advantage of the
first step is needed here, because the policy's weights stay as they are.
"""

from collections.abc import Sequence

import numpy as np

from maesn.runtime.arrays import FloatArray

# Range that observations are clipped to, and number of steps that t is divided by: those of the
# reference's linear feature baseline.
FEATURE_CLIP = 10.0
FEATURE_TIME_SCALE = 100.0
# Added to the standard deviation that advantages are divided by, from the reference.
STANDARDIZE_EPSILON = 1e-8


def episode_advantages(
    observations: Sequence[FloatArray], rewards: Sequence[FloatArray], discount: float, ridge: float
) -> FloatArray:
    """Return the standardised advantage of the draw of z in every episode, `[episode]`.

        A_e = (G_{e,0} - V(o_{e,0}) - mean) / (std + 1e-8),  e in [1, E]

    with V fitted by ridge regression of the discounted returns on `features`, over all steps of
    all episodes; mean and std run over the E episodes. Where all episodes have the same rewards
    there is nothing to learn, and A is 0. Observations are `[time, observation]`, rewards `[time]`.
    """
    if not _rewards_differ(rewards):
        return np.zeros(len(rewards))
    returns = [discounted_returns(reward, discount) for reward in rewards]
    rows = [features(observation) for observation in observations]
    coefficients = ridge_regression(np.concatenate(rows), np.concatenate(returns), ridge)
    first = [g[0] - row[0] @ coefficients for g, row in zip(returns, rows, strict=True)]
    return standardize(np.asarray(first))


def _rewards_differ(rewards: Sequence[FloatArray]) -> bool:
    """Whether some episode's rewards differ from the first one's; short ones have 0 later."""
    longest = max(len(reward) for reward in rewards)
    padded = [np.pad(reward, (0, longest - len(reward))) for reward in rewards]
    return any(np.any(reward != padded[0]) for reward in padded)


def discounted_returns(reward: FloatArray, discount: float) -> FloatArray:
    """Return G_t = r_t + gamma G_{t+1}, with G_T = 0, for t in [0, T-1]."""
    returns = np.empty_like(reward)
    following = 0.0
    for step in range(reward.shape[0] - 1, -1, -1):
        following = reward[step] + discount * following
        returns[step] = following
    return returns


def features(observation: FloatArray) -> FloatArray:
    """Return [o, o^2, t, t^2, t^3, 1] of one episode, with o clipped and t in hundreds of steps."""
    clipped = np.clip(observation, -FEATURE_CLIP, FEATURE_CLIP)
    time = np.arange(observation.shape[0]) / FEATURE_TIME_SCALE
    powers = np.stack([time, time**2, time**3, np.ones_like(time)], axis=-1)
    return np.concatenate([clipped, clipped**2, powers], axis=-1)


def ridge_regression(rows: FloatArray, target: FloatArray, ridge: float) -> FloatArray:
    """Return argmin_w sum_n (y_n - x_n w)^2 + ridge |w|^2, with rows x_n `[row, feature]`.

    Solved as the least squares problem [X; sqrt(ridge) I] w = [y; 0]. That avoids X'X, whose
    condition number is the square of that of X.
    """
    size = rows.shape[1]
    matrix = np.concatenate([rows, np.sqrt(ridge) * np.eye(size)])
    solution, *_ = np.linalg.lstsq(matrix, np.concatenate([target, np.zeros(size)]), rcond=None)
    return solution


def standardize(values: FloatArray) -> FloatArray:
    """Shift and scale to mean 0 and (population) standard deviation 1."""
    deviation = values - values.mean()
    deviation -= deviation.mean()  # so that equal values give 0 in spite of the mean's rounding
    return deviation / (deviation.std() + STANDARDIZE_EPSILON)
