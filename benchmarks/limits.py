"""What is possible in families whose best behaviour can be computed.

    python benchmarks/limits.py grid_navi
    python benchmarks/limits.py sparse_point

A trial is some episodes in one task. The *oracle* knows the task. The *searcher* knows only the
family's distribution and what it has seen in the trial.

`grid_navi`: the best searcher, exactly, in a trial of four episodes as in VariBAD. Before it finds the
goal, all that it has seen is which cells are not the goal, so its belief is the set of the others, each
with the same probability. Value iteration over beliefs and positions gives its return. Once it has
found the goal it stays, and later goes straight there.

`sparse_point`: a bracket. From below, the best of some scripted sweeps: to a ring near the half
circle, along it until the reward shows where the goal is, then there. From above, a relaxed problem:
a goal that comes into view at step t is rewarded from then on as the oracle would be, only so much of
the half circle comes into view in a step, and the goal is known from the second episode on.
"""

import argparse
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from maesn.envs.grid_navi import GOAL_REWARD, MOVES, OTHER_REWARD, goal_cells
from maesn.envs.sparse_point import GOAL_RADIUS, PROTOCOLS, STEP_LENGTH

Returns = Float[np.ndarray, " episode"]

NAVI_EPISODES = 4  # VariBAD's trial
POINT_EPISODES = {"pearl": 20, "varibad": 3, "metacure": 4}
NUM_ANGLES = 720  # of the goals that stand for all


class Limits(NamedTuple):
    """Mean returns over tasks."""

    oracle: float
    """Of an episode."""
    below: Returns
    """What a searcher reaches in each episode of a trial."""
    above: Returns
    """What none exceeds: `below` again, if that is exact."""


# --- grid_navi -----------------------------------------------------------------------------------


class Grid(NamedTuple):
    """A grid and its trials. Cells are numbered; the agent starts in cell 0."""

    goals: Int[np.ndarray, " goal"]
    """Cells of the goals."""
    distance: Int[np.ndarray, " goal"]
    """Moves from the start."""
    after: Int[np.ndarray, "cell 5"]
    """Cell after each move."""
    steps: int
    episodes: int


def make_grid(cells: int = 5, steps: int = 15, episodes: int = NAVI_EPISODES) -> Grid:
    """Return a grid of that many cells a side."""
    goals = goal_cells(cells).astype(int)
    every = np.stack(np.divmod(np.arange(cells**2), cells), axis=1)
    after = np.clip(every[:, None] + np.array(MOVES), 0, cells - 1) @ [cells, 1]
    return Grid(goals @ [cells, 1], goals.sum(axis=1), after, steps, episodes)


def straight_returns(grid: Grid) -> Float[np.ndarray, " goal"]:
    """Return what the oracle has in an episode, for each goal."""
    return _return_if_found(grid, grid.distance)


def _return_if_found(grid: Grid, step: Int[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return what an episode brings in which the goal is entered at a step, from 1, and kept."""
    return OTHER_REWARD * (step - 1) + GOAL_REWARD * (grid.steps + 1 - step)


def navi_limits(grid: Grid) -> Limits:
    """Return the limits of a grid, which are exact."""
    path = _best_path(grid)
    found = [np.argmax(path == goal) if goal in path else path.size for goal in grid.goals]
    episode, step = np.divmod(np.array(found), grid.steps)
    straight = straight_returns(grid)
    returns = [
        np.where(episode > now, OTHER_REWARD * grid.steps, np.where(episode == now,
                 _return_if_found(grid, step + 1), straight)).mean()
        for now in range(grid.episodes)
    ]  # fmt: skip
    return Limits(float(straight.mean()), np.array(returns), np.array(returns))


class Layer(NamedTuple):
    """What a searcher may be at after some steps, all without having met the goal."""

    belief: Int[np.ndarray, " state"]
    """A bit for each goal that it has seen not to be the goal."""
    cell: Int[np.ndarray, " state"]
    value: Float[np.ndarray, " state"]
    """Sum of the trial's returns over the goals that it would have met."""
    parent: Int[np.ndarray, " state"]
    """Row in the layer before."""


def _best_path(grid: Grid) -> Int[np.ndarray, " step"]:
    """Return the cells that the best searcher enters as long as it has not met the goal."""
    few = _layers(grid, -np.inf, most=1000)
    layers = _layers(grid, few[-1].value.max(), most=None)
    row, cells = int(layers[-1].value.argmax()), []
    for layer in reversed(layers[1:]):
        cells.append(layer.cell[row])
        row = layer.parent[row]
    return np.array(cells[::-1])


def _layers(grid: Grid, reached: float, most: int | None) -> list[Layer]:
    """Return the states after each step, without those that cannot lead to what is reached.

    `most` keeps the best states of each step alone, which finds a good path and no proof.
    """
    bits = np.zeros(len(grid.after), int)
    bits[grid.goals] = 1 << np.arange(len(grid.goals))
    layer = Layer(*np.zeros((2, 1), int), np.zeros(1), np.zeros(1, int))
    layers, everything = [layer], (1 << len(grid.goals)) - 1
    for time in range(grid.episodes * grid.steps):
        begun = layer if time % grid.steps else layer._replace(cell=np.zeros_like(layer.cell))
        layer = _advanced(grid, bits, begun, time)
        bound = layer.value + _still_possible(grid, everything & ~layer.belief, time + 1)
        kept = np.flatnonzero(bound >= reached - 1e-9)
        if most is not None:
            kept = kept[np.argsort(-bound[kept], kind="stable")[:most]]
        layer = Layer(*(column[kept] for column in layer))
        layers.append(layer)
    last = layer.value + _still_possible(grid, everything & ~layer.belief, len(layers) - 1)
    layers[-1] = layer._replace(value=last)
    return layers


def _advanced(grid: Grid, bits: Int[np.ndarray, " cell"], layer: Layer, time: int) -> Layer:
    """Return the states one step later; of equal states, the one with the largest value."""
    cell = grid.after[layer.cell]
    fresh = bits[cell] & ~layer.belief[:, None]
    worth = np.append(_worth(grid, *divmod(time, grid.steps)), 0.0)
    which = np.searchsorted(grid.goals, cell)
    value = layer.value[:, None] + np.where(fresh > 0, worth[np.minimum(which, len(worth) - 1)], 0)
    belief = layer.belief[:, None] | fresh
    parent = np.broadcast_to(np.arange(len(layer.cell))[:, None], cell.shape)
    belief, cell, value, parent = (x.ravel() for x in (belief, cell, value, parent))
    order = np.lexsort((-value, cell, belief))
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(belief[order]) != 0) | (np.diff(cell[order]) != 0)
    best = order[first]
    return Layer(belief[best], cell[best], value[best], parent[best])


def _worth(grid: Grid, episode: int, step: int) -> Float[np.ndarray, " goal"]:
    """Return what the whole trial brings if a goal is first entered then, both counted from 0."""
    lost = OTHER_REWARD * grid.steps * episode
    later = grid.episodes - episode - 1
    now = _return_if_found(grid, np.array(step + 1))
    return lost + now + later * straight_returns(grid)


def _still_possible(
    grid: Grid, unseen: Int[np.ndarray, " state"], time: int
) -> Float[np.ndarray, " state"]:
    """Return a bound on the sum of returns over the goals that are not seen at a time.

    It sees a new cell in every step, and each goal as if now were its time; those that this episode
    is too short for lose at least the worst straight way.
    """
    among = (unseen[:, None] >> np.arange(len(grid.goals))) & 1
    count, total = among.sum(axis=1), grid.episodes * grid.steps
    moments = np.arange(time, total)[: len(grid.goals)]
    episode, step = np.divmod(moments, grid.steps)
    now = OTHER_REWARD * grid.steps * episode + _return_if_found(grid, step + 1)
    straight = straight_returns(grid)
    now = now - straight.min() * (episode - time // grid.steps)
    none = np.full(max(len(grid.goals) - len(now), 0), OTHER_REWARD * total)
    sums = np.concatenate([[0.0], np.cumsum(np.concatenate([now, none]))])
    later = max(grid.episodes - time // grid.steps - 1, 0)
    return sums[count] + later * (among @ straight)


# --- sparse_point --------------------------------------------------------------------------------


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

    Goals come into view within asin(R) of the angle of the point, while it is at least 1 - R from the
    origin. There a step of 0.1 on both axes changes its angle by 2 asin(0.0707 / (1 - R)) at most. If
    it leaves and comes back elsewhere, that takes a step in which nothing comes into view. So one
    step shows 2 asin(R), and n steps at most n - 1 times the larger of that change and asin(R) more.
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

    The first episode sweeps upwards from the angle `first`, all others downwards from pi - `second`,
    as long as the goal is not known.
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

    The reward tells the distance, so two angles are left. If the other one is on the half circle and
    was not seen before, the sweep goes on for one step, which tells them apart.
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


# --- the command ---------------------------------------------------------------------------------


def told(name: str, limits: Limits) -> str:
    """Return rows of a table: the first three episodes and the mean of the trial."""
    is_exact = np.array_equal(limits.below, limits.above)
    rows = {"oracle": np.full(len(limits.below), limits.oracle)}
    if is_exact:
        rows["best searcher, exact"] = limits.below
    else:
        rows["best sweep"], rows["no searcher exceeds"] = limits.below, limits.above
    lines = []
    for what, returns in rows.items():
        shown = " | ".join(f"{x:.2f}" for x in (*returns[:3], returns[-1], returns.mean()))
        lines.append(f"| {name} | {what} | {shown} |")
    return "\n".join(lines)


def main() -> None:
    """Print the limits of a family."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("family", choices=("grid_navi", "sparse_point"))
    family = parser.parse_args().family
    print("| family | return of an episode | first | second | third | last | mean of the trial |")
    print("|---|---|---|---|---|---|---|")
    if family == "grid_navi":
        print(told(family, navi_limits(make_grid())))
        return
    for variant, settings in PROTOCOLS.items():
        point = Point(settings["sparse_radius"], settings["horizon"], POINT_EPISODES[variant])
        print(told(f"{family}, {variant}", point_limits(point)))


if __name__ == "__main__":
    main()
