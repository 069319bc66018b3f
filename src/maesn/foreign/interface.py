"""The interface of an environment, the same for every task of a family: its spaces and times."""

from typing import Any, NamedTuple

import numpy as np

# Largest range of an action. Wider bounds are just the largest numbers of their type.
_LARGEST_WIDTH = 1e30


class InterfaceError(ValueError):
    """An environment's spaces are not supported; the message says why."""


class Interface(NamedTuple):
    """Spaces and times of an environment."""

    spaces: dict[str, Any]
    """What the spaces of every task must be, for the workers to compare."""
    discrete: bool
    """Whether a control is a choice, as a one-hot vector."""
    lower: tuple[float, ...]
    """Limits of the control, flattened; 0 for each choice."""
    upper: tuple[float, ...]
    """As `lower`; 1 for each choice."""
    max_episode_steps: int | None
    """Steps until the environment itself cuts an episode off; None if it does not say."""
    control_period: float | None
    """Seconds between two steps, repeated actions included; None if that cannot be derived."""
    doubt: str
    """Why there is no control period."""

    @property
    def observation_size(self) -> int:
        """Components of an observation, flattened."""
        return len(self.spaces["observation"][1])


def derive(facts: dict[str, Any]) -> Interface:
    """Return what an environment looks like from outside, from the facts that it says of itself.

    InterfaceError says that actions are neither bounded vectors nor choices.
    """
    kind, *bounds = facts["spaces"]["action"]
    if kind not in ("Box", "Discrete"):
        raise InterfaceError(
            "the action space must be a bounded `Box` of floating-point numbers or `Discrete`, "
            f"got {kind}: wrap the environment in one that maps such actions to its own."
        )
    limits = np.array(bounds)
    inner = np.array(facts["inner_action"][1:])
    if inner.shape == limits.shape:  # `ClipAction` takes any action, and clips it to these
        limits = np.where(np.isinf(limits), inner, limits)
    for index, (low, high) in enumerate(limits.T.tolist()):
        _check_bounds(index, low, high)
    period, doubt = _control_period(facts["dt"], facts["rates"], facts["repeats"])
    lower, upper = map(tuple, limits.tolist())
    steps = facts["max_episode_steps"]
    return Interface(facts["spaces"], kind == "Discrete", lower, upper, steps, period, doubt)


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


def _control_period(
    dt: float | None, rates: list[float | None], counts: list[int]
) -> tuple[float | None, str]:
    """Return the seconds between two steps of the outermost environment, or None and why.

    The innermost one has steps of `dt` seconds, as Gymnasium's MuJoCo environments do; `counts`
    of them make the first steps. Both show rounded rates of pictures, one for each step.
    """
    repeats = counts[0]
    if len(set(counts)) > 1:
        return None, "its wrappers may repeat actions, more or less often"
    inner_rate, rate = rates
    one = dt or (1 / inner_rate if inner_rate else None)
    if one is None:
        if rate:
            return 1 / rate, ""
        return None, "it has neither `dt` nor `render_fps` in its `metadata`"
    if inner_rate and not _agree(one, inner_rate):
        shown = f"its `metadata` shows {inner_rate:g} steps a second"
        return None, f"its `dt` is {one:g} s, but {shown}"
    if rate and rate != inner_rate and not _agree(one * repeats, rate):
        return None, (
            f"{repeats} steps of {one:g} s make one, but its `metadata` shows {rate:g} of these "
            "a second"
        )
    return one * repeats, ""


def _agree(period: float, rate: float) -> bool:
    return abs(1 / period - rate) <= 0.5  # rates are rounded
