"""Limits that keep a robot safe while it explores. The policy does not know them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from maesn.runtime.arrays import FloatArray

Limit: TypeAlias = float | Sequence[float] | FloatArray
"""One number for all actuators, or one for each."""


@dataclass(frozen=True)
class Safeguards:
    """Limits on the executed controls and on the latent. All are off by default.

    Controls are in the actuators' unit (newton metres on `wheeled`). They are first clipped, then
    their change is limited. The executed control is recorded beside the policy's action. The
    difference does not affect learning: the latent's gradient needs only z and the return.
    """

    lower: Limit | None = None
    """Smallest control to execute, in addition to the limits that the policy was trained with."""
    upper: Limit | None = None
    """Largest control to execute."""
    max_change: Limit | None = None
    """Largest change of a control from one step to the next (the rate limit)."""
    rest: Limit = 0.0
    """The control before the first step of an episode, from which `max_change` counts."""
    max_latent_norm: float | None = None
    """Largest Euclidean norm of the latent's mean. An update that would leave this ball ends on
    its surface. The standard deviation is not limited."""

    def __post_init__(self) -> None:
        bound = self.max_latent_norm
        if bound is not None and not bound >= 0:
            raise ValueError(f"`max_latent_norm` must be at least 0 or None, got {bound}.")
        for name in ("lower", "upper", "max_change", "rest"):
            object.__setattr__(self, name, _as_numbers(name, getattr(self, name)))
        if not np.isfinite(np.asarray(self.rest, np.float64)).all():
            raise ValueError(f"`rest` must be finite, got {self.rest}.")
        if self.max_change is not None and not (np.asarray(self.max_change) > 0).all():
            raise ValueError(f"`max_change` must be positive, got {self.max_change}.")

    def limit(self, name: str, size: int, default: float = 0.0) -> FloatArray:
        """Return a limit with one number for each of `size` actuators; `default` where it is None.

        Raises:
            ValueError: it is neither one number nor `size` numbers.
        """
        value = getattr(self, name)
        array = np.asarray(default if value is None else value, dtype=np.float64)
        if array.shape not in ((), (size,)):
            raise ValueError(
                f"`{name}` must be one number or {size}, one for each actuator, got {value!r}."
            )
        return np.broadcast_to(array, (size,)).copy()


def _as_numbers(name: str, limit: Limit | None) -> float | tuple[float, ...] | None:
    """Return a limit as Python numbers, which can be compared and written to JSON."""
    if limit is None:
        return None
    array = np.asarray(limit, dtype=np.float64)
    if array.ndim > 1 or np.isnan(array).any():
        raise ValueError(f"`{name}` must be one number or one for each actuator, got {limit!r}.")
    return float(array) if array.ndim == 0 else tuple(array.tolist())
