"""What is possible in `sparse_point`: a bracket.

    python benchmarks/limits_sparse_point.py

From below, the best of some scripted sweeps: to a ring near the half circle, along it until the
reward shows where the goal is, then there. From above, a relaxed problem: a goal that comes into
view at step t is rewarded from then on as the oracle would be, only so much of the half circle
comes into view in a step, and the goal is known from the second episode on.
"""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from limits import Limits, Returns, print_table
from scipy.optimize import linear_sum_assignment

from maesn.envs.sparse_point import GOAL_RADIUS, PROTOCOLS, STEP_LENGTH

NUM_EPISODES = {"pearl": 20, "varibad": 3, "metacure": 4}  # of a trial
NUM_ANGLES = 720  # of the goals that stand for all


class Point(NamedTuple):
    """The protocol of a variant."""

    radius: float
    steps: int
    episodes: int

    @property
    def angles(self) -> Float[np.ndarray, " goal"]:
        """Angles of goals that stand for all."""
        return (np.arange(NUM_ANGLES) + 0.5) * np.pi / NUM_ANGLES

    @property
    def goals(self) -> Float[np.ndarray, "goal 2"]:
        """Goals that stand for all."""
        return on_circle(self.angles)


def on_circle(angle: Float[np.ndarray, "*n"], radius: float = GOAL_RADIUS) -> np.ndarray:
    """Return points at angles, `[..., 2]`."""
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def towards(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return where one step leads at full speed on both axes: no other gets nearer, on either."""
    return here + np.clip(there - here, -STEP_LENGTH, STEP_LENGTH)


def rewards_at(point: Point, here: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Return the sparse reward of being somewhere."""
    distance = np.linalg.norm(here - goals, axis=-1)
    return np.where(distance <= point.radius, 1.0 - distance, 0.0)


def oracle_rewards(point: Point) -> Float[np.ndarray, "step goal"]:
    """Return the rewards of the oracle in each step."""
    here, rewards = np.zeros_like(point.goals), []
    for _ in range(point.steps):
        here = towards(here, point.goals)
        rewards.append(rewards_at(point, here, point.goals))
    return np.array(rewards)


def point_limits(point: Point) -> Limits:
    """Return the limits of a variant; those of the searcher are a bracket."""
    oracle = oracle_rewards(point)
    known = oracle.sum(axis=0).mean()
    above = np.full(point.episodes, known)
    above[0] = most_in_first_episode(point, oracle)
    return Limits(float(known), _best_sweep(point), above)


def most_in_first_episode(point: Point, oracle: Float[np.ndarray, "step goal"]) -> float:
    """Return what no searcher exceeds in its first episode, on average.

    Goals come into view within asin(R) of the angle of the point, while it is at least 1 - R from
    the origin. There a step of 0.1 on both axes changes its angle by 2 asin(0.0707 / (1 - R)) at
    most. If it leaves and comes back elsewhere, that takes a step in which nothing comes into view.
    So one step shows 2 asin(R), and n steps at most n - 1 times the larger of that change and
    asin(R) more.
    """
    longest, ring = np.sqrt(2) * STEP_LENGTH, GOAL_RADIUS - point.radius
    width = np.arcsin(point.radius)
    turn = 2 * np.arcsin(longest / 2 / ring)
    first = int(np.ceil(ring / longest - 1e-9))
    shown = 2 * width + np.arange(point.steps - first + 1) * max(turn, width)
    places = np.minimum(np.ceil(shown / np.pi * NUM_ANGLES), NUM_ANGLES).astype(int)
    step = np.repeat(np.arange(first - 1, point.steps), np.diff(places, prepend=0))
    left = np.cumsum(oracle[::-1], axis=0)[::-1]  # reward from each step on
    worth = np.zeros((NUM_ANGLES, NUM_ANGLES))
    worth[: len(step)] = left[step]
    return float(worth[linear_sum_assignment(worth, maximize=True)].sum() / NUM_ANGLES)


def _best_sweep(point: Point) -> Returns:
    """Return the mean returns of the best of some sweeps, by the whole trial."""
    rings = GOAL_RADIUS - point.radius * np.array([0.0, 0.2, 0.4, 0.6])
    starts = np.linspace(0.0, np.pi / 3, 9)
    tried = (
        sweep(point, ring, first, second)
        for ring, first, second in itertools.product(rings, starts, starts)
    )
    return max(tried, key=lambda returns: float(returns.sum()))


def sweep(point: Point, ring: float, first: float, second: float) -> Returns:
    """Return the mean returns of sweeping along a ring until the goal is known.

    The first episode sweeps upwards from the angle `first`, all others downwards from pi -
    `second`, as long as the goal is not known.
    """
    seen = np.zeros(NUM_ANGLES, bool)
    known = np.zeros(NUM_ANGLES, bool)
    straight = oracle_rewards(point).sum(axis=0)
    up, down = ring_path(point, ring, first), ring_path(point, ring, second)
    returns = []
    for episode in range(point.episodes):
        path = up if episode == 0 else down * [-1, 1]
        played, met = _sweep_once(point, path, seen)
        returns.append(np.where(known, straight, played).mean())
        seen, known = seen | met, known | met
    return np.array(returns)


def ring_path(point: Point, ring: float, start: float) -> Float[np.ndarray, "step 2"]:
    """Return positions after each step: to an angle on a ring, then along it as fast as can be."""
    here, angle, path = np.zeros(2), start, []
    for _ in range(point.steps):
        ahead = on_circle(np.linspace(angle, angle + 0.5, 501), ring)
        near = np.abs(ahead - here).max(axis=1) <= STEP_LENGTH
        if near.any():
            angle += np.flatnonzero(near)[-1] * 0.001
        here = towards(here, on_circle(np.array(angle), ring))
        path.append(here)
    return np.array(path)


def _sweep_once(
    point: Point, path: Float[np.ndarray, "step 2"], seen: Bool[np.ndarray, " goal"]
) -> tuple[Float[np.ndarray, " goal"], Bool[np.ndarray, " goal"]]:
    """Return the return of an episode and whether the goal came into view, for each goal.

    The reward tells the distance, so two angles are left. If the other one is on the half circle
    and was not seen before, the sweep goes on for one step, which tells them apart.
    """
    total, met = np.zeros(NUM_ANGLES), np.zeros(NUM_ANGLES, bool)
    here, leave = np.zeros((NUM_ANGLES, 2)), np.full(NUM_ANGLES, point.steps + 1)
    for step, place in enumerate(path):
        here = np.where((step >= leave)[:, None], towards(here, point.goals), place)
        reward = rewards_at(point, here, point.goals)
        total += reward
        fresh = (reward > 0) & ~met
        mirror = 2 * np.arctan2(place[1], place[0]) - point.angles
        index = np.floor(mirror / np.pi * NUM_ANGLES).astype(int)
        inside = (index >= 0) & (index < NUM_ANGLES)
        possible = inside & ~(seen | (met & ~fresh))[np.clip(index, 0, NUM_ANGLES - 1)]
        leave = np.where(fresh, step + 1 + possible, leave)
        met = met | fresh
    return total, met


def main() -> None:
    """Print the limits of all variants."""
    found = {}
    for variant, settings in PROTOCOLS.items():
        point = Point(settings["sparse_radius"], settings["horizon"], NUM_EPISODES[variant])
        found[f"sparse_point, {variant}"] = point_limits(point)
    print_table(found)


if __name__ == "__main__":
    main()
