"""From the action spaces of the Gymnasium environments to the actions that policies choose."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from maesn.envs import AnyEnv
from maesn.runs.probing import probe_actuators

_ROUNDING = 1e-5  # of what is read off `control` in single precision
Choices = Float[np.ndarray, " episode"]
Actions = Float[np.ndarray, "episode action"]


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


def one_hot(env: AnyEnv) -> Callable[[Choices], Actions]:
    """Return the map from the numbers of choices to the vectors that discrete actions are."""
    table = np.eye(env.action_size, dtype=np.float32)

    def to_action(choice: Choices) -> Actions:
        if not np.isin(choice, np.arange(env.action_size)).all():
            raise ValueError(
                f"`action` must be a choice from 0 to {env.action_size - 1}, got {choice.tolist()}."
            )
        return table[choice.astype(int)]

    return to_action
