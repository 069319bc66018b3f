"""What must change nothing: steps after an episode's end, and outer steps that are rejected."""

from dataclasses import fields
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.prepared import UNEQUAL, PreparedCollect, Problem, make_problem
from learning_problems.translation import learner_for, to_library
from reference.maesn import Settings
from reference.parameters import flatten, unflatten

from maesn.experience.episodes import Episodes
from maesn.learners.gradient.info import GradientInfo
from maesn.learners.gradient.meta_learner import GradientState
from maesn.learners.gradient.objective import MetaParameters

KEY = 4


@cache
def problem() -> Problem:
    """Latents and theta both move in the inner update: every path of a gradient is there."""
    return make_problem(2, UNEQUAL, Settings(theta_step=0.1))


def parameters() -> MetaParameters:
    return to_library(problem().parameters)


def step(collect: PreparedCollect, start: MetaParameters) -> tuple[GradientState, GradientInfo]:
    state = GradientState(start, jnp.zeros((), int))
    return learner_for(problem()).step(jax.random.key(KEY), state, collect)


def bits(tree: Any) -> list[bytes]:
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree)]


@pytest.mark.parametrize("garbage", [1e30, np.nan, np.inf, -np.inf])
def test_garbage_after_the_end_of_episodes_changes_no_bit(garbage: float) -> None:
    """Loss, gradient, KL and step, and so everything that is learned from."""
    clean, clean_info = step(PreparedCollect(problem()), parameters())
    dirty, dirty_info = step(PreparedCollect(problem(), garbage), parameters())
    assert clean_info.outer.accepted
    assert bits(dirty) == bits(clean)
    assert bits(dirty_info.outer) == bits(clean_info.outer)


@pytest.mark.parametrize("name", [field.name for field in fields(GradientInfo)])
def test_garbage_after_the_end_of_episodes_is_not_reported(name: str) -> None:
    _, clean = step(PreparedCollect(problem()), parameters())
    _, dirty = step(PreparedCollect(problem(), np.nan), parameters())
    assert bits(getattr(dirty, name)) == bits(getattr(clean, name))


class Spoiled(PreparedCollect):
    """Puts something into the first valid step of the first task slot, in one collection."""

    phase = 1
    reward: float | None = None
    action: float | None = None

    def __call__(self, *arguments: Any, **named: Any) -> Episodes:
        episodes = super().__call__(*arguments, **named)
        if len(self.asked) - 1 != self.phase:
            return episodes
        if self.reward is not None:
            spoiled = episodes.reward.at[0, 0, 0].set(self.reward)
            episodes = eqx.tree_at(lambda e: e.reward, episodes, spoiled)
        if self.action is not None:
            spoiled = episodes.action.at[0, 0, 0, 0].set(self.action)
            episodes = eqx.tree_at(lambda e: e.action, episodes, spoiled)
        return episodes


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("phase", [0, 1])
@pytest.mark.parametrize("where", ["reward", "action"])
def test_a_task_that_is_not_finite_is_counted_and_the_step_rejected(
    where: str, phase: int, value: float
) -> None:
    collect = Spoiled(problem())
    collect.phase = phase
    setattr(collect, where, value)
    before = parameters()
    after, info = step(collect, before)
    assert not info.outer.accepted
    assert info.nonfinite_tasks == 1
    assert bits(after.parameters) == bits(before)
    assert after.iteration == 1


def test_a_step_outside_the_trust_region_is_rejected() -> None:
    # These parameters did not play: their KL is too large before they have moved at all.
    flat = flatten(problem().parameters)
    noise = 0.1 * np.random.default_rng(1).normal(size=flat.shape)
    elsewhere = to_library(unflatten(flat + noise, problem().parameters))
    after, info = step(PreparedCollect(problem()), elsewhere)
    assert not info.outer.accepted
    assert info.nonfinite_tasks == 0
    assert info.outer.loss_after == info.outer.loss_before
    assert info.outer.kl == 0.0
    assert [float(share) for share in jax.tree.leaves(info.shares)] == [0.0, 0.0, 0.0]
    assert bits(after.parameters) == bits(elsewhere)
