"""MAESN's inner update and outer problem.

Besides MAESN proper this covers its options: the reparameterised inner gradient, the inner update
of theta with a fixed step size, and several inner updates (one batch of experience for each).
"""

from dataclasses import dataclass

import numpy as np

from reference.advantage import Experience
from reference.parameters import Array, Parameters
from reference.policy import action_log_std, action_mean, divergence, log_density
from reference.policy import log_density_gradient as policy_gradient


@dataclass(frozen=True)
class Settings:
    kl_weight: float = 0.1
    gradient: str = "likelihood_ratio"
    theta_step: float = 0.0
    """Step size of theta in the inner update; 0 omits it."""


@dataclass(frozen=True)
class TaskData:
    """What was played in one task of the meta-batch."""

    row: int
    """The task's row in the table of latents."""
    pre: list[Experience]
    """One batch per inner update."""
    post: Experience
    """Played by the adapted agent."""


@dataclass(frozen=True)
class Agent:
    """Theta and one task's latent."""

    theta: Parameters
    mean: Array
    log_std: Array

    def draw(self, noise: Array) -> Array:
        return self.mean + np.exp(self.log_std) * noise


def likelihood_ratio_gradient(agent: Agent, played: Experience) -> tuple[Array, Array]:
    """Return mean_k A_k d log q(z_k), with respect to mean and log std of the latent."""
    variance = np.exp(2 * agent.log_std)
    mean_slope, log_std_slope = np.zeros_like(agent.mean), np.zeros_like(agent.mean)
    for episode, advantage in zip(played.episodes, played.episode_advantages, strict=True):
        deviation = episode.latent - agent.mean
        mean_slope += advantage * deviation / variance
        log_std_slope += advantage * (deviation**2 / variance - 1)
    count = len(played.episodes)
    return mean_slope / count, log_std_slope / count


def pathwise_gradient(
    agent: Agent, played: Experience, *, redrawn: bool
) -> tuple[Parameters, Array, Array]:
    """Return mean_t A_t d log pi(a_t | o_t, z) with respect to theta, mean and log std.

    Args:
        agent: where the derivative is taken.
        played: the task's episodes.
        redrawn: whether z is mean + std eps with the recorded eps, or the recorded z.
    """
    theta = {name: np.zeros_like(array) for name, array in agent.theta.items()}
    mean_slope, log_std_slope = np.zeros_like(agent.mean), np.zeros_like(agent.mean)
    count = sum(len(advantage) for advantage in played.step_advantages)
    for episode, advantage in zip(played.episodes, played.step_advantages, strict=True):
        latent = agent.draw(episode.noise) if redrawn else episode.latent
        theta_slope, latent_slope = policy_gradient(
            agent.theta, episode.observation, latent, episode.action, advantage / count
        )
        for name, slope in theta_slope.items():
            theta[name] += slope
        mean_slope += latent_slope
        log_std_slope += latent_slope * np.exp(agent.log_std) * episode.noise
    return theta, mean_slope, log_std_slope


def inner_update(
    agent: Agent, mean_step: Array, log_std_step: Array, played: Experience, settings: Settings
) -> Agent:
    """Move theta, mean and log std one step up their policy gradients."""
    redrawn = settings.gradient == "reparameterized"
    theta_slope, mean_slope, log_std_slope = pathwise_gradient(agent, played, redrawn=redrawn)
    if not redrawn:
        mean_slope, log_std_slope = likelihood_ratio_gradient(agent, played)
    theta = {name: x + settings.theta_step * theta_slope[name] for name, x in agent.theta.items()}
    return Agent(
        theta, agent.mean + mean_step * mean_slope, agent.log_std + log_std_step * log_std_slope
    )


def start(parameters: Parameters, row: int) -> Agent:
    """Return the pre-update agent of one training task."""
    theta = {
        name: array
        for name, array in parameters.items()
        if name.startswith(("weight_", "bias_")) or name == "log_std"
    }
    return Agent(theta, parameters["latent_mean"][row], parameters["latent_log_std"][row])


def adapted(parameters: Parameters, task: TaskData, settings: Settings) -> Agent:
    """Return the agent after all inner updates, with the stored experience."""
    agent = start(parameters, task.row)
    for played in task.pre:
        agent = inner_update(
            agent, parameters["mean_step"], parameters["log_std_step"], played, settings
        )
    return agent


def task_loss(parameters: Parameters, task: TaskData, settings: Settings) -> float:
    """Return -mean_t[ratio_t A_t] + kl_weight KL(pre-update latent || N(0, I)).

    The ratio is over actions alone; z' is redrawn with the recorded eps.
    """
    agent = adapted(parameters, task, settings)
    gains = []
    for episode, advantage in zip(task.post.episodes, task.post.step_advantages, strict=True):
        mean = action_mean(agent.theta, episode.observation, agent.draw(episode.noise))
        new = log_density(episode.action, mean, action_log_std(agent.theta))
        old = log_density(episode.action, episode.mean, episode.log_std)
        gains.append(np.exp(new - old) * advantage)
    before = start(parameters, task.row)
    zeros = np.zeros_like(before.mean)
    penalty = divergence(before.mean, before.log_std, zeros, zeros)
    return -np.mean(np.concatenate(gains)) + settings.kl_weight * penalty


def loss(parameters: Parameters, tasks: list[TaskData], settings: Settings) -> float:
    """Return the mean loss of the meta-batch."""
    return np.mean([task_loss(parameters, task, settings) for task in tasks])


def mean_kl(parameters: Parameters, tasks: list[TaskData], settings: Settings) -> float:
    """Return KL(played || new), averaged over each task's steps and then over tasks.

    Tasks weigh the same as in the loss. (The code behind the published curves averages over all
    steps at once. The two agree where all tasks have played equally many steps.)
    """
    averages = []
    for task in tasks:
        agent = adapted(parameters, task, settings)
        log_std = action_log_std(agent.theta)
        steps = []
        for episode in task.post.episodes:
            mean = action_mean(agent.theta, episode.observation, agent.draw(episode.noise))
            steps.append(divergence(episode.mean, episode.log_std, mean, log_std))
        averages.append(np.mean(np.concatenate(steps)))
    return np.mean(averages)
