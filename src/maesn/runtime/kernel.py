"""The kernel over latents, and how much of the returns it leaves unexplained."""

import numpy as np

from maesn.runtime.arrays import FloatArray

# Shares of the variance of the archive's returns that may be rough; the best of them is taken.
ROUGHNESS = np.geomspace(1e-4, 0.6, 20)


def roughness(kernel: FloatArray, centred: FloatArray) -> float:
    """Return the variance of the returns that near latents do not share: noise and jumps.

    The share of the variance that makes each latent's returns, predicted from those of all other
    latents, most probable (Rasmussen and Williams 2006, section 5.4.2).
    """
    spread = float((centred**2).mean())
    if not spread:
        return 0.0
    values, vectors = np.linalg.eigh(kernel)
    rotated, squares = vectors.T @ centred.T, vectors**2
    best, found = np.inf, 0.0
    for share in ROUGHNESS:
        inverse = 1.0 / (spread * ((1.0 - share) * np.maximum(values, 0.0) + share))
        precision = squares @ inverse
        error = (vectors @ (inverse[:, None] * rotated)) / precision[:, None]
        score = float((error**2 * precision[:, None]).mean() - np.log(precision).mean())
        if score < best:
            best, found = score, share * spread
    return found


def matern(first: FloatArray, second: FloatArray, length_scale: float) -> FloatArray:
    """Return the Matern kernel with nu = 5/2 and variance 1, `[first, second]`.

    With r the Euclidean distance over the length scale:
    k = (1 + sqrt(5) r + 5 r^2 / 3) exp(-sqrt(5) r)  (Rasmussen and Williams 2006, equation 4.17).
    """
    distance = np.linalg.norm(first[:, None] - second[None], axis=-1)
    # Beyond 1000 the exponential is 0, also where the distance is infinite.
    scaled = np.minimum(np.sqrt(5.0) * distance / length_scale, 1000.0)
    return (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
