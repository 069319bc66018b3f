"""PEARL: its replay, its meta-iterations, new tasks, and what it is refused."""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.watching import EPISODES, TASKS, Watching

from maesn import PearlMetaLearner, pearl
from maesn.context import Latent
from maesn.learners import Problem
from maesn.learners.pearl.encoder import EncoderSettings, Factors
from maesn.learners.pearl.meta_learner import MOST_REPLAY_BYTES
from maesn.learners.pearl.replay import Replay, transitions_of
from maesn.learners.pearl.sac import SoftActorCritic
from maesn.search import latent_of

SMALL = {
    "encoder": EncoderSettings(2, (4,), context_size=6),
    "sac": SoftActorCritic((5,), batch_size=7),
    "meta_batch_size": 3,
    "gradient_steps": 4,
    "visited_tasks": 2,
    "initial_tasks": 3,
    "posterior_batches": 1,
    "replay_steps": 80,
}


def small(**settings: Any) -> PearlMetaLearner:
    return pearl(**SMALL | settings)


PROBLEM = Problem(1, 1, TASKS, horizon=6, episodes_per_task=EPISODES)


# Replay.


def test_transitions_end_with_their_episode() -> None:
    learner, collect = small(), Watching()
    state = learner.init(jax.random.key(0), PROBLEM)
    agents = state.networks.agents(state.networks.encoder.none(TASKS).posterior())
    keys = jax.random.split(jax.random.key(2), TASKS)
    episodes = collect(keys, agents, jnp.arange(TASKS))
    batch, valid = transitions_of(episodes)
    assert all(np.isfinite(x).all() for x in batch)
    # Every episode that terminates has one last transition, and those that run out of time none.
    ends = (np.asarray(batch.terminal) * np.asarray(valid)).sum(1)
    np.testing.assert_array_equal(ends, np.asarray(episodes.terminated).sum(1))
    assert ends.sum() > 0
    finite = np.isfinite(np.asarray(episodes.observation)[:, :, 1:]).all(-1)
    lasts = np.asarray(batch.terminal, bool).reshape(finite.shape)
    np.testing.assert_array_equal(
        np.asarray(valid).reshape(finite.shape), np.asarray(episodes.valid) & (finite | lasts)
    )


def filled(capacity: int, visits: int) -> tuple[Replay, list[Any]]:
    """A replay of tasks 1 and 3, each visit one batch of context and one for the critics alone."""
    learner, collect, played = small(), Watching(), []
    state = learner.init(jax.random.key(0), PROBLEM)
    replay, tasks = Replay.empty(TASKS, capacity, 1, 1), jnp.asarray([1, 3])
    for visit in range(visits):
        for is_context in (True, False):
            agents = state.networks.agents(state.networks.encoder.none(2).posterior())
            keys = jax.random.split(jax.random.key(2 * visit + is_context), 2)
            played.append(collect(keys, agents, tasks))
            replay = replay.add(tasks, played[-1], begins=is_context, is_context=is_context)
    return replay, played


@pytest.mark.parametrize("capacity", [200, 40])
def test_the_context_is_of_the_latest_visit_and_the_critics_see_all(capacity: int) -> None:
    replay, played = filled(capacity, visits=3)
    np.testing.assert_array_equal(replay.is_played, [False, True, False, True])
    tasks = jnp.asarray([3, 1])
    drawn = replay.sample_context(jax.random.key(0), tasks, 200)
    everything = replay.sample(jax.random.key(0), tasks, 400)
    for slot, row in enumerate([1, 0]):

        def actions(episodes: Any, row: int = row) -> set[float]:
            batch, valid = transitions_of(episodes)
            return set(np.asarray(batch.action)[row][np.asarray(valid)[row]].ravel().tolist())

        latest = actions(played[-2])
        assert set(np.asarray(drawn.action)[slot].ravel().tolist()) == latest
        kept = set(np.asarray(everything.action)[slot].ravel().tolist())
        assert actions(played[-1]) | latest <= kept
        assert kept <= set().union(*map(actions, played))
        assert len(kept) <= capacity


# Meta-iterations.


def test_a_meta_iteration_visits_infers_and_learns() -> None:
    learner, collect = small(), Watching()
    before = learner.init(jax.random.key(0), PROBLEM)
    after, info = learner.step(jax.random.key(1), before, collect)
    assert int(learner.iteration(after)) == 1
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after, info)))
    assert bool(info.accepted)
    moved = jax.tree.map(lambda x, y: bool((x != y).any()), before.networks, after.networks)
    assert all(jax.tree.leaves(moved))
    # Three tasks beforehand, two at once; then one batch from the prior and two from the posterior.
    assert collect.stages == [0, 0, 0, 1, 2]
    is_prior = [bool((agents.context.mean == 0).all()) for agents in collect.agents]
    assert is_prior == [True, True, True, False, False]
    assert learner.planned_episodes(EPISODES, 1) == (3 + 3 * 2) * EPISODES
    _, again = learner.step(jax.random.key(2), after, collect)
    assert len(collect.stages) == 5 + 3
    assert float(again.losses.q) != float(info.losses.q)


class Loud(Watching):
    """Rewards are so large that a critic's loss is not finite."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        episodes = super().__call__(*arguments, **named)
        return replace(episodes, reward=1e30 * episodes.reward)


def test_networks_that_are_not_finite_are_not_taken() -> None:
    learner = small()
    before = learner.init(jax.random.key(0), PROBLEM)
    after, info = learner.step(jax.random.key(1), before, Loud())
    assert not bool(info.accepted)
    for old, new in zip(*map(jax.tree.leaves, (before.networks, after.networks)), strict=True):
        np.testing.assert_array_equal(old, new)
    assert int(after.iteration) == 1


# A new task.


@pytest.mark.parametrize("noise", [False, True])
def test_a_new_task_is_sampled_and_then_acted_on_at_the_posterior_mean(noise: bool) -> None:
    learner, collect = small(prior_episodes=4, noisy_exploration=noise), Watching()
    fast = learner.fast_learner(learner.init(jax.random.key(0), PROBLEM))
    tasks, keys = jnp.arange(TASKS), jax.random.split(jax.random.key(5), TASKS)
    state, product = fast.init(keys), fast.encoder.none(TASKS)
    for update in range(3):
        explore, deploy = (fast.agents(state, purpose) for purpose in ("explore", "deploy"))
        posterior = product.posterior()
        # Three episodes an update, and four from the prior at least.
        expected = Latent(jnp.zeros((4, 2)), jnp.zeros((4, 2))) if update < 2 else posterior
        np.testing.assert_allclose(explore.context.mean, expected.mean, rtol=1e-5)
        np.testing.assert_allclose(explore.context.log_std, expected.log_std, rtol=1e-5)
        np.testing.assert_allclose(deploy.context.mean, posterior.mean, rtol=1e-5)
        assert explore.is_noisy == noise
        assert not deploy.is_noisy
        episodes = collect(keys, explore, tasks)
        assert np.unique(np.asarray(episodes.z), axis=1).shape[1] == EPISODES
        state = fast.update(state, episodes)
        batch, valid = transitions_of(episodes)
        product = product.times(jax.vmap(fast.encoder)(batch.context(False), valid))
    assert isinstance(state.factors, Factors)


def test_a_search_may_set_its_latent() -> None:
    learner, collect = small(), Watching()
    state = learner.init(jax.random.key(0), PROBLEM)
    scaled = eqx.tree_at(lambda state: state.networks.latent_scale, state, jnp.asarray(2.5))
    latent = latent_of(learner.fast_learner(scaled))
    assert (latent.size, latent.spread) == (2, 2.5)
    assert latent_of(learner.fast_learner(state)).spread == 1.0
    found = latent.of_tasks(collect, jax.random.split(jax.random.key(0), 2), jnp.arange(2))
    assert found.shape == (2, 2)
    held = latent.holding(found)
    episodes = collect(jax.random.split(jax.random.key(1), 2), held, jnp.arange(2))
    np.testing.assert_allclose(episodes.z[:, 0], found, atol=1e-4)
    # Another latent in each of the episodes that are played side by side.
    several = np.random.default_rng(0).normal(size=(2, EPISODES, 2))
    episodes = collect(
        jax.random.split(jax.random.key(1), 2), latent.holding(several), jnp.arange(2)
    )
    np.testing.assert_allclose(episodes.z, several, atol=1e-4)


# Runs.


def tiny(**settings: Any) -> PearlMetaLearner:
    return small(**{"replay_steps": 600, "initial_tasks": 2} | settings)


# What is refused.


def test_memory_is_bounded_and_a_visit_must_fit() -> None:
    problem = PROBLEM._replace(observation_size=100, num_tasks=100)
    state = jax.eval_shape(
        partial(small(replay_steps=10**6).init, problem=problem), jax.random.key(0)
    )
    size = sum(4 * leaf.size for leaf in jax.tree.leaves(state.replay))
    assert 0.9 * MOST_REPLAY_BYTES < size < 1.01 * MOST_REPLAY_BYTES < 2e8
    with pytest.raises(ValueError, match="takes up to 54 steps, but the replay holds only 50"):
        small(replay_steps=50).init(jax.random.key(0), PROBLEM)


@pytest.mark.parametrize(
    ("problem", "message"),
    [
        (PROBLEM._replace(action_kind="discrete"), "continuous actions only"),
        (PROBLEM._replace(num_tasks=1), "`visited_tasks` is 2"),
        (PROBLEM._replace(num_tasks=2), "`initial_tasks` is 3, but .* only 2 tasks"),
    ],
)
def test_tasks_that_it_cannot_learn_from_are_refused(problem: Problem, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small().init(jax.random.key(0), problem)
