"""Adaptation to new tasks: every method's curve, through the fast-learner interface alone."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.axes import TaskKeys
from maesn.experience.episodes import Collect, Episodes
from maesn.learners import AbstractFastLearner, SavedContexts
from maesn.worlds import EpisodeError

# An "update" that no adaptation reaches: its keys are those of the learners themselves.
_START = 0xFFFFFFFF
CHUNK_SIZE = 25  # tasks that advance together; 50 episodes each of 200 steps take about 100 MB


def tasks_at_once(
    max_simulations: int | None, episodes_per_task: int, most: int = CHUNK_SIZE
) -> int:
    """Return how many tasks to adapt to at once.

    Args:
        max_simulations: how many episodes a world can hold; None for any number.
        episodes_per_task: number of episodes that are played of each task at a time.
        most: number of tasks that memory allows.
    """
    if max_simulations is None:
        return most
    return min(max(max_simulations // episodes_per_task, 1), most)


class AdaptationCurves(eqx.Module):
    """How every task's performance changes with adaptation.

    Entry `[i, k]` is measured on the episodes that are played in task i after k updates, before the
    learner sees them.
    """

    mean_return: Float[Array | np.ndarray, "task *update"]
    """Mean undiscounted return."""
    goal_return: Float[Array | np.ndarray, "task *update"]
    """The part of it that is due to the goal: without control and survival terms."""
    success_rate: Float[Array | np.ndarray, "task *update"]
    """Share of the episodes that reach the goal region at some time."""
    final_success_rate: Float[Array | np.ndarray, "task *update"]
    """Share of the episodes that end in the goal region."""
    time_in_region: Float[Array | np.ndarray, "task *update"]
    """Share of the steps that are spent in the goal region."""
    solved_at_reset: Float[Array | np.ndarray, "task *update"]
    """Share of the episodes that start in the goal region: their success is no achievement."""


class AdaptationOutcome(NamedTuple):
    """Outcome of adapting to a set of tasks."""

    curves: AdaptationCurves
    contexts: Any
    """Contexts of the agents, `[task, update, ...]`; as `Agents.context`."""
    first_update: int
    """Number of updates that lie before the first column."""
    episodes_per_update: int
    """Number of episodes of a task that an update learns from."""
    trial_episodes: int | None = None
    """Number of episodes that meta-training has prepared for; None if there is no such limit."""


def adapt(
    learner: AbstractFastLearner[Any],
    collect: Collect,
    *,
    updates: int = 10,
    seed: int = 0,
    chunk_size: int = CHUNK_SIZE,
    saved: SavedContexts | None = None,
    tasks: Sequence[int] | None = None,
) -> AdaptationOutcome:
    """Adapt to tasks of a set, all of them at once.

    Args:
        learner: learns in each task separately.
        collect: plays the episodes of each update.
        updates: number of updates; the curves have one entry more.
        seed: of the episodes. The same seed gives the same episodes for any `chunk_size`.
        chunk_size: number of tasks that advance together; bounds the memory.
        saved: where an earlier adaptation of all tasks of the set stopped, to go on from there;
            None to begin anew. An adaptation in two parts plays the same episodes as one in a
            single part.
        tasks: indices of the tasks, in the order of the outcome; None for all. A task's episodes
            do not depend on which others there are.

    Raises:
        EpisodeError: an episode went wrong, perhaps because updates have led its agent astray.
        ValueError: an update is to learn from too few episodes, or the learner cannot go on from
            saved contexts.
    """
    can = learner.capabilities
    # A learner of trials learns one episode at a time.
    episodes_per_update = 1 if can.trial_episodes is not None else collect.episodes_per_task
    if updates:
        can.check_episodes(episodes_per_update)
    chosen = np.arange(collect.num_tasks) if tasks is None else np.asarray(tasks)
    first_update = 0 if saved is None else int(saved.updates)
    numbers = range(first_update, first_update + updates + 1)
    parts = [
        _adapt_chunk(learner, collect, slots, numbers, seed, saved)
        for slots in _chunks(chosen, chunk_size)
    ]
    curves, contexts = jax.tree.map(lambda *chunks: np.concatenate(chunks)[: len(chosen)], *parts)
    return AdaptationOutcome(
        curves,
        contexts,
        first_update,
        episodes_per_update,
        can.trial_episodes,
    )


def _adapt_chunk(
    learner: AbstractFastLearner[Any],
    collect: Collect,
    slots: np.ndarray,
    updates: range,
    seed: int,
    saved: SavedContexts | None,
) -> tuple[AdaptationCurves, Any]:
    if saved is not None:
        saved = saved._replace(context=jax.tree.map(lambda x: x[slots], saved.context))
    state = learner.init(_task_keys(seed, _START, slots), saved)
    curves, contexts = [], []
    for update in updates:
        agents = learner.agents(state)
        keys = _task_keys(seed, update, slots)
        try:
            episodes = collect(keys, agents, jnp.asarray(slots), stage=update)
        except EpisodeError as error:
            raise error.after(update) from error
        curves.append(jax.tree.map(np.asarray, measure(episodes)))
        contexts.append(jax.tree.map(np.asarray, agents.context))
        if update < updates[-1]:
            state = learner.update(state, episodes)
    return _stack_updates(curves), _stack_updates(contexts)


@jax.jit
def measure(episodes: Episodes) -> AdaptationCurves:
    """Return one update's column of the curves, `[task]`, from episodes `[task, episode, ...]`."""
    valid = episodes.valid
    solved = episodes.solved & valid
    steps = jnp.maximum(valid.sum((1, 2)), 1)
    last = jnp.maximum(valid.sum(-1) - 1, 0)
    final = jnp.take_along_axis(solved, last[..., None], axis=-1)[..., 0]
    return AdaptationCurves(
        mean_return=episodes.undiscounted_return.mean(-1),
        goal_return=jnp.where(valid, episodes.goal_reward, 0.0).sum(-1).mean(-1),
        success_rate=solved.any(-1).mean(-1),
        final_success_rate=final.mean(-1),
        time_in_region=solved.sum((1, 2)) / steps,
        solved_at_reset=episodes.solved_at_start.mean(-1),
    )


def _chunks(tasks: np.ndarray, chunk_size: int) -> Iterator[np.ndarray]:
    """Cut the tasks into chunks of one size; the last one repeats its last task as padding."""
    size = min(chunk_size, len(tasks))
    for first in range(0, len(tasks), size):
        yield tasks[np.minimum(np.arange(first, first + size), len(tasks) - 1)]


def _task_keys(seed: int, update: int, slots: np.ndarray) -> TaskKeys:
    update_key = jax.random.fold_in(jax.random.key(seed), np.uint32(update))
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(update_key, jnp.asarray(slots))


def _stack_updates(columns: list[Any]) -> Any:
    """[task, ...] for each update -> [task, update, ...]."""
    return jax.tree.map(lambda *xs: np.stack(xs, axis=1), *columns)


def as_rows(adaptation: AdaptationOutcome) -> Iterator[dict[str, np.float32 | int]]:
    """Yield the curves as rows of a table, task by task.

    `episodes` is the number of episodes per task that the agent has learned from by then. Measures
    are in the precision that they were computed in, so that they are written with no more digits.
    """
    curves = adaptation.curves
    num_tasks, num_columns = curves.mean_return.shape
    for task in range(num_tasks):
        for column in range(num_columns):
            update = adaptation.first_update + column
            yield {
                "task": task,
                "update": update,
                "episodes": update * adaptation.episodes_per_update,
                "mean_return": np.float32(curves.mean_return[task, column]),
                "goal_return": np.float32(curves.goal_return[task, column]),
                "success_rate": np.float32(curves.success_rate[task, column]),
                "final_success_rate": np.float32(curves.final_success_rate[task, column]),
                "time_in_region": np.float32(curves.time_in_region[task, column]),
                "solved_at_reset": np.float32(curves.solved_at_reset[task, column]),
            }
