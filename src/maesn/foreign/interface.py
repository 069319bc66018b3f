"""The interface of an environment, the same for every task of a family: its spaces and times."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

# Largest range of an action. Wider bounds are just the largest numbers of their type.
_LARGEST_WIDTH = 1e30


class InterfaceError(ValueError):
    """An environment's spaces are not supported; the message says why."""


@dataclass(frozen=True)
class Interface:
    """Spaces and times of an environment."""

    observation: str
    """Structure and shapes of the observations, without bounds."""
    observation_size: int
    """Components of an observation, flattened."""
    discrete: bool
    """Whether a control is a choice, as a one-hot vector."""
    lower: tuple[float, ...]
    """Lower bounds of the control, flattened; 0 for each choice."""
    upper: tuple[float, ...]
    """Upper bounds of the control, flattened; 1 for each choice."""
    max_episode_steps: int | None
    """Steps until the environment itself cuts an episode off; None if its `spec` does not say."""
    control_period: float | None
    """Seconds between two steps; None if the environment does not say."""


def describe(env: gymnasium.Env[Any, Any]) -> Interface:
    """Return what an environment looks like from outside.

    Raises:
        InterfaceError: there are no vector observations, or actions are neither bounded vectors
            nor choices.
    """
    lower, upper = _bounds(env.action_space)
    flat = _flat_observation(env.observation_space)
    return Interface(
        observation=_structure(env.observation_space),
        observation_size=int(np.prod(flat.shape)),
        discrete=isinstance(env.action_space, spaces.Discrete),
        lower=lower,
        upper=upper,
        max_episode_steps=None if env.spec is None else env.spec.max_episode_steps,
        control_period=_control_period(env),
    )


def _bounds(space: spaces.Space[Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    if isinstance(space, spaces.Discrete):
        return (0.0,) * int(space.n), (1.0,) * int(space.n)
    if not isinstance(space, spaces.Box) or space.dtype.kind != "f":
        raise InterfaceError(
            "the action space must be a bounded `Box` of floating-point numbers or `Discrete`, "
            f"got {space}: wrap the environment in one that maps such actions to its own."
        )
    lower = tuple(float(bound) for bound in space.low.ravel())
    upper = tuple(float(bound) for bound in space.high.ravel())
    for index, (low, high) in enumerate(zip(lower, upper, strict=True)):
        _check_bounds(index, low, high)
    return lower, upper


def _check_bounds(index: int, low: float, high: float) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        width = np.float32(high) - np.float32(low)  # actions are mapped in single precision
    if width <= 0:
        raise InterfaceError(
            f"component {index} of the action space can only be {low}: leave it out, as "
            "`gymnasium.wrappers.TransformAction` can."
        )
    if not width <= _LARGEST_WIDTH:  # nor NaN, of two infinite bounds
        raise InterfaceError(
            f"the action space must be bounded, but component {index} reaches from {low} to "
            f"{high}: give it finite bounds, as `gymnasium.wrappers.TransformAction` can."
        )


def _flat_observation(space: spaces.Space[Any]) -> spaces.Box:
    flat = spaces.flatten_space(space) if space.is_np_flattenable else None
    if not isinstance(flat, spaces.Box):
        raise InterfaceError(
            "the observation space must flatten to a vector of fixed length, as `Box`, "
            f"`Discrete`, and `Dict` and `Tuple` of them do, got {space}."
        )
    return flat


def _structure(space: spaces.Space[Any]) -> str:
    """Return a text that is equal for two spaces if their elements flatten alike."""
    if isinstance(space, spaces.Dict):
        parts = (f"{name}: {_structure(part)}" for name, part in space.spaces.items())
        return f"Dict({', '.join(parts)})"
    if isinstance(space, spaces.Tuple):
        return f"Tuple({', '.join(map(_structure, space.spaces))})"
    if isinstance(space, spaces.Box):
        return f"Box{list(space.shape)}"
    return str(space)


def _control_period(env: gymnasium.Env[Any, Any]) -> float | None:
    frames = env.metadata.get("render_fps")
    return 1.0 / float(frames) if frames else None
