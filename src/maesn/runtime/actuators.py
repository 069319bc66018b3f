"""From the policy's unbounded actions to what the actuators are sent."""

from dataclasses import dataclass, replace

import numpy as np

from maesn.runtime.arrays import FloatArray, LimitArray


@dataclass(frozen=True)
class Actuators:
    """control = clip(offset + scale * action, lower, upper), elementwise.

    The map that the policy was trained with. The policy does not know it: likelihoods belong to
    the unbounded action, and the environment scaled and clipped it.

    Attributes:
        offset: control for the action 0, in the actuators' unit, `[action]`.
        scale: change of the control per unit of action.
        lower: smallest control; -inf if there is none.
        upper: largest control; inf if there is none.
        names: what each actuator is called; "" where it has no name.
    """

    offset: FloatArray
    scale: FloatArray
    lower: LimitArray
    upper: LimitArray
    names: tuple[str, ...] = ()

    def control(self, action: FloatArray) -> FloatArray:
        """Return what is sent for an action, `[action]`."""
        return clipped(self.offset + self.scale * action, self.lower, self.upper)

    def normalized(self, control: FloatArray) -> FloatArray:
        """Return a control on the scale on which the lower limit is -1 and the upper one 1."""
        self.refuse_unlimited()
        return (control - (self.lower + self.upper) / 2) / ((self.upper - self.lower) / 2)

    def refuse_unlimited(self) -> None:
        """Raise ValueError for an actuator without two limits."""
        width = self.upper - self.lower
        lacking = ~((width > 0) & np.isfinite(width))
        if lacking.any():
            index = int(np.argmax(lacking))
            raise ValueError(
                "`normalized` needs a lower and an upper limit of every actuator, but actuator "
                f"{index} has the range {self.lower[index]} to {self.upper[index]}: take the "
                "control in the actuators' units."
            )

    def narrowed(self, lower: FloatArray, upper: FloatArray) -> "Actuators":
        """Return the same map with a range within [lower, upper] as well.

        Raises:
            ValueError: no control is left.
        """
        low, high = np.maximum(self.lower, lower), np.minimum(self.upper, upper)
        if ((low > high) | np.isposinf(low) | np.isneginf(high)).any():
            raise ValueError(
                f"`lower` {lower} and `upper` {upper} leave no control: `lower` must be at most "
                f"`upper`, and the policy's own range is {self.lower} to {self.upper}."
            )
        return replace(self, lower=low, upper=high)


def clipped(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return `values` within limits. `np.clip` takes several times as long on two numbers."""
    return np.minimum(np.maximum(values, lower), upper)
