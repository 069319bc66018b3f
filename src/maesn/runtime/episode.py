"""Episodes as a robot records them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

import numpy as np

from maesn.runtime.arrays import Arrays, FloatArray, take

Purpose: TypeAlias = Literal["explore", "deploy"]
"""`explore`: played to be learned from. `deploy`: played with z at the latent's mean, and judged
only."""
PURPOSES: tuple[Purpose, ...] = get_args(Purpose)

_STEPS = ("observations", "actions", "controls")

LARGEST_REWARD = 1e100
"""The squares of larger ones, summed over many steps, are beyond double precision."""


def refuse_large(rewards: FloatArray) -> None:
    """Raise ValueError if some reward is beyond `LARGEST_REWARD`."""
    size = float(np.abs(rewards).max(initial=0.0))
    if size > LARGEST_REWARD:
        raise ValueError(
            f"`rewards` must be at most {LARGEST_REWARD:g} in size, got {size:g}. Nothing was "
            "recorded: give them in a larger unit."
        )


@dataclass(frozen=True)
class Episode:
    """A finished episode of T steps.

    Attributes:
        latent: z, the same at all steps, `[latent]`.
        observations: o_t before each action, t in [0, T-1], `[time, observation]`.
        actions: the policy's own, unbounded actions, `[time, action]`.
        controls: what was executed, in the actuators' unit, `[time, action]`.
        rewards: r_t of the step that began at o_t, `[time]`.
    """

    latent: FloatArray
    observations: FloatArray
    actions: FloatArray
    controls: FloatArray
    rewards: FloatArray

    def __post_init__(self) -> None:
        refuse_large(self.rewards)

    @property
    def undiscounted_return(self) -> float:
        """sum_t r_t."""
        return float(self.rewards.sum())


@dataclass
class RunningEpisode:
    """The episode that is being played."""

    latent: FloatArray
    purpose: Purpose = "explore"
    observations: list[FloatArray] = field(default_factory=list)
    actions: list[FloatArray] = field(default_factory=list)
    controls: list[FloatArray] = field(default_factory=list)

    @property
    def num_steps(self) -> int:
        """Number of actions taken so far."""
        return len(self.actions)

    def add(self, observation: FloatArray, action: FloatArray, control: FloatArray) -> None:
        """Record one step."""
        self.observations.append(observation)
        self.actions.append(action)
        self.controls.append(control)

    def finished(self, rewards: FloatArray) -> Episode:
        """Return the episode with its rewards, one for each step."""
        return Episode(
            self.latent,
            np.stack(self.observations),
            np.stack(self.actions),
            np.stack(self.controls),
            rewards,
        )

    def arrays(self, observation_size: int, action_size: int) -> Arrays:
        """Return the arrays to save in a file."""
        sizes = (observation_size, action_size, action_size)
        steps = {
            f"running.{name}": np.reshape(getattr(self, name), (self.num_steps, size))
            for name, size in zip(_STEPS, sizes, strict=True)
        }
        return {"running.latent": self.latent, **steps}

    @staticmethod
    def from_arrays(
        arrays: Arrays, observation_size: int, action_size: int, latent_size: int, purpose: Purpose
    ) -> "RunningEpisode":
        """Rebuild a saved running episode; raises ValueError if its arrays do not fit."""
        observations = take(arrays, "running.observations", -1, observation_size)
        shape = (observations.shape[0], action_size)
        return RunningEpisode(
            take(arrays, "running.latent", latent_size),
            purpose,
            list(observations),
            list(take(arrays, "running.actions", *shape)),
            list(take(arrays, "running.controls", *shape)),
        )


def episodes_to_arrays(episodes: Sequence[Episode]) -> Arrays:
    """Return the arrays to save of a batch: episodes of any lengths, concatenated in time."""
    if not episodes:
        return {}
    joined = {
        f"episodes.{name}": np.concatenate([getattr(one, name) for one in episodes])
        for name in (*_STEPS, "rewards")
    }
    return {
        "episodes.length": np.asarray([len(episode.rewards) for episode in episodes]),
        "episodes.latents": np.stack([episode.latent for episode in episodes]),
        **joined,
    }


def episodes_from_arrays(
    arrays: Arrays, observation_size: int, action_size: int, latent_size: int
) -> tuple[Episode, ...]:
    """Rebuild a saved batch; raises ValueError if its arrays do not fit."""
    if "episodes.length" not in arrays:
        return ()
    stated = take(arrays, "episodes.length", -1)
    steps = len(take(arrays, "episodes.rewards", -1))
    if not (stated >= 1).all() or stated.sum() != steps:
        raise ValueError(f"array `episodes.length` must sum up to {steps} steps, got {stated}.")
    latents = take(arrays, "episodes.latents", len(stated), latent_size)
    joined = (
        take(arrays, "episodes.observations", steps, observation_size),
        take(arrays, "episodes.actions", steps, action_size),
        take(arrays, "episodes.controls", steps, action_size),
        take(arrays, "episodes.rewards", steps),
    )
    ends = np.cumsum(stated.astype(np.int64))[:-1]
    parts = zip(latents, *(np.split(array, ends) for array in joined), strict=True)
    return tuple(Episode(*part) for part in parts)
