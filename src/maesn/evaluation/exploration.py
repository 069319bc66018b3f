"""How an agent explores before it has learned anything of its task, recorded for figures."""

import dataclasses
from contextlib import closing
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.evaluation.evaluate import adapt
from maesn.experience.agent import Agents
from maesn.learners import AbstractFastLearner
from maesn.reporting.runs import EXPLORATION, RecordedExploration
from maesn.runs.run import Run
from maesn.storage import write_arrays
from maesn.worlds.collector import Collector

# Episodes that figures show, and tasks that they are spread over: where the agent sees what differs
# between tasks, one would be no fair sample.
EXPLORATION_EPISODES = 50
EXPLORATION_TASKS = 5

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
    learner: AbstractFastLearner[Any], collect: Collector, num_tasks: int = 1
) -> Exploration:
    """Play in the first tasks of a world, once drawing z and once holding it at its mean."""
    keys = jax.random.split(jax.random.key(0), num_tasks)
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
        reach = adapt(new, Collector(world, EXPLORATION_EPISODES), episodes=0).explored
    goal, landmarks = jax.vmap(env.goal), jax.vmap(env.landmarks)
    recorded = RecordedExploration(
        training_goals=np.asarray(goal(run.training_tasks.tasks)),
        goals=np.asarray(goal(tasks.tasks)),
        sparse_radius=env.sparse_radius,
        untrained_paths=untrained.prior_paths,
        untrained_success_rate=np.asarray(reach.success_rate[:, 0]),
        solved_at_reset=np.asarray(reach.solved_at_reset[:, 0]),
        episodes_per_task=EXPLORATION_EPISODES,
        training_landmarks=np.asarray(landmarks(run.training_tasks.tasks)),
        landmarks=np.asarray(landmarks(tasks.tasks)),
        **trained._asdict(),
    )
    # What a family or a method lacks is None, or has no elements.
    held = vars(recorded).items()
    arrays = {name: array for name, array in held if array is not None and np.size(array)}
    write_arrays(run.directory / EXPLORATION, arrays)
