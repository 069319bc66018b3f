"""What agents do in new tasks, recorded for the figures of exploration and for the report page."""

import itertools
import logging
from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.envs import AnyEnv
from maesn.evaluation.adapting import adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import new_tasks
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners.fast import AbstractFastLearner
from maesn.reporting.runs import (
    BELIEF,
    LATENT_PATHS,
    RECORDED_TASKS,
    SEARCHES,
    RecordedExploration,
)
from maesn.rules import SearchRule
from maesn.runs.run import Run
from maesn.runtime.search import LatentSearch
from maesn.search.stored import prior_file
from maesn.storage import RunError, write_arrays
from maesn.worlds.collector import Collector

logger = logging.getLogger(__name__)

# Episodes that figures show, and tasks that they are spread over: where the agent sees what differs
# between tasks, one would be no fair sample.
EXPLORATION_EPISODES = 50
EXPLORATION_TASKS = 5
RECORDED_EPISODES = 5150  # of the test tasks and of those figures, about: for estimates of time

_EDGE = 6.0  # of the latents, in standard deviations of the prior: adapted ones are that far out
_LATENTS = 441  # recorded paths: a lattice of 21 x 21 in the plane
_BELIEFS = 21  # points along each axis at which beliefs are recorded
_POINTS = 40  # positions kept of each path
_TASKS, _EPISODES = 8, 10  # of the searches
_PLACES = 15  # along each axis at which beliefs predict rewards: three a cell of `grid_navi`
_MOMENTS = 60  # of a trial at which its belief is kept, at most


def explore(agents: Agents, collect: Collector, keys: TaskKeys) -> tuple[np.ndarray, np.ndarray]:
    """Play in the first tasks of a world; return paths, `[episode, time_plus_1, 2]`, and z."""
    episodes = collect(keys, agents, jnp.arange(len(keys)) % collect.num_tasks)
    return np.concatenate(_paths(collect.world.env, episodes)), np.concatenate(episodes.z)


def _paths(env: AnyEnv, episodes: Episodes) -> Float[np.ndarray, "task episode time_plus_1 2"]:
    """Return where the agent is; at the end, or before a state that blew up, it stays."""
    path = np.asarray(jax.vmap(jax.vmap(jax.vmap(env.position)))(episodes.observation))
    last = np.asarray(episodes.valid.sum(-1))[..., None]
    blown_up = ~np.isfinite(_at(path, last)).all(-1)
    return _at(path, np.minimum(np.arange(path.shape[2]), np.maximum(last - blown_up, 0)))


def _thinned(env: AnyEnv, episodes: Episodes) -> Float[np.ndarray, "task episode point 2"]:
    """Return some points of each path, evenly from its start to its end."""
    times = np.linspace(0.0, episodes.valid.sum(-1), _POINTS, axis=-1)
    return _at(_paths(env, episodes), times.round().astype(int))


def _at(path: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the places of paths at some times of each, `[task, episode, time]`."""
    return np.take_along_axis(path, times[..., None], axis=2)


def record_exploration(run: Run, path: Path) -> None:
    """Play what the figures of exploration show of a run, and record it in an `.npz` file."""
    tasks, env = run.task_set(RECORDED_TASKS), run.env()
    keys = jax.random.split(jax.random.key(0), EXPLORATION_TASKS)
    old, new = map(run.learner.fast_learner, (run.latest_state(), run.untrained_state()))
    trained, untrained = (one.agents(one.init(keys)) for one in (old, new))
    with closing(run.world(tasks)) as world:
        collect = Collector(world, EXPLORATION_EPISODES // EXPLORATION_TASKS)
        untrained_paths, _ = explore(untrained, collect, keys)
        prior_paths, prior_latents = explore(trained, collect, keys)
        fixed_paths = None
        if isinstance(trained.context, Latent):
            fixed_paths, _ = explore(trained.at_mean(), collect, keys)
        # As many episodes of every task as the trained policy's share of goals is counted among.
        reach = adapt(new, Collector(world, EXPLORATION_EPISODES), episodes=0).explored
    goal, landmarks = jax.vmap(env.goal), jax.vmap(env.landmarks)
    recorded = RecordedExploration(
        training_goals=np.asarray(goal(run.training_tasks.tasks)),
        goals=np.asarray(goal(tasks.tasks)),
        sparse_radius=env.sparse_radius,
        prior_paths=prior_paths,
        untrained_paths=untrained_paths,
        untrained_success_rate=np.asarray(reach.success_rate[:, 0]),
        solved_at_reset=np.asarray(reach.solved_at_reset[:, 0]),
        episodes_per_task=EXPLORATION_EPISODES,
        training_landmarks=np.asarray(landmarks(run.training_tasks.tasks)),
        landmarks=np.asarray(landmarks(tasks.tasks)),
        fixed_paths=fixed_paths,
        prior_latents=prior_latents,
    )
    # What a family or a method lacks is None, or has no elements.
    arrays = {name: one for name, one in vars(recorded).items() if one is not None and np.size(one)}
    write_arrays(path, arrays)


def record_explorer(run: Run) -> None:
    """Record paths of latents, if a run has any, and searches, if it has a prior over returns."""
    latent = run.learner.fast_learner(run.latest_state()).latent
    if latent is None:
        return
    latents = spread_latents(latent.size)
    keys, paths = jax.random.split(jax.random.key(0), len(latents)), []
    with closing(run.world(run.task_set(RECORDED_TASKS), reward_kind="sparse")) as world:
        collect = Collector(world, 1)
        for part in collect.parts(len(latents)):
            # One episode of each latent, all in the first task.
            slots = jnp.zeros(len(keys[part]), int)
            played = collect(keys[part], latent.holding(latents[part]), slots)
            paths.append(_thinned(world.env, played)[:, 0])
        has_prior = prior_file(run, world.env).exists()
    arrays = {"latents": latents, "paths": np.concatenate(paths)}
    write_arrays(run.directory / LATENT_PATHS, arrays)
    (run.directory / SEARCHES).unlink(missing_ok=True)  # may be of another prior
    if has_prior:
        try:
            write_arrays(run.directory / SEARCHES, _searches(run))
        except RunError as error:  # the prior may be that of earlier weights
            logger.warning("no search is shown: %s", error)


def record_belief(run: Run) -> None:
    """Record the belief in the last test task, where a learner holds one and sees where it is."""
    learner, state, tasks = run.learner, run.latest_state(), run.task_set(RECORDED_TASKS)
    fast, keys = learner.fast_learner(state), jax.random.split(jax.random.key(0), 1)
    episodes = fast.capabilities.trial_episodes
    if episodes is None or run.env().observation_size != 2:
        return
    with closing(run.world(tasks, reward_kind="sparse")) as world:
        last = jnp.array([len(tasks) - 1])
        _, played = _play_on(fast, Collector(world, 1), keys, last, episodes)
        goals = np.asarray(jax.vmap(world.env.goal)(tasks.tasks))
        radius = world.env.sparse_radius
        paths = np.concatenate([_paths(world.env, one)[0] for one in played])
    corners = np.stack([goals.min(0) - radius, goals.max(0) + radius])
    shares = (np.arange(_PLACES) + 0.5) / _PLACES
    columns, rows = np.meshgrid(*(corners[0] + shares[:, None] * (corners[1] - corners[0])).T)
    belief = learner.belief(state, played, np.stack([columns, rows], -1).reshape(-1, 2))
    if belief is None:
        return
    last_step = belief.mean.shape[1] - 1
    step = np.linspace(0, last_step, min(last_step, _MOMENTS) + 1).round()
    mean, std, predicted = (np.asarray(x[0])[step.astype(int)] for x in belief)
    arrays = {
        "task": len(tasks) - 1,
        "step": step,  # steps of the trial so far
        "mean": mean,
        "std": std,
        "predicted": predicted.reshape(-1, _PLACES, _PLACES),
        "corners": corners,
        "paths": paths,
    }
    write_arrays(run.directory / BELIEF, arrays)


def spread_latents(size: int) -> np.ndarray:
    """Return latents all over the space, `[latent, z]`: a lattice, or draws where it has many axes.

    Draws are uniform in a cube, and the same each time.
    """
    if size > 2:
        return np.random.default_rng(0).uniform(-_EDGE, _EDGE, (_LATENTS, size))
    axis = np.linspace(-_EDGE, _EDGE, round(_LATENTS ** (1 / size)))
    return np.array(list(itertools.product(axis, repeat=size)))


def _searches(run: Run) -> dict[str, Any]:
    """Return arrays of latent search in some new tasks, one episode after the other.

    Beliefs are about the part of the return that depends on the latent. They cover a square of the
    first two components, from -edge to edge; the others are those of the deployed latent.
    """
    asked = Evaluation(rule=SearchRule(), num_tasks=_TASKS)
    with new_tasks(run, asked) as (world, learner):
        tasks = np.arange(asked.count(world.tasks))
        collect, keys = Collector(world, 1), jax.random.split(jax.random.key(0), len(tasks))
        states, played = _play_on(learner, collect, keys, jnp.asarray(tasks), _EPISODES)
    episodes = jax.tree.map(lambda *batches: jnp.concatenate(batches, axis=1), *played)
    searches = list(zip(*(state.searches for state in states), strict=True))  # [task][episode]
    beliefs = np.array([[_beliefs(one) for one in task] for task in searches])
    return {
        "task": tasks,
        "edge": _EDGE,
        "played": episodes.z,
        "returns": episodes.undiscounted_return,
        **({"reached": episodes.success} if world.env.defines_success else {}),
        "paths": _thinned(world.env, episodes),
        # Before each episode and after the last, `[task, episode_plus_1, ...]`:
        "deployed": [[one.points[one.best] for one in task] for task in searches],
        "mean": beliefs[:, :, 0],
        "std": beliefs[:, :, 1],
        "interval": [[one.interval(one.best) for one in task] for task in searches],
        "familiar": [[one.posterior.familiar for one in task] for task in searches],
    }


def _play_on(
    learner: AbstractFastLearner[Any],
    collect: Collector,
    keys: TaskKeys,
    tasks: Int[Array, " task"],
    episodes: int,
) -> tuple[list[Any], list[Episodes]]:
    """Play and learn, one episode after the other; return states, one more, and episodes."""
    states, played = [learner.init(keys)], []
    for episode in range(episodes):
        episode_keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, episode)
        played.append(collect(episode_keys, learner.agents(states[-1]), tasks))
        states.append(learner.update(states[-1], played[-1]))
    return states, played


def _beliefs(search: LatentSearch) -> np.ndarray:
    """Return posterior mean and standard deviation over the plane, `[2, row, column]`."""
    axis = np.linspace(-_EDGE, _EDGE, _BELIEFS)
    plane = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    points = np.tile(search.points[search.best], (len(plane), 1))
    width = min(2, points.shape[1])
    points[:, :width] = plane[:, :width]
    more = search.posterior.extended(points)
    found = np.stack([more.mean, more.std])[:, -len(points) :]
    return found.reshape(2, _BELIEFS, _BELIEFS)
