"""The Gaussian policy: forward, backward, log-density and divergence."""

import numpy as np

from reference.parameters import Array, Parameters

MINIMUM_LOG_STD = np.log(1e-6)


def num_layers(parameters: Parameters) -> int:
    return sum(name.startswith("weight_") for name in parameters)


def layer_inputs(parameters: Parameters, observation: Array, latent: Array) -> list[Array]:
    """Return what enters each layer, and last what leaves the network.

    The latent is appended to every observation; hidden layers are rectified, the output is not.

    Args:
        parameters: supplies the layers.
        observation: `[time, observation]`.
        latent: z, constant during the episode.
    """
    latents = np.tile(latent, (len(observation), 1))
    values = [np.concatenate([observation, latents], axis=1)]
    last = num_layers(parameters) - 1
    for layer in range(last + 1):
        value = values[-1] @ parameters[f"weight_{layer}"] + parameters[f"bias_{layer}"]
        values.append(value if layer == last else np.where(value > 0, value, 0.0))
    return values


def action_mean(parameters: Parameters, observation: Array, latent: Array) -> Array:
    """Return the mean action of every step, `[time, action]`."""
    return layer_inputs(parameters, observation, latent)[-1]


def action_log_std(parameters: Parameters) -> Array:
    """Return the log standard deviation of every action component, not below log(1e-6)."""
    return np.where(parameters["log_std"] > MINIMUM_LOG_STD, parameters["log_std"], MINIMUM_LOG_STD)


def log_density(value: Array, mean: Array, log_std: Array) -> Array:
    """Return log N(value; mean, exp(log_std)^2), summed over the last axis."""
    squares = (value - mean) ** 2 / np.exp(log_std) ** 2
    return np.sum(-squares / 2 - log_std - np.log(2 * np.pi) / 2, axis=-1)


def divergence(mean: Array, log_std: Array, other_mean: Array, other_log_std: Array) -> Array:
    """Return KL(N(mean, std^2) || N(other_mean, other_std^2)), summed over the last axis."""
    variance, other_variance = np.exp(2 * log_std), np.exp(2 * other_log_std)
    ratio = (variance + (mean - other_mean) ** 2) / (2 * other_variance)
    return np.sum(other_log_std - log_std + ratio - 0.5, axis=-1)


def log_density_gradient(
    parameters: Parameters, observation: Array, latent: Array, action: Array, weight: Array
) -> tuple[Parameters, Array]:
    """Differentiate sum_t weight_t log pi(a_t | o_t, z) by the chain rule, layer by layer.

    Valid while no log standard deviation lies on its floor.

    Returns:
        The derivative with respect to theta, by name, and with respect to z.
    """
    values = layer_inputs(parameters, observation, latent)
    variance = np.exp(2 * action_log_std(parameters))
    deviation = action - values[-1]
    slope = weight[:, None] * deviation / variance
    theta = {"log_std": np.sum(weight[:, None] * (deviation**2 / variance - 1), axis=0)}
    for layer in reversed(range(num_layers(parameters))):
        theta[f"weight_{layer}"] = values[layer].T @ slope
        theta[f"bias_{layer}"] = slope.sum(axis=0)
        slope = slope @ parameters[f"weight_{layer}"].T
        if layer > 0:
            slope = slope * (values[layer] > 0)
    return theta, slope[:, observation.shape[1] :].sum(axis=0)
