"""Checked options of the Gymnasium environments."""

from collections.abc import Collection, Iterable, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Int

TaskChoice: TypeAlias = int | Sequence[int] | np.ndarray | None
"""Index of a task in its set, for all episodes or for each; None for one that is drawn."""

RENDER_MODES = ("rgb_array",)
NO_EPISODE = "no episode is running: call `reset` before `step`."


def refuse_unknown(kind: str, given: Iterable[str], known: Collection[str]) -> None:
    """Raise ValueError about names that are unknown, of a kind with its article."""
    for name in given:
        if name not in known:
            names = ", ".join(f"`{one}`" for one in known)
            raise ValueError(f"`{name}` is not {kind}: choose from {names}.")


def checked_task(
    task: TaskChoice, num_tasks: int, num_episodes: int
) -> Int[np.ndarray, " episode"] | None:
    """Return the index of the task of each episode; None if they are to be drawn.

    ValueError says that there is no such task, or not one for every episode.
    """
    if task is None:
        return None
    chosen = np.asarray(task)
    whole = chosen.dtype.kind in "iu" and chosen.shape in ((), (num_episodes,))
    if not whole or (chosen < 0).any() or (chosen >= num_tasks).any():
        raise ValueError(
            f"`task` must be an index from 0 to {num_tasks - 1}, or one for each of "
            f"{num_episodes} episodes, got {task!r}."
        )
    return np.broadcast_to(chosen, (num_episodes,))
