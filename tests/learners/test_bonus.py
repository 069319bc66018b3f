"""A curiosity bonus around learners: what they learn from, and that nothing else changes."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.transitions import linear_episodes
from playing import keys

from maesn import BonusFastLearner, FineTuning
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import SCRATCH, AbstractFastLearner, PolicyImprovement, Purpose
from maesn.learners.wrappers.curiosity import CuriosityBonus

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


def test_a_bonus_is_not_added_twice_nor_lost_by_fine_tuning() -> None:
    vime = SCRATCH["vime"](2, 2)
    assert vime.capabilities.has_bonus
    assert not vime.learner.capabilities.has_bonus
    with pytest.raises(ValueError, match="`learner` must not have a bonus already"):
        BonusFastLearner(vime, SMALL, 2, 2)
    with pytest.raises(ValueError, match=r"`learner` must not have a bonus, .* `inside`"):
        FineTuning(vime, PolicyImprovement())
    tuned = vime.inside(lambda one: FineTuning(one, PolicyImprovement()))
    assert isinstance(tuned, BonusFastLearner)
    assert tuned.capabilities.has_bonus
    assert tuned.learner == FineTuning(vime.learner, PolicyImprovement())
