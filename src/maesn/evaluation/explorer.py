"""Where each latent leads, and how a search finds a good one: recorded for the report page."""

import itertools
from contextlib import closing
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maesn.context import Latent
from maesn.envs import AnyEnv
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import new_tasks
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import GradientFastLearner
from maesn.reporting.runs import LATENT_PATHS, SEARCHES, LatentPaths, RecordedSearches
from maesn.rules import SearchRule
from maesn.runs.run import Run
from maesn.runtime.search import LatentSearch
from maesn.search.learner import SearchFastLearner
from maesn.search.stored import prior_file
from maesn.storage import write_arrays
from maesn.worlds.collector import Collector

_EDGE = 6.0  # of the latents, in standard deviations of the prior: adapted ones are that far out
_LATENTS = 441  # recorded paths: a lattice of 21 x 21 in the plane
_BELIEFS = 21  # points along each axis at which beliefs are recorded
_POINTS = 40  # positions kept of each path
_TASKS, _EPISODES = 8, 10  # of the searches


def record_explorer(run: Run) -> None:
    """Record paths of latents and, if the run has a prior over returns, searches.

    A run without latents is left as it is.

    Raises:
        RunError: the prior is of another checkpoint.
    """
    learner = run.learner.fast_learner(run.latest_state())
    if not isinstance(learner, GradientFastLearner):
        return
    if not isinstance(learner.context_table, Latent):
        return
    latents = spread_latents(learner.context_table.size)
    with closing(run.world(run.task_set("test"), reward_kind="sparse")) as world:
        paths = _paths_of(learner, Collector(world, 1), latents)
        has_prior = prior_file(run, world).exists()
    write_arrays(run.directory / LATENT_PATHS, vars(LatentPaths(latents, paths)))
    if has_prior:
        write_arrays(run.directory / SEARCHES, vars(_searches(run)))


def spread_latents(size: int) -> np.ndarray:
    """Return latents all over the space, `[latent, z]`: a lattice, or draws where it has many axes.

    Draws are uniform in a cube, and the same each time.
    """
    if size > 2:
        return np.random.default_rng(0).uniform(-_EDGE, _EDGE, (_LATENTS, size))
    axis = np.linspace(-_EDGE, _EDGE, round(_LATENTS ** (1 / size)))
    return np.array(list(itertools.product(axis, repeat=size)))


def _paths_of(learner: GradientFastLearner, collect: Collector, latents: np.ndarray) -> np.ndarray:
    """Play one episode of each latent in the first task, and return their paths."""
    mean = jnp.asarray(latents, jnp.float32)
    context = Latent(mean, jnp.zeros_like(mean)).at_mean()
    agents = Agents(learner.policy, context, shares_policy=True, statistics=learner.statistics)
    keys = jax.random.split(jax.random.key(0), len(latents))
    episodes = collect(keys, agents, jnp.zeros(len(latents), int))
    return _thinned(collect.world.env, episodes)


def _thinned(env: AnyEnv, episodes: Episodes) -> np.ndarray:
    """Return the path of each task's only episode, `[task, point, 2]`; it stays where it ends."""
    positions = jax.vmap(jax.vmap(env.position))(episodes.observation[:, 0])
    last = np.asarray(episodes.valid[:, 0].sum(-1))
    times = np.linspace(0.0, last, _POINTS).round().astype(int)  # [point, task]
    return np.asarray(positions)[np.arange(len(last))[:, None], times.T]


def _searches(run: Run) -> RecordedSearches:
    """Search in the first tasks of the test set."""
    rule = SearchRule()
    tasks = jnp.arange(_TASKS)
    axis = np.linspace(-_EDGE, _EDGE, _BELIEFS)
    plane = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    states: list[Any] = []
    played: list[Episodes] = []
    with new_tasks(run, Evaluation(rule=rule, num_tasks=_TASKS)) as (world, learner):
        assert isinstance(learner, SearchFastLearner)
        collect, keys = Collector(world, 1), jax.random.split(jax.random.key(0), _TASKS)
        states.append(learner.init(keys))
        for episode in range(_EPISODES):
            episode_keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, episode)
            played.append(collect(episode_keys, learner.agents(states[-1]), tasks))
            states.append(learner.update(states[-1], played[-1]))
        paths = [_thinned(world.env, episodes) for episodes in played]
    searches = [state.searches for state in states]
    beliefs = np.array([[_beliefs(one, plane) for one in after] for after in searches])
    mean, std = np.moveaxis(beliefs, 2, 0).swapaxes(1, 2)
    return RecordedSearches(
        task=np.arange(_TASKS, dtype=float),
        edge=_EDGE,
        played=np.stack([_z(episodes) for episodes in played], axis=1),
        returns=np.stack([episodes.undiscounted_return[:, 0] for episodes in played], axis=1),
        reached=np.stack([(one.valid & one.solved).any(-1)[:, 0] for one in played], axis=1).astype(
            float
        ),
        paths=np.stack(paths, axis=1),
        deployed=np.array([[one.latent(one.best) for one in after] for after in searches]).swapaxes(
            0, 1
        ),
        mean=mean,
        std=std,
    )


def _z(episodes: Episodes) -> np.ndarray:
    return np.asarray(episodes.z[:, 0])


def _beliefs(search: LatentSearch, plane: np.ndarray) -> np.ndarray:
    """Return posterior mean and standard deviation over the plane, `[2, row, column]`."""
    points = np.tile(search.latent(search.best), (len(plane), 1))
    width = min(2, points.shape[1])
    points[:, :width] = plane[:, :width]
    more = search.posterior.extended(search.model, points)
    found = np.stack([more.mean, more.std])[:, -len(points) :]
    return found.reshape(2, _BELIEFS, _BELIEFS)
