"""From the same recorded episodes the runtime makes the library's update."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import keys
from runtime.robot import fast_learner

from maesn.context import Latent
from maesn.envs import Point, point
from maesn.evaluation.exporting import exported_policy
from maesn.experience.episodes import Episodes
from maesn.inner.adaptation import StepSchedule
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.numerics import DiagonalGaussian
from maesn.runtime import Episode, Explorer, ExplorerState
from maesn.runtime import Latent as RuntimeLatent
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

NUM_TASKS = 3
NUM_EPISODES = 20
TOLERANCE = 1e-5


def recorded(episodes: Episodes, task: int) -> tuple[Episode, ...]:
    """One task's episodes as the robot would have recorded them: without masked steps."""
    found = []
    for number in range(episodes.reward.shape[1]):
        valid = np.asarray(episodes.valid[task, number])
        observation, action, reward, drawn = (
            np.asarray(array[task, number], np.float64)
            for array in (episodes.observation, episodes.action, episodes.reward, episodes.z)
        )
        observation, action = observation[:-1][valid], action[valid]
        found.append(Episode(drawn, observation, action, action, reward[valid]))
    return tuple(found)


def explorers(learner: GradientFastLearner) -> list[Explorer]:
    exported = exported_policy(learner, Point(), {})
    return [Explorer(exported) for _ in range(NUM_TASKS)]


def adapted(explorer: Explorer, episodes: tuple[Episode, ...]) -> Explorer:
    """The explorer after learning from episodes that were recorded elsewhere."""
    latent = RuntimeLatent(explorer.latent_mean, np.log(explorer.latent_std))
    following = Explorer(
        explorer.exported, ExplorerState(latent, explorer.update, episodes=episodes)
    )
    following.adapt()
    return following


def synthetic(learner: GradientFastLearner, context: Any, seed: int) -> Episodes:
    """Random episodes of different lengths, with NaN after their ends."""
    generator = np.random.default_rng(seed)
    shape, steps = (NUM_TASKS, NUM_EPISODES), 30
    dtype = np.dtype(jnp.zeros(()).dtype)
    length = generator.integers(1, steps + 1, shape)
    valid = np.arange(steps) < length[..., None]
    noise = generator.standard_normal((*shape, 2)).astype(dtype)
    drawn = np.asarray(context.mean)[:, None] + np.exp(np.asarray(context.log_std))[:, None] * noise
    action = generator.standard_normal((*shape, steps, 2)).astype(dtype)
    observation = (5.0 * generator.standard_normal((*shape, steps + 1, 2))).astype(dtype)
    reward = (generator.standard_normal((*shape, steps)) + drawn[..., :1]).astype(dtype)
    observation[:, :, :-1][~valid] = np.nan
    reward[~valid] = np.nan
    return Episodes(
        observation=jnp.asarray(observation),
        action=jnp.asarray(action),
        reward=jnp.asarray(reward),
        goal_reward=jnp.asarray(reward),
        valid=jnp.asarray(valid),
        solved=jnp.zeros(valid.shape, bool),
        solved_at_start=jnp.zeros(shape, bool),
        terminated=jnp.asarray(length < steps),
        noise=jnp.asarray(noise),
        description=jnp.zeros((*shape, 0), dtype),
        z=jnp.asarray(drawn.astype(dtype)),
        behaviour=DiagonalGaussian(jnp.asarray(action), jnp.zeros(action.shape, dtype)),
        trial_end=None,
    )


def differences(learner: GradientFastLearner, num_updates: int, collect: Any) -> np.ndarray:
    """Largest difference of the latents after each of several updates, accumulating."""
    state, robots, found = learner.init(keys(NUM_TASKS)), explorers(learner), []
    for update in range(num_updates):
        episodes = collect(state, update)
        state = learner.update(state, episodes)
        robots = [adapted(robot, recorded(episodes, i)) for i, robot in enumerate(robots)]
        context = state.agents.context
        assert isinstance(context, Latent)
        mean = np.stack([robot.latent_mean for robot in robots]) - np.asarray(context.mean)
        std = np.stack([robot.latent_std for robot in robots])
        found.append(max(abs(mean).max(), abs(np.log(std) - np.asarray(context.log_std)).max()))
    return np.asarray(found)


def test_on_episodes_of_the_point_robot() -> None:
    learner = fast_learner()
    collector = Collector(make_world(Point(), point.task_set("test")), NUM_EPISODES)

    def collect(state: Any, update: int) -> Episodes:
        return collector(keys(NUM_TASKS, update), learner.agents(state), jnp.arange(NUM_TASKS))

    assert (differences(learner, 4, collect) < TOLERANCE).all()


def test_on_random_episodes_of_different_lengths() -> None:
    learner = fast_learner(schedule=StepSchedule(3, 0.8, 0.7))
    found = differences(
        learner, 6, lambda state, update: synthetic(learner, state.agents.context, update)
    )
    assert (found < TOLERANCE).all()


@pytest.mark.usefixtures("x64")
def test_exactly_in_double_precision() -> None:
    # What is left above is the rounding of the library's single precision.
    learner = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float64) if isinstance(leaf, jax.Array) else leaf,
        fast_learner(),
    )
    found = differences(
        learner, 3, lambda state, update: synthetic(learner, state.agents.context, update)
    )
    assert (found < 1e-10).all()
