"""The outer problem and the outer step against the plain NumPy reference."""

from dataclasses import asdict
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.prepared import EQUAL, UNEQUAL, PreparedCollect, Problem, make_problem
from learning_problems.translation import (
    learner_for,
    objective_for,
    policy_to_reference,
    to_library,
    to_reference,
)
from reference.maesn import Agent as ReferenceAgent
from reference.maesn import Settings, TaskData, loss, mean_kl
from reference.parameters import Array, Parameters, flatten, unflatten
from reference.trust_region import TrustRegionSettings, curvature, loss_gradient, outer_step

from maesn.experience.agent import Agents
from maesn.learners.gradient.curvature import step_weights
from maesn.learners.gradient.meta_learner import GradientState
from maesn.learners.gradient.objective import MetaObjective, MetaParameters
from maesn.numerics.trust_region import Candidate, TrustRegion

CASES: dict[str, dict[str, Any]] = {
    "maesn": {"lengths": EQUAL},
    "unequal_lengths": {"lengths": UNEQUAL},
    "two_inner_updates": {"lengths": UNEQUAL, "inner_updates": 2},
    "reparameterized": {"lengths": UNEQUAL, "settings": Settings(gradient="reparameterized")},
    "theta_as_well": {"lengths": UNEQUAL, "settings": Settings(theta_step=0.1, kl_weight=0.5)},
    "no_inner_update": {"lengths": UNEQUAL, "inner_updates": 0},
    "maml": {"lengths": UNEQUAL, "settings": Settings(theta_step=0.1), "latent": 0},
}
# Where the curvature is nearly singular, ten steps of conjugate gradients magnify rounding errors
# up to a hundred billion times: two correct implementations then take different steps. With this
# seed the reference's own step moves by 1e-11 of its length when its gradient moves by 1e-14.
SEED = 2
ROWS = (3, 0, 4)
REGION = TrustRegion(**asdict(TrustRegionSettings()))
# The step knows of the objective nothing but its values, so fewer cases do for it. Two more take
# it in a whole meta-iteration.
STEPPED = ["maesn", "unequal_lengths", pytest.param("maml", marks=pytest.mark.long)]
every_case = pytest.mark.parametrize("case", CASES)


@cache
def problem_of(case: str) -> Problem:
    return make_problem(SEED, **CASES[case])


def tasks_of(case: str) -> list[TaskData]:
    return [problem_of(case).tasks[row] for row in ROWS]


@cache
def elsewhere(case: str) -> Parameters:
    """Parameters beside those that played: ratios differ from 1, and the KL from 0."""
    parameters = problem_of(case).parameters
    flat = flatten(parameters)
    noise = 0.05 * np.random.default_rng(1).normal(size=flat.shape)
    return unflatten(flat + noise, parameters)


@eqx.filter_jit
def differentiate(
    objective: MetaObjective, parameters: MetaParameters, vector: MetaParameters
) -> tuple[Candidate, MetaParameters, MetaParameters]:
    """Return loss and KL, the gradient of the loss, and the curvature times a vector."""
    flat, unravel = ravel_pytree(parameters)
    _, gradient = objective.loss_and_gradient(parameters)
    product = REGION._curvature_product(
        lambda x: objective.distributions(unravel(x), objective.post),
        flat,
        step_weights(objective.post),
    )
    image = product(ravel_pytree(vector)[0])
    return objective.evaluate(parameters), gradient, unravel(image)


def assert_parameters_close(
    actual: MetaParameters, expected: Parameters, rtol: float = 0.0, atol: float = 0.0
) -> None:
    translated = to_reference(actual)
    assert translated.keys() == expected.keys()
    for name, array in expected.items():
        np.testing.assert_allclose(translated[name], array, rtol, atol, err_msg=name)


def largest(parameters: Parameters) -> float:
    return max(np.abs(array).max(initial=0.0) for array in parameters.values())


@every_case
@pytest.mark.usefixtures("x64")
def test_loss_and_kl_and_gradient(case: str) -> None:
    problem, parameters, tasks = problem_of(case), elsewhere(case), tasks_of(case)
    objective, translated = (
        objective_for(learner_for(problem), problem, ROWS),
        to_library(parameters),
    )
    actual, gradient, _ = differentiate(objective, translated, translated)
    expected_kl = mean_kl(parameters, tasks, problem.settings)
    slope = unflatten(loss_gradient(parameters, tasks, problem.settings), parameters)
    np.testing.assert_allclose(actual.loss, loss(parameters, tasks, problem.settings), rtol=1e-11)
    np.testing.assert_allclose(actual.kl, expected_kl, rtol=1e-11)
    assert_parameters_close(gradient, slope, atol=1e-11 * largest(slope))
    assert expected_kl > 1e-3


def test_loss_and_kl_and_gradient_in_single_precision() -> None:
    case = "unequal_lengths"
    problem, parameters, tasks = problem_of(case), elsewhere(case), tasks_of(case)
    objective, translated = (
        objective_for(learner_for(problem), problem, ROWS),
        to_library(parameters),
    )
    actual, gradient, _ = differentiate(objective, translated, translated)
    slope = unflatten(loss_gradient(parameters, tasks, problem.settings), parameters)
    np.testing.assert_allclose(actual.loss, loss(parameters, tasks, problem.settings), atol=1e-5)
    np.testing.assert_allclose(actual.kl, mean_kl(parameters, tasks, problem.settings), rtol=1e-4)
    assert_parameters_close(gradient, slope, atol=1e-4 * largest(slope))


@every_case
@pytest.mark.usefixtures("x64")
def test_curvature_product(case: str) -> None:
    problem, tasks = problem_of(case), tasks_of(case)
    objective = objective_for(learner_for(problem), problem, ROWS)
    flat = np.random.default_rng(3).normal(size=flatten(problem.parameters).shape)
    vector = to_library(unflatten(flat, problem.parameters))
    *_, actual = differentiate(objective, to_library(problem.parameters), vector)
    matrix = curvature(problem.parameters, tasks, problem.settings)
    expected = unflatten(matrix @ flat + REGION.damping * flat, problem.parameters)
    assert_parameters_close(actual, expected, atol=1e-11 * largest(expected))


@pytest.mark.parametrize("case", STEPPED)
@pytest.mark.usefixtures("x64")
def test_outer_step(case: str) -> None:
    problem, tasks = problem_of(case), tasks_of(case)
    learner, old = learner_for(problem), to_library(problem.parameters)
    objective = objective_for(learner, problem, ROWS)
    state = GradientState(old, jnp.zeros((), int))
    updated = eqx.filter_jit(objective.updated)(old)
    after, info = learner._improve(
        state, objective.adaptation, objective.rows, updated, jax.random.key(0)
    )
    expected = outer_step(problem.parameters, tasks, problem.settings, TrustRegionSettings())
    step = info.outer
    assert expected.accepted
    assert step.accepted
    assert step.backtracks == expected.backtracks
    np.testing.assert_allclose(step.loss_before, expected.loss_before, atol=1e-12)
    np.testing.assert_allclose(step.loss_after, expected.loss_after, atol=1e-8)
    np.testing.assert_allclose(step.kl, expected.kl, atol=1e-8)
    assert_parameters_close(after.parameters, expected.parameters, atol=1e-8)


def assert_agent_close(agents: Agents, slot: int, expected: ReferenceAgent) -> None:
    one = jax.tree.map(lambda x: x[slot], agents.context)
    np.testing.assert_allclose(one.mean, expected.mean, rtol=1e-11)
    np.testing.assert_allclose(one.log_std, expected.log_std, rtol=1e-11)
    shared, own = agents.shares_policy, agents.policy
    policy = own if shared else jax.tree.map(lambda x: x[slot], own)
    for name, array in policy_to_reference(policy).items():
        np.testing.assert_allclose(array, expected.theta[name], rtol=1e-11, err_msg=name)


@pytest.mark.parametrize(
    "case", ["two_inner_updates", pytest.param("theta_as_well", marks=pytest.mark.long)]
)
@pytest.mark.usefixtures("x64")
def test_a_whole_meta_iteration(case: str) -> None:
    """Who plays, in which tasks, and what comes of it."""
    problem = problem_of(case)
    collect = PreparedCollect(problem)
    state = GradientState(to_library(problem.parameters), jnp.zeros((), int))
    after, info = learner_for(problem).step(jax.random.key(4), state, collect)
    (index, *others), tasks = collect.index, collect.chosen()
    assert all((other == index).all() for other in others)
    for phase, agents in enumerate(collect.asked):
        playing = problem.playing(phase)
        for slot, row in enumerate(index):
            assert_agent_close(agents, slot, playing[row])
    outcome = outer_step(problem.parameters, tasks, problem.settings, TrustRegionSettings())
    assert_parameters_close(after.parameters, outcome.parameters, atol=1e-8)
    returns = [_mean_return([task.pre[0].episodes, task.post.episodes]) for task in tasks]
    np.testing.assert_allclose(info.return_before, np.mean(returns, axis=0)[0], rtol=1e-11)
    np.testing.assert_allclose(info.return_after, np.mean(returns, axis=0)[1], rtol=1e-11)


def _mean_return(batches: list[list[Any]]) -> Array:
    return np.array([np.mean([e.reward.sum() for e in episodes]) for episodes in batches])
