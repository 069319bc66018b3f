"""Evaluation: what is measured, and that chunks do not change it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import HiddenEnd, hidden_end

from maesn import maesn
from maesn.axes import Readings
from maesn.envs import Wheeled, point, wheeled
from maesn.evaluation.adapting import AdaptationCurves, adapt, as_rows, measure
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.exploration import explore
from maesn.experience.episodes import Episodes
from maesn.learners import Problem
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.learners.scratch.policy_gradient import reinforce
from maesn.numerics import DiagonalGaussian
from maesn.policies import GaussianMLP
from maesn.worlds import EpisodeError, budget, make_world
from maesn.worlds.collector import Collector

EPISODES = 6
NUM_TASKS = 5


@pytest.fixture(scope="module")
def collect() -> Collector:
    env = point.make_env(reward_kind="sparse", sparse_radius=1.8)
    return Collector(make_world(env, point.task_set("test", size=NUM_TASKS)), EPISODES)


@pytest.fixture(scope="module")
def learner() -> GradientFastLearner:
    meta = maesn(policy=GaussianMLP(hidden_sizes=(8,)), meta_batch_size=2)
    return meta.fast_learner(meta.init(jax.random.key(3), Problem(2, 2, 10)))


def test_measures_of_two_episodes_worked_out_by_hand() -> None:
    # One task, two episodes of four steps; the second ends after its second step, so that its
    # last two steps are garbage. Returns: 1+2+3+4 = 10 and 5+6 = 11, mean 10.5. Goal: 4 and -2.
    # Solved steps: t = 1, 3 of the first and t = 0 of the second: both reach it, the first alone
    # ends in it, and 3 of 6 valid steps are spent there. The second starts in it as well.
    valid = jnp.array([[[True] * 4, [True, True, False, False]]])
    steps = jnp.zeros((1, 2, 4, 1))
    episodes = Episodes(
        observation=jnp.zeros((1, 2, 5, 1)),
        action=steps,
        reward=jnp.array([[[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, jnp.nan, 99.0]]]),
        goal_reward=jnp.array([[[1.0, 1.0, 1.0, 1.0], [-1.0, -1.0, jnp.nan, 99.0]]]),
        valid=valid,
        solved=jnp.array([[[False, True, False, True], [True, False, True, True]]]),
        solved_at_start=jnp.array([[False, True]]),
        terminated=jnp.array([[False, True]]),
        noise=jnp.zeros((1, 2, 1)),
        description=jnp.zeros((1, 2, 0)),
        z=jnp.zeros((1, 2, 1)),
        behaviour=DiagonalGaussian(steps, steps),
        trial_end=None,
    )
    curves = measure(episodes)
    np.testing.assert_allclose(curves.mean_return, [10.5])
    np.testing.assert_allclose(curves.goal_return, [1.0])
    np.testing.assert_allclose(curves.success_rate, [1.0])
    np.testing.assert_allclose(curves.final_success_rate, [0.5])
    np.testing.assert_allclose(curves.time_in_region, [0.5])
    np.testing.assert_allclose(curves.solved_at_reset, [0.5])


@pytest.mark.parametrize(
    "chunk_size",
    [2, 100, *(pytest.param(size, marks=pytest.mark.long) for size in (1, 4))],
)
def test_chunks_change_nothing(
    collect: Collector, learner: GradientFastLearner, chunk_size: int
) -> None:
    whole, parts = (
        adapt(learner, collect, Evaluation(seed=4, tasks_at_once=size), episodes=2 * EPISODES)
        for size in (NUM_TASKS, chunk_size)
    )
    assert whole.curves.mean_return.shape == (NUM_TASKS, 3)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True):
        # The compiler may round differently for other shapes.
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-4)


def test_a_family_without_success_has_returns_alone(
    collect: Collector, learner: GradientFastLearner, monkeypatch: pytest.MonkeyPatch
) -> None:
    def both() -> tuple[AdaptationCurves, AdaptationCurves]:
        outcome = adapt(learner, collect, Evaluation(deploy_episodes=2), episodes=EPISODES)
        assert outcome.deployed is not None
        return outcome.explored, outcome.deployed

    usual = both()
    monkeypatch.setattr(type(collect.world.env), "defines_success", False)
    for curves, before in zip(both(), usual, strict=True):
        for name in ("success_rate", "final_success_rate", "time_in_region"):
            assert np.isnan(getattr(curves, name)).all()
            assert np.isfinite(getattr(before, name)).all()
        np.testing.assert_array_equal(curves.mean_return, before.mean_return)


def test_as_many_tasks_advance_together_as_the_memory_takes(
    collect: Collector, learner: GradientFastLearner, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_task = budget.least_bytes(collect.world.env, EPISODES)
    monkeypatch.setattr(budget, "memory", lambda: round(2.5 * of_task / budget.SHARE))
    sizes: list[int] = []
    watched = Collector(
        collect.world, EPISODES, lambda episodes, *_: sizes.append(len(episodes.reward))
    )
    adapt(learner, watched, Evaluation(), episodes=0)
    assert sizes == [2] * -(-NUM_TASKS // 2)


def test_the_latents_move_and_the_seed_matters(
    collect: Collector, learner: GradientFastLearner
) -> None:
    one = adapt(learner, collect, Evaluation(seed=1), episodes=EPISODES)
    other = adapt(learner, collect, Evaluation(seed=2), episodes=EPISODES)
    assert np.all(one.contexts.mean[:, 0] == 0)
    assert np.all(np.abs(one.contexts.mean[:, 1]).sum(-1) > 0)
    assert not np.array_equal(one.curves.mean_return, other.curves.mean_return)


def explored(
    learner: GradientFastLearner, collect: Collector, num_tasks: int, at_mean: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Paths and latents of a learner that has learned nothing yet."""
    keys = jax.random.split(jax.random.key(0), num_tasks)
    agents = learner.agents(learner.init(keys))
    return explore(agents.at_mean() if at_mean else agents, collect, keys)


def test_exploration_draws_z_or_holds_it(collect: Collector, learner: GradientFastLearner) -> None:
    many, latents = explored(learner, collect, NUM_TASKS + 1)
    # Every episode is one of its own, in the task that is played again as well.
    assert len(np.unique(many[:, -1], axis=0)) == len(latents) == (NUM_TASKS + 1) * EPISODES
    paths, latents = explored(learner, collect, 1)
    fixed_paths, _ = explored(learner, collect, 1, at_mean=True)
    assert paths.shape == (EPISODES, collect.world.env.horizon + 1, 2)
    # The start and the noise of the actions are the same; only z differs.
    np.testing.assert_array_equal(paths[:, 0], fixed_paths[:, 0])
    assert np.ptp(latents, axis=0).min() > 1e-4
    assert not np.array_equal(paths, fixed_paths)


SHORT_LIVES = hidden_end.task_set("test", size=4)


class LostEnd(HiddenEnd):
    """What is seen of the state that ends an episode is NaN."""

    def observe(self, readings: Readings) -> jax.Array:
        share = readings["qpos"][:1] / self.horizon
        return jnp.where(self.terminated(readings), jnp.nan, share)


@pytest.mark.parametrize(("env", "lost"), [(HiddenEnd(), 0), (LostEnd(), 1)])
def test_paths_stay_where_their_episodes_end(env: HiddenEnd, lost: int) -> None:
    meta = maesn(policy=GaussianMLP(hidden_sizes=(8,)), meta_batch_size=2)
    state = meta.init(jax.random.key(0), Problem(env.observation_size, env.action_size, 10))
    collect = Collector(make_world(env, SHORT_LIVES), 1)
    paths, _ = explored(meta.fast_learner(state), collect, 4)
    # The probe shows the share of the horizon that is over. A state that blew up is no place.
    last = np.minimum(np.ceil(SHORT_LIVES.tasks) - lost, env.horizon)
    expected = np.minimum(np.arange(env.horizon + 1), last[:, None]) / env.horizon
    assert (last < env.horizon).any()
    np.testing.assert_allclose(paths[..., 0], expected, rtol=1e-6)


def test_an_agent_that_its_updates_have_led_astray() -> None:
    env = Wheeled(horizon=4)
    collect = Collector(make_world(env, wheeled.task_set("test", size=2)), episodes_per_task=3)
    learner = reinforce(env.observation_size, env.action_size, step_size=1e30)
    with pytest.raises(EpisodeError, match=r"wheeled, task 0, .* \(after update 1 in this task"):
        adapt(learner, collect, episodes=6)


def test_fresh_episodes_judge_the_deployed_mean(
    collect: Collector, learner: GradientFastLearner
) -> None:
    done = adapt(learner, collect, Evaluation(deploy_episodes=3), episodes=EPISODES)
    assert done.deployed is not None
    assert done.curves is done.deployed
    purposes = [row["purpose"] for row in as_rows(done)]
    assert purposes == ["explore"] * 2 * NUM_TASKS + ["deploy"] * 2 * NUM_TASKS
    # With z at the prior's mean in all episodes of all tasks, nothing but noise tells them apart.
    spread = [np.std(curves.mean_return[:, 0]) for curves in (done.deployed, done.explored)]
    assert spread[0] < spread[1]
