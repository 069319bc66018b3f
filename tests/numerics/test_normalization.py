"""Normalised observations: the statistics, what they change, and what they must leave alone."""

from functools import cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import keys
from small_runs import create, finish, metrics, reopened, tensors, tiny_maesn

from maesn.envs import point
from maesn.evaluation.exporting import exported_policy
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractMetaLearner, Problem
from maesn.learners.gradient.meta_learner import GradientState
from maesn.numerics.normalization import ObservationStatistics, no_observations
from maesn.runs.checkpoint import read_checkpoint
from maesn.serialization import from_json, to_json
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


def test_batches_add_up_to_the_statistics_of_all_that_was_seen() -> None:
    stream = np.random.default_rng(0)
    statistics, everything = no_observations(3), []
    with_batch = jax.jit(ObservationStatistics.with_batch)
    for size in (7, 40, 0, 1):
        # Far from 0, where naive sums of squares lose all digits in single precision.
        batch = np.float32(stream.normal([1e3, -5, 0], [1, 10, 0], (2, size, 3)))
        seen = stream.random((2, size)) < 0.7
        everything.append(batch[seen])
        batch[~seen] = np.nan
        statistics = with_batch(statistics, jnp.asarray(batch), jnp.asarray(seen))
    joined = np.concatenate(everything).astype(np.float64)
    assert statistics.count == len(joined)
    np.testing.assert_allclose(statistics.mean, joined.mean(0), rtol=1e-6)
    np.testing.assert_allclose(statistics.variance, joined.var(0), rtol=1e-4)
    normal = statistics.normalized(jnp.asarray(np.float32(joined)))
    np.testing.assert_allclose(normal.mean(0), 0, atol=1e-3)
    np.testing.assert_allclose(normal.std(0)[:2], 1, rtol=1e-4)


def test_before_anything_was_seen_observations_are_as_they_are() -> None:
    observation = jnp.asarray([[1.5, -1e6], [np.pi, 1e-8]])
    np.testing.assert_array_equal(no_observations(2).normalized(observation), observation)


class Recorder:
    """Passes on what a collector plays, and keeps it."""

    def __init__(self) -> None:
        world = make_world(point.make_env(), point.task_set("training"))
        self._collect = Collector(world, 3)
        self.played: list[Episodes] = []

    @property
    def num_tasks(self) -> int:
        return self._collect.num_tasks

    @property
    def episodes_per_task(self) -> int:
        return self._collect.episodes_per_task

    def __call__(self, keys: Any, agents: Agents, task_index: Any, stage: int = 0) -> Episodes:
        self.played.append(self._collect(keys, agents, task_index, stage))
        return self.played[-1]


LEARNER = tiny_maesn(normalize_observations=True)


@cache
def trained(iterations: int) -> tuple[GradientState, Recorder]:
    learner, collect = LEARNER, Recorder()
    state = learner.init(jax.random.key(0), Problem(2, 2, collect.num_tasks))
    for iteration in range(iterations):
        state, _ = learner.step(jax.random.key(iteration), state, collect)
    return state, collect


@pytest.mark.long
def test_a_learner_sees_by_the_statistics_of_the_iterations_before() -> None:
    state, collect = trained(2)
    seen = np.concatenate(
        [np.asarray(x.observation)[..., :-1, :].reshape(-1, 2) for x in collect.played]
    )
    assert state.statistics is not None
    np.testing.assert_allclose(state.statistics.mean, seen.mean(0), atol=1e-5)
    np.testing.assert_allclose(state.statistics.variance, seen.var(0), rtol=1e-3)
    # The last two collections are of the second iteration: its policies were normalised by the
    # first one's observations, the adapted ones included.
    first, _ = trained(1)
    assert first.statistics is not None
    before = collect.played[2]
    scale = np.sqrt(np.asarray(first.statistics.variance) + 1e-8)
    normal = (
        np.asarray(before.observation)[..., :-1, :] - np.asarray(first.statistics.mean)
    ) / scale
    context = np.broadcast_to(
        np.asarray(before.z)[..., None, :], (*normal.shape[:3], before.z.shape[-1])
    )
    inputs = jnp.asarray(np.float32(np.concatenate([normal, context], axis=-1)))
    mean = jax.jit(jax.vmap(jax.vmap(jax.vmap(first.parameters.policy.mlp))))(inputs)
    np.testing.assert_allclose(before.behaviour.mean, mean, atol=1e-5)


def test_the_ratio_of_the_outer_step_starts_at_one() -> None:
    # Only if the loss sees observations as the episodes' policies did, their KL is 0 at first.
    state, collect = trained(1)
    info = LEARNER.step(jax.random.key(5), state, collect)[1]
    assert 0 < float(info.outer.kl) < 0.02
    assert bool(info.outer.accepted)


def test_in_a_new_task_the_statistics_are_frozen() -> None:
    state, collect = trained(1)
    fast = LEARNER.fast_learner(state)
    start = fast.init(keys(4))
    episodes = collect(keys(4), fast.agents(start), jnp.arange(4))
    after = fast.update(start, episodes)
    jax.tree.map(np.testing.assert_array_equal, fast.agents(after).statistics, state.statistics)


def test_runs_keep_the_statistics_and_resume_with_them(tmp_path: Path) -> None:
    learner = LEARNER
    whole = finish(create(tmp_path / "whole", learner, iterations=2))
    parted = create(tmp_path / "parted", learner, iterations=2)
    finish(parted, 1)
    finish(reopened(parted))
    assert tensors(whole.checkpoints()[-1]) == tensors(parted.checkpoints()[-1])
    assert metrics(whole) == metrics(parted)
    counts = read_checkpoint(whole.checkpoints()[-1])[0]["statistics/count"]
    assert counts == 2 * 2 * 4 * 3 * 40  # iterations, collections, tasks, episodes, steps


def test_a_robot_computes_the_same_policy() -> None:
    state, _ = trained(2)
    statistics = ObservationStatistics(jnp.float32(9), jnp.float32([3, -1]), jnp.float32([4, 1e-4]))
    state = eqx.tree_at(lambda x: x.statistics, state, statistics)
    fast = LEARNER.fast_learner(state)
    robot = exported_policy(fast, point.make_env(), {}).policy
    stream = np.random.default_rng(0)
    for _ in range(20):
        latent, observation = stream.normal(size=2), stream.normal([3, -1], [2, 1e-2])
        seen = (observation - [3, -1]) / np.sqrt(np.array([4, 1e-4]) + 1e-8)
        wanted = fast.policy.mlp(jnp.asarray(np.float32([*seen, *latent])))
        np.testing.assert_allclose(robot.given(latent).mean(observation), wanted, atol=1e-4)


def test_learners_with_normalization_say_so_in_files() -> None:
    learner = tiny_maesn(normalize_observations=True)
    assert to_json(learner)["normalize_observations"] is True
    assert from_json(to_json(learner), AbstractMetaLearner) == learner
    assert to_json(learner) != to_json(tiny_maesn())
