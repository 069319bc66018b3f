"""Episodes as a robot records them."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

import numpy as np

from maesn.runtime.arrays import LARGEST, FloatArray

Purpose: TypeAlias = Literal["explore", "deploy"]
"""`explore`: played to be learned from. `deploy`: played with z at the latent's mean, and judged
only."""
PURPOSES: tuple[Purpose, ...] = get_args(Purpose)


def refuse_large(rewards: FloatArray) -> None:
    """Raise ValueError if some reward is beyond `LARGEST`."""
    size = float(np.abs(rewards).max(initial=0.0))
    if size > LARGEST:
        raise ValueError(
            f"`rewards` must be at most {LARGEST:g} in size, got {size:g}. Nothing was "
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
