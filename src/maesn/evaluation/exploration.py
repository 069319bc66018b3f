"""How an agent explores before it has learned anything of its task, recorded for figures."""

import dataclasses
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.evaluation.evaluate import adapt, tasks_at_once
from maesn.experience.agent import Agents
from maesn.learners import AbstractFastLearner
from maesn.runs.run import Run
from maesn.storage import write_arrays
from maesn.worlds.collector import Collector

# Episodes that figures show, and tasks that they are spread over: where the agent sees what differs
# between tasks, one would be no fair sample.
EXPLORATION_EPISODES = 50
EXPLORATION_TASKS = 5
# Where they are recorded in a run directory.
EXPLORATION = Path("figures") / "exploration.npz"

Paths = Float[np.ndarray, "episode time_plus_1 2"]


class Exploration(NamedTuple):
    """Planar paths of an agent that has not learned anything about its task yet, in metres."""

    prior_paths: Paths
    """z drawn from the prior in every episode."""
    prior_latents: Float[np.ndarray, "episode z"]
    """The z of those episodes."""
    fixed_paths: Paths | None
    """z held at the prior's mean: the noise of the actions alone. None without a latent."""


def explore(
    learner: AbstractFastLearner[Any], collect: Collector, num_tasks: int = 1, seed: int = 0
) -> Exploration:
    """Play in the first tasks of a world, once drawing z and once holding it at its mean."""
    keys = jax.random.split(jax.random.key(seed), num_tasks)
    agents = learner.agents(learner.init(keys))
    paths, latents = _play(agents, collect, keys)
    if not isinstance(agents.context, Latent):
        return Exploration(paths, latents, None)
    fixed = dataclasses.replace(agents, context=agents.context.at_mean())
    return Exploration(paths, latents, _play(fixed, collect, keys)[0])


def _play(agents: Agents, collect: Collector, keys: TaskKeys) -> tuple[Paths, Any]:
    """Return the paths and the latents of all episodes, task by task."""
    episodes = collect(keys, agents, jnp.arange(len(keys)) % collect.num_tasks)
    position = jax.vmap(jax.vmap(jax.vmap(collect.world.env.position)))(episodes.observation)
    paths = jax.vmap(jax.vmap(_until_the_end))(position, episodes.valid)
    return np.concatenate(paths), np.concatenate(episodes.z)


def _until_the_end(
    path: Float[Array, "time_plus_1 2"], valid: Bool[Array, " time"]
) -> Float[Array, "time_plus_1 2"]:
    """Let a path stay where its episode ended, or a step earlier if the physics blew up there."""
    last = valid.sum()
    last = jnp.where(jnp.isfinite(path[last]).all(), last, jnp.maximum(last - 1, 0))
    return path[jnp.minimum(jnp.arange(len(path)), last)]


def record_exploration(run: Run) -> None:
    """Play and record what the figures of exploration show, in the run's directory."""
    tasks, env = run.task_set("test"), run.env()
    old, new = map(run.learner.fast_learner, (run.latest_state(), run.untrained_state()))
    with closing(run.world(tasks)) as world:
        collect = Collector(world, EXPLORATION_EPISODES // EXPLORATION_TASKS)
        trained, untrained = (explore(one, collect, EXPLORATION_TASKS) for one in (old, new))
        # As many episodes of every task as the trained policy's share of goals is counted among.
        at_once = tasks_at_once(world.max_simulations, EXPLORATION_EPISODES)
        everywhere = Collector(world, EXPLORATION_EPISODES)
        reach = adapt(new, everywhere, episodes=0, chunk_size=at_once).explored
    goal, landmarks = jax.vmap(env.goal), jax.vmap(env.landmarks)
    arrays = {
        "training_goals": goal(run.training_tasks.tasks),
        "goals": goal(tasks.tasks),
        "sparse_radius": np.asarray(env.sparse_radius),
        "prior_paths": trained.prior_paths,
        "untrained_paths": untrained.prior_paths,
        "prior_latents": trained.prior_latents,
        "untrained_success_rate": reach.success_rate[:, 0],
        "solved_at_reset": reach.solved_at_reset[:, 0],
        "episodes_per_task": np.asarray(EXPLORATION_EPISODES),
    }
    if trained.fixed_paths is not None:
        arrays["fixed_paths"] = trained.fixed_paths
    if landmarks(tasks.tasks).size:
        arrays["training_landmarks"] = landmarks(run.training_tasks.tasks)
        arrays["landmarks"] = landmarks(tasks.tasks)
    write_arrays(run.directory / EXPLORATION, arrays)
