"""From the action spaces of the Gymnasium environments to the actions that policies choose."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from maesn.envs import AnyEnv
from maesn.runs.probing import probe_actuators

_ROUNDING = 1e-5  # of what is read off `control` in single precision
Actions = Float[np.ndarray, "*batch action"]


def box_to_action(env: AnyEnv) -> Callable[[Actions], Actions]:
    """Return the linear map that takes -1 and 1 to the ends of the actuators' range.

    The identity where an actuator lacks a limit, or `control` has another form than robots need.
    """
    try:
        actuators = probe_actuators(env)
    except ValueError:
        return lambda action: action
    lower, upper = actuators.lower, actuators.upper
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = ((lower + upper) / 2 - actuators.offset) / actuators.scale
        factor = (upper - lower) / 2 / actuators.scale
    is_identity = np.allclose(shift, 0.0, atol=_ROUNDING) and np.allclose(factor, 1.0, _ROUNDING)
    if is_identity or not np.isfinite([shift, factor]).all():
        return lambda action: action
    shift, factor = shift.astype(np.float32), factor.astype(np.float32)
    return lambda action: shift + factor * action


def one_hot(size: int) -> Callable[[Float[np.ndarray, ""]], Float[np.ndarray, " action"]]:
    """Return the map from the number of a choice to the vector that a discrete action is."""

    def to_action(choice: Float[np.ndarray, ""]) -> Float[np.ndarray, " action"]:
        if choice not in range(size):
            raise ValueError(f"`action` must be a choice from 0 to {size - 1}, got {choice}.")
        return np.eye(size, dtype=np.float32)[int(choice)]

    return to_action
