"""What is possible in `grid_navi`, exactly, in a trial of four episodes as in VariBAD.

    python benchmarks/limits_grid_navi.py

Before the best searcher finds the goal, all that it has seen is which cells are not the goal, so
its belief is the set of the others, each with the same probability. Value iteration over beliefs
and positions gives its return. Once it has found the goal it stays, and later goes straight there.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from limits import Limits, print_table

from maesn.envs.grid_navi import GOAL_REWARD, MOVES, OTHER_REWARD, goal_cells

NUM_EPISODES = 4  # VariBAD's trial


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


def make_grid(cells: int = 5, steps: int = 15, episodes: int = NUM_EPISODES) -> Grid:
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


if __name__ == "__main__":
    print_table({"grid_navi": navi_limits(make_grid())})
