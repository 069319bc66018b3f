"""One task from scratch: REINFORCE and TRPO on the policy's weights."""

import numpy as np

from reference.advantage import Experience
from reference.maesn import Settings, TaskData
from reference.parameters import Parameters
from reference.policy import log_density_gradient
from reference.trust_region import Outcome, TrustRegionSettings, outer_step

NO_LATENT = {
    "latent_mean": np.zeros((1, 0)),
    "latent_log_std": np.zeros((1, 0)),
    "mean_step": np.zeros(0),
    "log_std_step": np.zeros(0),
}


def reinforce_step(theta: Parameters, played: Experience, step_size: float) -> Parameters:
    """Return theta + step_size * mean over all steps of A_t d log pi(a_t | o_t, z) / d theta."""
    steps = sum(len(episode.reward) for episode in played.episodes)
    moved = {name: array.copy() for name, array in theta.items()}
    for episode, advantage in zip(played.episodes, played.step_advantages, strict=True):
        slope, _ = log_density_gradient(
            theta, episode.observation, episode.latent, episode.action, advantage / steps
        )
        for name in moved:
            moved[name] = moved[name] + step_size * slope[name]
    return moved


def trpo_step(theta: Parameters, played: Experience, region: TrustRegionSettings) -> Outcome:
    """Return the outer step of a MAESN that has one task, no latent and no inner update."""
    return outer_step({**theta, **NO_LATENT}, [TaskData(0, [], played)], Settings(0.0), region)
