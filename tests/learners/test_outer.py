"""Outer steps that follow gradients, on the objective that the trust region has."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.prepared import UNEQUAL, make_problem
from learning_problems.translation import learner_for, objective_for, to_library

from maesn.inner.surrogate import clipped_loss, outer_loss
from maesn.learners.gradient.objective import MetaObjective, MetaParameters
from maesn.learners.gradient.outer import FirstOrderOuterStep, ProximalOuterStep

ROWS = (3, 0, 4)
pytestmark = pytest.mark.usefixtures("x64")


def problem() -> tuple[MetaObjective, MetaParameters]:
    made = make_problem(2, UNEQUAL)
    return objective_for(learner_for(made), made, ROWS), to_library(made.parameters)


@eqx.filter_jit
def stepped(outer: FirstOrderOuterStep, objective: MetaObjective, at: MetaParameters) -> Any:
    return outer(jax.random.key(0), at, outer.init(at), objective, ())


@eqx.filter_jit
def gradient_of(objective: MetaObjective, at: MetaParameters) -> Any:
    return jax.grad(lambda p: objective.evaluate_at_once(p).loss)(at)


def flat(parameters: Any) -> np.ndarray:
    return np.asarray(ravel_pytree(parameters)[0])


def test_one_sgd_step_goes_along_the_gradient_of_the_loss_of_all_tasks() -> None:
    objective, at = problem()
    gradient = gradient_of(objective, at)
    after, _, info = stepped(FirstOrderOuterStep("sgd", 0.3), objective, at)
    np.testing.assert_allclose(flat(after) - flat(at), -0.3 * flat(gradient), atol=1e-12)
    np.testing.assert_allclose(info.gradient_norm, np.linalg.norm(flat(gradient)))
    np.testing.assert_allclose(info.loss_after, eqx.filter_jit(objective.evaluate)(after).loss)


def test_several_adam_steps_are_optax_in_a_loop() -> None:
    objective, at = problem()
    adam = optax.adam(1e-2)
    expected, state = flat(at), adam.init(flat(at))
    unravel = ravel_pytree(at)[1]
    with jax.numpy_dtype_promotion("standard"):
        for _ in range(3):
            slope = flat(gradient_of(objective, unravel(expected)))
            change, state = adam.update(slope, state)
            expected = expected + change
    after, _, info = stepped(FirstOrderOuterStep("adam", 1e-2, steps=3), objective, at)
    np.testing.assert_allclose(flat(after), expected, rtol=1e-9)
    assert info.accepted


@pytest.mark.parametrize("shift", [0.0, 0.05, 2.0])
def test_the_clipped_loss_is_that_of_each_step_by_itself(shift: float) -> None:
    objective, at = problem()
    new = eqx.filter_jit(objective.distributions)(at, objective.post)
    new, episodes, advantages = jax.tree.map(
        lambda x: x[0], (new, objective.post, objective.advantages)
    )
    new = replace(new, mean=new.mean + shift)
    ratio = np.exp(new.log_prob(episodes.action) - episodes.behaviour.log_prob(episodes.action))
    terms = [
        min(r * a, min(max(r, 0.7), 1.3) * a)
        for r, a, ok in zip(*map(np.ravel, (ratio, advantages.step, episodes.valid)), strict=True)
        if ok
    ]
    found = clipped_loss(new, episodes, advantages, 0.3)
    np.testing.assert_allclose(found, -np.mean(terms), rtol=1e-9, atol=1e-15)
    assert jnp.all(found >= outer_loss(new, episodes, advantages) - 1e-12)  # it bounds the gain


def test_the_first_proximal_step_is_the_gradient_of_the_unclipped_loss() -> None:
    objective, at = problem()
    objective = replace(
        objective,
        post=eqx.tree_at(
            lambda e: e.behaviour,
            objective.post,
            eqx.filter_jit(objective.distributions)(at, objective.post),
        ),
    )
    plain, clipped = (
        stepped(kind("sgd", 0.1, steps=1), objective, at)[0]
        for kind in (FirstOrderOuterStep, ProximalOuterStep)
    )
    np.testing.assert_allclose(flat(clipped), flat(plain), rtol=1e-9)


def test_steps_that_are_not_finite_change_nothing() -> None:
    objective, at = problem()
    broken = eqx.tree_at(
        lambda o: o.advantages.step, objective, jnp.full_like(objective.advantages.step, jnp.nan)
    )
    outer = FirstOrderOuterStep()
    after, opt_state, info = stepped(outer, broken, at)
    assert not info.accepted
    np.testing.assert_array_equal(flat(after), flat(at))
    assert eqx.tree_equal(opt_state, outer.init(at))
