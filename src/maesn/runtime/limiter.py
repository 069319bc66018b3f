"""From actions to controls that are safe to execute."""

import math

import numpy as np

from maesn.runtime.actuators import Actuators, clipped
from maesn.runtime.arrays import FloatArray
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
