"""Episodes of exploration, recorded in a run directory for its figures."""

from contextlib import closing
from pathlib import Path

import jax
import numpy as np

from maesn.evaluation.evaluate import adapt, tasks_at_once
from maesn.evaluation.explore import explore
from maesn.runs.run import Run
from maesn.storage import write_arrays
from maesn.worlds.collector import Collector

# Episodes that figures show, and tasks that they are spread over: where the agent sees what differs
# between tasks, a single one would not be a fair sample.
EXPLORATION_EPISODES = 50
EXPLORATION_TASKS = 5
# Where they are recorded in a run directory.
EXPLORATION = Path("figures") / "exploration.npz"


def record_exploration(run: Run) -> Path:
    """Play and record what the figures of exploration show."""
    tasks, env = run.task_set("test"), run.env()
    new = run.learner.fast_learner(run.untrained_state())
    with closing(run.world(tasks)) as world:
        collect = Collector(world, EXPLORATION_EPISODES // EXPLORATION_TASKS)
        trained = explore(
            run.learner.fast_learner(run.latest_state()), collect, num_tasks=EXPLORATION_TASKS
        )
        untrained = explore(new, collect, num_tasks=EXPLORATION_TASKS)
        # As many episodes of every task as the trained policy's share of goals is counted among.
        at_once = tasks_at_once(world.max_simulations, EXPLORATION_EPISODES)
        everywhere = Collector(world, EXPLORATION_EPISODES)
        reach = adapt(new, everywhere, updates=0, chunk_size=at_once).curves
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
    path = run.directory / EXPLORATION
    write_arrays(path, arrays)
    return path
