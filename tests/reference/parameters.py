"""Meta-parameters as a dictionary of arrays, and as one flat vector.

| name                              | shape             | meaning                                  |
|-----------------------------------|-------------------|------------------------------------------|
| `weight_0`, `bias_0`, `weight_1`… | `[input, output]` | theta: the layers of the policy          |
| `log_std`                         | `[action]`        | theta: log standard deviation of actions |
| `latent_mean`, `latent_log_std`   | `[row, latent]`   | one Gaussian latent per training task    |
| `mean_step`, `log_std_step`       | `[latent]`        | step sizes of the inner update           |
"""

import numpy as np

Array = np.ndarray
Parameters = dict[str, Array]

LATENT_NAMES = ("latent_mean", "latent_log_std", "mean_step", "log_std_step")


def random_parameters(
    rng: np.random.Generator, sizes: tuple[int, ...], num_latents: int, num_rows: int
) -> Parameters:
    """Draw parameters that are nowhere special: no zeros, no two alike.

    Args:
        rng: source of randomness.
        sizes: widths of observation, hidden layers and action.
        num_latents: components of a latent.
        num_rows: number of training tasks.
    """
    inputs = (sizes[0] + num_latents, *sizes[1:-1])
    parameters = {}
    for layer, (width, outputs) in enumerate(zip(inputs, sizes[1:], strict=True)):
        parameters[f"weight_{layer}"] = rng.normal(size=(width, outputs)) / np.sqrt(width)
        parameters[f"bias_{layer}"] = 0.3 * rng.normal(size=outputs)
    parameters["log_std"] = -0.3 + 0.2 * rng.normal(size=sizes[-1])
    parameters["latent_mean"] = rng.normal(size=(num_rows, num_latents))
    parameters["latent_log_std"] = 0.3 * rng.normal(size=(num_rows, num_latents))
    parameters["mean_step"] = 0.5 + 0.2 * rng.normal(size=num_latents)
    parameters["log_std_step"] = 0.3 + 0.1 * rng.normal(size=num_latents)
    return parameters


def flatten(parameters: Parameters) -> Array:
    """Put all parameters into one vector."""
    return np.concatenate([array.ravel() for array in parameters.values()])


def unflatten(flat: Array, like: Parameters) -> Parameters:
    """Undo `flatten`: cut the vector into arrays of the shapes of `like`."""
    ends = np.cumsum([array.size for array in like.values()])
    pieces = np.split(flat, ends[:-1])
    return {
        name: piece.reshape(array.shape)
        for (name, array), piece in zip(like.items(), pieces, strict=True)
    }
