"""From what a robot observes to what its actuators get."""

import math

import numpy as np

from maesn.runtime.actuators import clipped
from maesn.runtime.arrays import FloatArray
from maesn.runtime.episode import RunningEpisode
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.policy import ConditionedPolicy
from maesn.runtime.safeguards import Safeguards


class Actor:
    """Chooses controls by the actuators' map of the training, narrowed and slowed by safeguards.

    Args:
        exported: what meta-training handed over.
        safeguards: limits on the controls.
        generator: draws the noise of actions.
    """

    def __init__(
        self, exported: ExportedPolicy, safeguards: Safeguards, generator: np.random.Generator
    ) -> None:
        size = exported.action_size
        self._exported, self._generator = exported, generator
        self.actuators = exported.actuators.narrowed(
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

    def act(
        self,
        policy: ConditionedPolicy,
        running: RunningEpisode,
        seen: FloatArray,
        explore: bool | None,
        normalized: bool,
    ) -> FloatArray:
        """Record a step, and return its control; see `Explorer.act`. An error changes nothing."""
        exported = self._exported
        observed = exported.sensors.clipped(seen)
        action = policy.mean(observed)
        if not np.isfinite(action).all():
            raise ValueError(
                f"`observation` {observed} is so large that the policy's answer is {action}; "
                "throw the episode away with `discard()`."
            )
        if normalized:
            exported.actuators.refuse_unlimited()
        random_state = self._generator.bit_generator.state
        is_drawn = exported.is_noisy[running.purpose] if explore is None else explore
        if is_drawn:
            std = exported.policy.std
            action += std * self._generator.standard_normal(std.shape[0])
        before = running.controls[-1] if running.controls else self._rest
        control = self._limited(action, before)
        answer = exported.actuators.normalized(control) if normalized else control.copy()
        if not np.isfinite([action, control, answer]).all():
            self._generator.bit_generator.state = random_state
            raise ValueError(
                f"the control must be finite, but the action {action} becomes {answer}; nothing "
                "was recorded. Limit the controls with `Safeguards`."
            )
        running.add(observed, action, control)
        return answer

    def _limited(self, action: FloatArray, before: FloatArray) -> FloatArray:
        """Return what to execute for an action after this control, `[action]`."""
        control = self.actuators.control(action)
        slow = clipped(control, before - self._max_change, before + self._max_change)
        # The limits come last: they also hold where the step before lay outside of them, as after
        # safeguards that were tightened in the middle of an episode.
        return clipped(slow, self.actuators.lower, self.actuators.upper)
