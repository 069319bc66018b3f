"""What no search exceeds with the archive of a policy, in families of goals on a half circle.

    python benchmarks/limits_search.py --runs wheeled ant --out build/peers

The searcher knows the path of every latent: at which of 360 goals it comes near enough for a
reward, and what it returns there. It does not know the goal, which is any of them with the same
probability. An episode without a reward rules out the goals that its latent reaches. One with a
reward is taken to tell the goal exactly, which real returns do not, so this is a bound. Until then
the searcher learns nothing else, so its choice is a list of latents. Dynamic programming over the
angle of the goal finds the best list, since each latent reaches an interval of angles. At the end
the searcher deploys the goal's best latent if it knows the goal, and else the one that is best on
average over the goals that are left.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from jaxtyping import Bool, Float
from search_peers_play import JUDGED_AFTER, Recorded, recorded

from maesn.runs.run import Run

ANGLES = 360
GOAL_DISTANCE = 2.0  # metres; `wheeled` and `ant`
NEAR = 0.5  # a return that is higher by this than the latent's lowest comes from inside the radius


@dataclass(frozen=True)
class Settings:
    """What is computed."""

    out: Path
    """Where recorded episodes are kept."""
    runs: tuple[str, ...] = ("wheeled", "ant")
    """Policies with goals on the half circle."""
    tasks: str = "test"
    """Task set whose episodes are recorded as well; as in `search_peers.py`, to play only once."""


class Limit(NamedTuple):
    """Mean returns over all goals."""

    archive: float
    """Of each goal's best latent."""
    searcher: Float[np.ndarray, " count"]
    """What no search deploys better than, after so many episodes."""


def on_half_circle(name: str, tasks: str, out: Path) -> tuple[Recorded, Recorded]:
    """Return recorded episodes in the tasks of a set, and at all angles of the half circle."""
    angle = np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
    circle = GOAL_DISTANCE * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    goals = np.concatenate([np.asarray(Run.open(name).task_set(tasks).tasks), circle])
    path = out / f"{tasks}-and-half-circle.npz"
    np.savez(path, goal=goals.astype(np.float32))
    whole = recorded(name, str(path), out)
    return whole[:-ANGLES], whole[-ANGLES:]


def reached(episodes: Recorded) -> Bool[np.ndarray, "angle latent"]:
    """Return which goals a latent comes near in some episode, and those between them."""
    excess = episodes.returns - episodes.length * episodes.far[:, None, None]
    near = (excess > excess.min(axis=0) + NEAR).any(axis=2)
    after = np.logical_or.accumulate(near, axis=0)
    return after & np.logical_or.accumulate(near[::-1], axis=0)[::-1]


def best_lists(
    returns: Float[np.ndarray, "angle latent"],
    reaches: Bool[np.ndarray, "angle latent"],
    counts: tuple[int, ...],
) -> Limit:
    """Compute the limit by dynamic programming.

    Let w(g) be what a goal gains by being known, over the latent that is deployed where none is.
    With k latents left, the most that can be gained from angle g on is

        F_k(g) = max(F_k(g + 1), w(g) + ... + w(e) + F_{k-1}(e + 1)),

    e the farthest angle that a latent reaches together with g.

    Args:
        returns: of each latent at each goal, in the order of the angle.
        reaches: whether an episode of the latent has a reward there; an interval of angles each.
        counts: numbers of episodes.
    """
    angles, best = len(returns), returns.max(axis=1)
    end = np.where(reaches.any(axis=0), angles - 1 - reaches[::-1].argmax(axis=0), -1)
    farthest = np.where(reaches, end, np.arange(angles)[:, None] - 1).max(axis=1)
    gains = best[:, None] - returns  # by the latent that is deployed where the goal is unknown
    total = np.vstack([np.zeros(returns.shape[1]), np.cumsum(gains, axis=0)])
    gained, found = np.zeros_like(total), []
    for _ in range(max(counts)):
        before, gained = gained, np.zeros_like(total)
        for angle in reversed(range(angles)):
            after = farthest[angle] + 1
            played = total[after] - total[angle] + before[after]
            gained[angle] = np.maximum(gained[angle + 1], played)
        found.append((returns.sum(axis=0) + gained[0]).max() / angles)
    return Limit(float(best.mean()), np.asarray(found)[np.asarray(counts) - 1])


def limit_of(episodes: Recorded) -> Limit:
    """Return the limit of an archive by its episodes at all angles."""
    return best_lists(episodes.returns.mean(axis=2), reached(episodes), JUDGED_AFTER)


def main(settings: Settings) -> None:
    """Print the table."""
    settings.out.mkdir(parents=True, exist_ok=True)
    print("| run |", *(f"{count} |" for count in JUDGED_AFTER), "archive's limit |")
    print("|---|" + "---:|" * (len(JUDGED_AFTER) + 1))
    for name in settings.runs:
        limit = limit_of(on_half_circle(name, settings.tasks, settings.out)[1])
        print(f"| {name} |", *(f"{x:.1f} |" for x in limit.searcher), f"{limit.archive:.1f} |")


if __name__ == "__main__":
    main(tyro.cli(Settings))
