"""A curiosity bonus around learners: what they learn from, and that nothing else changes."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.transitions import linear_episodes
from playing import keys

from maesn.envs import point
from maesn.evaluation.evaluate import adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import (
    IMPROVEMENTS,
    METHODS,
    PRESETS,
    SCRATCH,
    AbstractFastLearner,
    AbstractMetaLearner,
    BonusFastLearner,
    BonusMetaLearner,
    FineTuning,
    GradientFastLearner,
    Problem,
    Purpose,
    latent_space,
    maesn,
    method_name,
    rl2,
)
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.policies import GaussianMLP, Recurrent
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

SMALL = CuriosityBonus(hidden_sizes=(4,), updates=5, pool_size=40, pool_additions=20, samples=2)
TASKS = 3


class Listener(AbstractFastLearner[list[Episodes]]):
    """Learns nothing, and keeps what it is handed."""

    def init(self, keys: jax.Array) -> list[Episodes]:
        return []

    def agents(self, state: list[Episodes], purpose: Purpose = "explore") -> Agents:
        raise NotImplementedError

    def update(self, state: list[Episodes], episodes: Episodes) -> list[Episodes]:
        return [*state, episodes]


def heard(curiosity: CuriosityBonus, batches: list[Episodes]) -> Any:
    learner = BonusFastLearner(Listener(), curiosity, observation_size=2, action_size=1)
    state = learner.init(keys(TASKS))
    for episodes in batches:
        state = learner.update(state, episodes)
    return state


def test_a_fast_learner_is_handed_reward_and_bonus() -> None:
    plain = replace(linear_episodes(0, (TASKS, 4), 5), reward=jnp.full((TASKS, 4, 5), 2.0))
    first, second = heard(replace(SMALL, weight=0.5), [plain, plain]).learner
    # Until they have learned from something, the models are not asked.
    np.testing.assert_array_equal(first.reward, plain.reward)
    bonus = np.asarray(second.reward - plain.reward)
    assert np.all(bonus > 0)
    # In each task the bonus of the typical transition is the weight.
    np.testing.assert_allclose(np.median(bonus, axis=(1, 2)), 0.5, rtol=1e-5)
    # What the policy was shown while it played, and what is reported, stay as they were.
    np.testing.assert_array_equal(second.observed_reward, plain.reward)
    np.testing.assert_array_equal(second.goal_reward, plain.goal_reward)


def test_every_task_has_a_model_of_its_own() -> None:
    batches = [linear_episodes(seed, (TASKS, 4), 5) for seed in (0, 1)]
    state = heard(SMALL, batches)
    assert int(state.update) == 2
    # The same tasks again, but the last one sees something else: only its own model changes.
    other = [replace(batch, action=batch.action.at[-1].set(batch.action[0])) for batch in batches]
    for one, two in zip(
        *(jax.tree.leaves(s.curiosity.network) for s in (state, heard(SMALL, other))), strict=True
    ):
        np.testing.assert_allclose(one[:-1], two[:-1], rtol=1e-6)
        assert (one[-1] != two[-1]).any()
        assert (one[0] != one[1]).any()


@pytest.fixture(scope="module")
def collect() -> Collector:
    return make_collect()


def make_collect() -> Collector:
    env = point.make_env(reward_kind="sparse", horizon=8)
    return Collector(make_world(env, point.task_set("training", size=5)), 4)


def tiny(**settings: Any) -> Any:
    return maesn(policy=GaussianMLP((4,)), meta_batch_size=2, **settings)


def test_a_meta_learner_with_a_bonus_is_one_setting(collect: Collector) -> None:
    learner = BonusMetaLearner(tiny(), replace(SMALL, weight=10.0))
    state = learner.init(jax.random.key(0), Problem(2, 2, 5))
    accepted = []
    for step in range(4):
        state, info = learner.step(jax.random.key(step), state, collect)
        accepted.append(bool(info.learner.outer.accepted))
        # As long as the model has learned nothing, there is no bonus.
        assert (float(info.curiosity.bonus) > 8 * 5.0) == (step > 0)
    assert int(learner.iteration(state)) == 4
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(state))
    # Two collections per iteration, 20 of the transitions of each.
    assert int(state.curiosity.pool.count) == 160
    # Reported are returns without bonus: at most 0 on this family.
    assert float(info.learner.return_after) < 0
    logged = learner.metrics(info)
    assert logged["return_after"] is info.learner.return_after
    assert logged["curiosity"] is info.curiosity
    # Of so few episodes, not every step is an improvement.
    assert any(accepted)


ALONE = {
    "maesn": tiny(),
    # Without inner updates all batches are of the same agents: before and after are one.
    "latent_space": latent_space(policy=GaussianMLP((4,)), meta_batch_size=2),
    "more batches": tiny(inner_updates=2, outer_batches=2),
    # A trial is played by the same agents, episode after episode.
    "rl2": rl2(policy=Recurrent(hidden_size=3), meta_batch_size=2),
}
LONG = ["latent_space", "more batches", "rl2"]  # in `tests/long`


@pytest.mark.parametrize("name", [name for name in ALONE if name not in LONG])
def test_with_a_weight_of_0_it_is_the_learner_itself(name: str, collect: Collector) -> None:
    alone: AbstractMetaLearner = ALONE[name]
    wrapped = BonusMetaLearner(alone, replace(SMALL, weight=0.0))
    key = jax.random.key(7)
    state = wrapped.init(jax.random.key(0), Problem(2, 2, 5))
    learner_key = jax.random.split(key, 3)[0]
    after, info = alone.step(learner_key, state.learner, collect)
    together, said = wrapped.step(key, state, collect)
    for one, other in zip(*map(jax.tree.leaves, (after, together.learner)), strict=True):
        np.testing.assert_array_equal(one, other)
    for measure in ("return_before", "return_after"):
        wanted = float(getattr(info, measure))
        assert float(getattr(said.learner, measure)) == pytest.approx(wanted, rel=1e-5)


@pytest.mark.long
def test_the_model_of_the_dynamics_passes_on_to_new_tasks(collect: Collector) -> None:
    learner = BonusMetaLearner(tiny(), SMALL)
    state, _ = learner.step(
        jax.random.key(1), learner.init(jax.random.key(0), Problem(2, 2, 5)), collect
    )
    fast = learner.fast_learner(state)
    assert (fast.observation_size, fast.action_size) == (2, 2)
    begun = fast.init(keys(TASKS))
    # The network means nothing without the pool, by whose moments its inputs are scaled.
    for part in ("network", "pool"):
        handed_over = (getattr(one.curiosity, part) for one in (state, begun))
        for known, start in zip(*map(jax.tree.leaves, handed_over), strict=True):
            np.testing.assert_array_equal(start, jnp.stack([known] * TASKS))
    assert np.all(begun.curiosity.medians.count == 0)
    outcome = adapt(fast, collect, Evaluation(tasks_at_once=2), episodes=8)
    assert np.isfinite(outcome.curves.mean_return).all()
    assert np.all(outcome.contexts.mean[:, 1] != 0)


def test_a_learner_that_does_not_learn_from_reward_gets_no_bonus() -> None:
    learner = METHODS["oracle+curiosity"](policy=GaussianMLP((4,)), meta_batch_size=2)
    fast = learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, 5, 2)))
    assert isinstance(fast, GradientFastLearner)
    assert not fast.capabilities.learns_from_reward


def test_a_bonus_is_not_added_twice_nor_lost_by_fine_tuning() -> None:
    vime = SCRATCH["vime"](2, 2)
    assert vime.capabilities.has_bonus
    assert not vime.learner.capabilities.has_bonus
    with pytest.raises(ValueError, match="`learner` must not have a bonus already"):
        BonusFastLearner(vime, SMALL, 2, 2)
    with pytest.raises(ValueError, match="`learner` must not have a bonus already"):
        BonusMetaLearner(METHODS["maesn+curiosity"]())
    with pytest.raises(ValueError, match=r"`learner` must not have a bonus, .* `inside`"):
        FineTuning(vime, IMPROVEMENTS["trpo"])
    tuned = vime.inside(lambda one: FineTuning(one, IMPROVEMENTS["trpo"]))
    assert isinstance(tuned, BonusFastLearner)
    assert tuned.capabilities.has_bonus
    assert tuned.learner == FineTuning(vime.learner, IMPROVEMENTS["trpo"])


@pytest.mark.long
def test_a_fine_tuned_learner_keeps_its_bonus(collect: Collector) -> None:
    """Where every reward is the same, weights move by the bonus alone."""
    learner = METHODS["maesn+curiosity"](policy=GaussianMLP((4,)), meta_batch_size=2)
    state = learner.init(jax.random.key(0), Problem(2, 2, 5))
    knows = replace(state.curiosity, has_learned=jnp.ones((), bool))
    fast = learner.fast_learner(replace(state, curiosity=knows))
    wrapped = fast.inside(lambda one: FineTuning(one, IMPROVEMENTS["trpo"], after=0))
    assert wrapped.learner.learner is fast.learner

    def moves(tuned: AbstractFastLearner) -> bool:
        state = tuned.init(keys(TASKS))
        start = tuned.agents(state)
        played = replace(collect(keys(TASKS), start, jnp.arange(TASKS)), observed_reward=None)
        no_reward = replace(played, reward=jnp.zeros_like(played.reward))
        after = tuned.agents(tuned.update(state, no_reward))
        leaves = map(jax.tree.leaves, (start.policy, after.policy))
        return any((one != other).any() for one, other in zip(*leaves, strict=True))

    assert moves(wrapped)
    assert not moves(wrapped.learner)


def test_methods_with_a_bonus_have_names() -> None:
    assert set(METHODS) == set(PRESETS) | {f"{name}+curiosity" for name in PRESETS}
    for name, preset in METHODS.items():
        assert method_name(preset()) == name
    assert METHODS["maesn+curiosity"](meta_batch_size=3).learner.meta_batch_size == 3
