"""The interface of an environment, the same for every task of a family: its spaces and times."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

# Largest range of an action. Wider bounds are just the largest numbers of their type.
_LARGEST_WIDTH = 1e30
# An action far outside of every range: what arrives of it inside of a wrapper is a limit.
_FAR = 1e6
_TOLERANCE = 1e-5  # of a range; wrappers compute in single precision

Arrivals = Callable[[Float[np.ndarray, "control component"]], Any]
"""Sends controls through the wrappers, as `maesn.foreign.worker` describes it."""


class InterfaceError(ValueError):
    """An environment's spaces are not supported; the message says why."""


class Interface(NamedTuple):
    """Spaces and times of an environment."""

    spaces: dict[str, Any]
    """What the spaces of every task must be, for the workers to compare."""
    discrete: bool
    """Whether a control is a choice, as a one-hot vector."""
    lower: tuple[float, ...]
    """Limits of the control, flattened, the tightest of all wrappers; 0 for each choice."""
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
        return len(self.observation_names)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of these components, in their order."""
        return tuple(self.spaces["observation"][1])


def derive(facts: dict[str, Any], arrivals: Arrivals) -> Interface:
    """Return what an environment looks like from outside, from the facts that it says of itself.

    It is asked for arrivals only if there are wrappers. InterfaceError says that actions are
    neither bounded vectors nor choices.
    """
    kind, *bounds = facts["spaces"]["action"]
    if kind not in ("Box", "Discrete"):
        raise InterfaceError(
            "the action space must be a bounded `Box` of floating-point numbers or `Discrete`, "
            f"got {kind}: wrap the environment in one that maps such actions to its own."
        )
    limits, steps, repeats = np.array(bounds), facts["max_episode_steps"], 1
    if facts["inner_action"] is not None:
        ends = np.clip(limits, -_FAR, _FAR)
        found, clocks = arrivals(np.stack([ends.mean(axis=0), *ends]))
        if found and kind == "Box" and facts["inner_action"][0] == "Box":
            limits = _tightened(limits, np.array(facts["inner_action"][1:]), found, arrivals)
        counts = {len(calls) for calls in found}
        repeats = counts.pop() if len(counts) == 1 else 0
        steps = min(map(math.ceil, clocks), default=steps)
    for index, (low, high) in enumerate(limits.T.tolist()):
        _check_bounds(index, low, high)
    period, doubt = _control_period(facts["dt"], facts["rates"], repeats)
    lower, upper = map(tuple, limits.tolist())
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


def _tightened(
    limits: np.ndarray, inner: np.ndarray, found: list[np.ndarray], arrivals: Arrivals
) -> np.ndarray:
    """Return limits between which the innermost environment gets actions within its own space.

    Some wrappers take any action and clip it (`ClipAction`), some have a wider space than what they
    wrap. Others map one space to the other (`RescaleAction`), and need nothing here. Limits are
    `[2, component]`; `found` is what arrived of the middle and of both ends.
    """
    middle, *reached = (calls[0] for calls in found)
    if middle.shape != limits[0].shape:
        return limits
    goal, ends = np.clip(reached, *inner), np.clip(limits, -_FAR, _FAR)
    with np.errstate(invalid="ignore", divide="ignore"):
        excess = np.abs(goal - reached) > _TOLERANCE * (inner[1] - inner[0])
        centre = ends.mean(axis=0)
        share = (goal - middle) / (np.array(reached) - middle)
        shorter = np.where(excess, centre + share * (ends - centre), limits)
    # Without bounds, what arrives is the limit, if it passes unchanged.
    shorter = np.where(np.isinf(limits) & (np.abs(goal) < _FAR), goal, shorter)
    if (shorter == limits).all() or not np.isfinite(shorter).all():
        return shorter
    again = np.array([calls[0] for calls in arrivals(shorter)[0]])
    if np.allclose(again, goal, atol=float(_TOLERANCE * np.ptp(shorter, axis=0).max())):
        return shorter
    raise InterfaceError(
        f"the limits of an action cannot be known: actions from {limits[0]} to {limits[1]} reach "
        f"the innermost environment as {reached[0]} to {reached[1]}, but its own action space is "
        f"from {inner[0]} to {inner[1]}. Wrap the environment in `gymnasium.wrappers.RescaleAction`"
        " or in another whose action space has the limits."
    )


def _control_period(
    dt: float | None, rates: list[float | None], repeats: int
) -> tuple[float | None, str]:
    """Return the seconds between two steps of the outermost environment, or None and why.

    The innermost one has steps of `dt` seconds, as Gymnasium's MuJoCo environments do; `repeats` of
    them make one, 0 if that varies. Both show rounded rates of pictures, one for each step.
    """
    if not repeats:
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
