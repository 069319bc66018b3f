"""Adaptation to new tasks: every method's curve, through the fast-learner interface alone."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.axes import TaskKeys
from maesn.evaluation.evaluation import TASKS_AT_ONCE, USUAL, Evaluation
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, Purpose
from maesn.worlds import EpisodeError
from maesn.worlds.budget import tasks_that_fit
from maesn.worlds.collector import Collector

# "Updates" that no adaptation reaches: for the keys of the learners themselves, and of the episodes
# that judge a deployed agent.
_START = 0xFFFFFFFF
_DEPLOYED = 0xFFFFFFFE


class AdaptationCurves(eqx.Module):
    """How every task's performance changes with adaptation: `[i, k]` is task i, update k.

    Success and time in the goal region are NaN where the family defines no success.
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

    explored: AdaptationCurves
    """Curves of the episodes that were played after k updates and then learned from; NaN where
    nothing is learned and fresh episodes judge the agent."""
    deployed: AdaptationCurves | None
    """Curves of fresh episodes of the deployed agent after k updates, NaN where it was not judged;
    None if none were asked for."""
    contexts: Any
    """Adapted contexts, `[task, update, ...]`: `AbstractFastLearner.adapted`."""
    episodes_per_update: int
    """Number of episodes of a task that an update adds to what the agent has learned from."""
    trial_episodes: int | None = None
    """Number of episodes that meta-training has prepared for; None if there is no such limit."""

    @property
    def curves(self) -> AdaptationCurves:
        """The curves that judge the method: `deployed` where there are any, else `explored`."""
        return self.explored if self.deployed is None else self.deployed


def adapt(
    learner: AbstractFastLearner[Any],
    collect: Collector,
    evaluation: Evaluation = USUAL,
    *,
    episodes: int | None = None,
    tasks: Sequence[int] | None = None,
) -> AdaptationOutcome:
    """Adapt to tasks of a set, all of them at once.

    Args:
        learner: learns in each task separately.
        collect: plays the episodes of each task that an update learns from.
        evaluation: budgets, seed, and how many tasks advance together at most. The same seed gives
            the same episodes for any such number.
        episodes: of each task, in all: a multiple of `collect.episodes_per_task`; None for what the
            evaluation says.
        tasks: indices of the tasks, in the order of the outcome; None for the first ones, as many
            as the evaluation says. A task's episodes do not depend on which others there are.

    Raises:
        EpisodeError: an episode went wrong, perhaps because updates have led its agent astray.
    """
    budget, each = evaluation.budget, collect.episodes_per_task
    updates = range((budget.episodes if episodes is None else episodes) // each + 1)
    deploy = Collector(collect.world, budget.deploy) if budget.deploy else None
    judged = {count // each for count in evaluation.deploy_after} or updates
    chosen = np.arange(evaluation.count(collect.world.tasks)) if tasks is None else np.array(tasks)
    players = (collect, deploy or collect)
    most = min(one.most_tasks for one in players)
    fitting = min(tasks_that_fit(one.world.env, one.episodes_per_task) for one in players)
    wanted = evaluation.tasks_at_once or min(TASKS_AT_ONCE, fitting)
    size = min(wanted, most, len(chosen))
    parts = []
    for start in range(0, len(chosen), size):
        # Chunks of one size share compiled programs: the last task fills the last of them.
        slots = chosen[np.minimum(np.arange(start, start + size), len(chosen) - 1)]
        parts.append(_adapt_chunk(learner, collect, deploy, judged, slots, updates, evaluation))
    explored, deployed, contexts = jax.tree.map(
        lambda *chunks: np.concatenate(chunks)[: len(chosen)], *parts
    )
    if not collect.world.env.defines_success:
        explored, deployed = map(_without_success, (explored, deployed))
    trial_episodes = learner.capabilities.trial_episodes
    # Trials are played side by side: each has seen one episode more.
    added = each if trial_episodes is None else 1
    return AdaptationOutcome(explored, deployed, contexts, added, trial_episodes)


def _adapt_chunk(
    learner: AbstractFastLearner[Any],
    collect: Collector,
    deploy: Collector | None,
    judged: Collection[int],
    slots: np.ndarray,
    updates: range,
    evaluation: Evaluation,
) -> Any:
    """Return curves of both purposes and contexts of some tasks, `[task, update, ...]`."""
    seed, action_noise = evaluation.seed, evaluation.action_noise
    state = learner.init(_task_keys(seed, _START, slots))

    def play(plays: Collector, purpose: Purpose, keys: TaskKeys, update: int) -> Episodes:
        agents = learner.agents(state, purpose)
        is_noisy = action_noise or (purpose == "explore" and agents.is_noisy)
        try:
            return plays(keys, replace(agents, is_noisy=is_noisy), jnp.asarray(slots), update)
        except EpisodeError as error:
            raise error.after(update) from error

    columns = []
    for update in updates:
        keys = _task_keys(seed, update, slots)
        explored = fresh = None
        if deploy is not None and update in judged:
            others = jax.vmap(jax.random.fold_in, (0, None))(keys, np.uint32(_DEPLOYED))
            fresh = measure(play(deploy, "deploy", others, update))
        if fresh is None or len(updates) > 1:  # else nothing learns from them or is judged by them
            episodes = play(collect, "explore", keys, update)
            explored = measure(episodes)
        missing = jax.tree.map(lambda x: jnp.full_like(x, jnp.nan), explored or fresh)
        curves = explored or missing, None if deploy is None else fresh or missing
        columns.append(jax.tree.map(np.asarray, (*curves, learner.adapted(state))))
        if update < updates[-1]:
            state = learner.update(state, episodes)
    return jax.tree.map(lambda *xs: np.stack(xs, axis=1), *columns)


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
        success_rate=episodes.success.mean(-1),
        final_success_rate=final.mean(-1),
        time_in_region=solved.sum((1, 2)) / steps,
        solved_at_reset=episodes.solved_at_start.mean(-1),
    )


def _without_success(curves: AdaptationCurves | None) -> AdaptationCurves | None:
    """Return the curves with NaN for success and time in the goal region."""
    if curves is None:
        return None
    unknown = np.full_like(curves.mean_return, np.nan)
    names = ("success_rate", "final_success_rate", "time_in_region")
    return replace(curves, **dict.fromkeys(names, unknown))


def _task_keys(seed: int, update: int, slots: np.ndarray) -> TaskKeys:
    update_key = jax.random.fold_in(jax.random.key(seed), np.uint32(update))
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(update_key, jnp.asarray(slots))


def as_rows(outcome: AdaptationOutcome) -> Iterator[dict[str, Any]]:
    """Yield the curves as rows of a table, first those of `explore`."""
    for purpose, curves in (("explore", outcome.explored), ("deploy", outcome.deployed)):
        if curves is None:
            continue
        measures = {name: np.asarray(values, np.float32) for name, values in vars(curves).items()}
        for task, update in np.ndindex(curves.mean_return.shape):
            if np.isnan(measures["mean_return"][task, update]):
                continue  # not judged
            yield {
                "task": task,
                "update": update,
                "episodes": update * outcome.episodes_per_update,
                "purpose": purpose,
                **{name: values[task, update] for name, values in measures.items()},
            }
