"""From what sensors say to what the policy sees."""

from dataclasses import dataclass

from maesn.runtime.actuators import clipped
from maesn.runtime.arrays import FloatArray, LimitArray


@dataclass(frozen=True)
class Sensors:
    """The components of an observation, in the policy's order.

    Attributes:
        names: what each component is called; "" where it has no name.
        lower: what training clipped each component to from below; -inf if it did not.
        upper: the same from above; inf if it did not.
    """

    names: tuple[str, ...]
    lower: LimitArray
    upper: LimitArray

    def clipped(self, observation: FloatArray) -> FloatArray:
        """Return an observation as the simulation would have shown it, `[observation]`."""
        return clipped(observation, self.lower, self.upper)
