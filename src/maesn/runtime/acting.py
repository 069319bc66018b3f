"""From what a robot observes to what its actuators get, with one z."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from maesn.runtime.actuators import Actuators, clipped
from maesn.runtime.arrays import FloatArray
from maesn.runtime.episode import RunningEpisode
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.policy import ConditionedPolicy
from maesn.runtime.safeguards import Safeguards


class Limiter:
    """The actuators' map of the training, narrowed and slowed down by safeguards."""

    def __init__(self, actuators: Actuators, safeguards: Safeguards) -> None:
        size = actuators.scale.shape[0]
        self.actuators = actuators.narrowed(
            safeguards.limit("lower", size, -math.inf), safeguards.limit("upper", size, math.inf)
        )
        self._max_change = safeguards.limit("max_change", size, math.inf)
        self._rest = safeguards.limit("rest", size)
        low, high = self.actuators.lower, self.actuators.upper
        outside = (self._rest < low) | (self._rest > high)
        if (outside & np.isfinite(self._max_change)).any():
            raise ValueError(
                f"`rest` must lie within the controls {low} to {high}, got {self._rest}."
            )

    def control(self, action: FloatArray, before: FloatArray | None) -> FloatArray:
        """Return what to execute for an action, `[action]`; `before` is None at the first step."""
        start = self._rest if before is None else before
        control = self.actuators.control(action)
        slow = clipped(control, start - self._max_change, start + self._max_change)
        # The limits come last: they also hold where the step before lay outside of them, as after
        # safeguards that were tightened in the middle of an episode.
        return clipped(slow, self.actuators.lower, self.actuators.upper)


class Decision(NamedTuple):
    """What is recorded of one step, and what the robot is told."""

    observed: FloatArray
    """The observation, clipped as in training, `[observation]`."""
    action: FloatArray
    """The policy's own, unbounded action, `[action]`."""
    control: FloatArray
    """What is executed, in the actuators' units, `[action]`."""
    answer: FloatArray
    """The same in the units that were asked for, `[action]`."""


@dataclass(frozen=True)
class Actor:
    """Chooses the controls of an episode.

    Attributes:
        exported: what meta-training handed over.
        policy: its policy, given z.
        limiter: from actions to controls that are safe.
        generator: draws the noise of actions.
    """

    exported: ExportedPolicy
    policy: ConditionedPolicy
    limiter: Limiter
    generator: np.random.Generator

    def decided(
        self, running: RunningEpisode, seen: FloatArray, explore: bool | None, normalized: bool
    ) -> Decision:
        """Return what to do now; see `Explorer.act`. Nothing has changed if it raises."""
        exported = self.exported
        observed = exported.sensors.clipped(seen)
        action = self.policy.mean(observed)
        if not np.isfinite(action).all():
            raise ValueError(
                f"`observation` {observed} is so large that the policy's answer is {action}; "
                "throw the episode away with `discard()`."
            )
        if normalized:
            exported.actuators.refuse_unlimited()
        random_state = self.generator.bit_generator.state
        is_drawn = exported.is_noisy[running.purpose] if explore is None else explore
        if is_drawn:
            std = exported.policy.std
            action += std * self.generator.standard_normal(std.shape[0])
        before = running.controls[-1] if running.controls else None
        control = self.limiter.control(action, before)
        answer = exported.actuators.normalized(control) if normalized else control.copy()
        if not np.isfinite([action, control, answer]).all():
            self.generator.bit_generator.state = random_state
            raise ValueError(
                f"the control must be finite, but the action {action} becomes {answer}; nothing "
                "was recorded. Limit the controls with `Safeguards`."
            )
        return Decision(observed, action, control, answer)
