"""What the presets have in common: one method with a part switched off is another method."""

from dataclasses import replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.prepared import UNEQUAL, Problem, make_problem
from learning_problems.translation import learner_for, objective_for, to_library
from reference.maesn import Settings

from maesn import GradientMetaLearner
from maesn.context import Bias, BiasContext
from maesn.inner.adaptation import Adaptation, InnerStep, StepSizes
from maesn.learners.gradient.info import GradientInfo
from maesn.learners.gradient.meta_learner import GradientState
from maesn.learners.gradient.objective import MetaParameters
from maesn.learners.presets import POLICY_STEP, latent_space, maesn, maesn_theta, maml, maml_bias

# As in `test_against_reference.py`, for the same reason.
SEED = 2
AT_REST = InnerStep(0.0, learned=False)
ROWS = (1, 4, 2)
pytestmark = pytest.mark.usefixtures("x64")


def settings_of(problem: Problem) -> dict[str, Any]:
    """What all methods have in common here."""
    learner = learner_for(problem)
    names = ("policy", "outer", "meta_batch_size")
    return {name: getattr(learner, name) for name in names}


def improve(
    learner: GradientMetaLearner, parameters: MetaParameters, problem: Problem
) -> tuple[MetaParameters, GradientInfo]:
    """Do an outer step on the same experience for every method."""
    objective = replace(
        objective_for(learner_for(problem), problem, ROWS),
        context=learner.context,
        adaptation=learner.adaptation.at(0),
    )
    if learner.inner_updates == 0:
        objective = replace(objective, pre=())
    state = GradientState(parameters, jnp.zeros((), int))
    updated = eqx.filter_jit(objective.updated)(parameters)
    after, info = learner._improve(
        state, objective.adaptation, objective.rows, updated, jax.random.key(0)
    )
    return after.parameters, info


def assert_close(actual: Any, expected: Any, atol: float = 1e-8) -> None:
    assert jax.tree.structure(actual) == jax.tree.structure(expected)
    for x, y in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(x, y, rtol=0, atol=atol)


def assert_same_step(actual: GradientInfo, expected: GradientInfo) -> None:
    """Loss, gradient, KL and number of candidates agree, and something was learned."""
    assert expected.outer.accepted
    assert_close(actual.outer, expected.outer)
    assert_close(actual.penalty, expected.penalty)


def test_maesn_with_steps_fixed_at_zero_is_latent_space() -> None:
    problem = make_problem(SEED, UNEQUAL)
    learned = to_library(problem.parameters)
    parameters = MetaParameters(learned.policy, learned.context_table, StepSizes(None, None))
    at_rest = maesn(adaptation=Adaptation(context=AT_REST), **settings_of(problem))
    # The presets differ in the weight of the penalty as well, and in how much they collect.
    other = latent_space(context=at_rest.context, outer_batches=1, **settings_of(problem))
    expected, expected_info = improve(other, parameters, problem)
    actual, info = improve(at_rest, parameters, problem)
    assert_same_step(info, expected_info)
    assert_close(actual, expected)


def test_maesn_theta_with_theta_at_rest_is_maesn() -> None:
    problem = make_problem(SEED, UNEQUAL)
    parameters = to_library(problem.parameters)
    adaptation = Adaptation(AT_REST, InnerStep(1.0))
    at_rest = maesn_theta(adaptation=adaptation, **settings_of(problem))
    expected, expected_info = improve(maesn(**settings_of(problem)), parameters, problem)
    actual, info = improve(at_rest, parameters, problem)
    assert_same_step(info, expected_info)
    assert_close(actual, expected)


def test_maesn_theta_before_its_stage_is_maesn() -> None:
    # The step sizes that wait for their stage are still, see `test_presets.py`.
    staged, other = maesn_theta(), maesn()
    assert staged.adaptation.at(149) == other.adaptation
    assert staged.adaptation.at(150) != other.adaptation
    same = {"adaptation": other.adaptation, "outer": other.outer}
    assert replace(staged, **same) == other


def maml_problem() -> Problem:
    return make_problem(SEED, UNEQUAL, Settings(theta_step=POLICY_STEP), latent=0)


@cache
def maml_with_an_empty_bias() -> tuple[MetaParameters, GradientInfo]:
    problem = maml_problem()
    adaptation = Adaptation(InnerStep(POLICY_STEP, learned=False), InnerStep(POLICY_STEP))
    learner = maml_bias(context=BiasContext(0), adaptation=adaptation, **settings_of(problem))
    empty = Bias(jnp.zeros(0))
    policy = to_library(problem.parameters).policy
    return improve(learner, MetaParameters(policy, empty, StepSizes(None, empty)), problem)


def test_maml_with_a_bias_of_no_components_is_maml() -> None:
    problem = maml_problem()
    parameters = to_library(problem.parameters)
    expected, expected_info = improve(maml(**settings_of(problem)), parameters, problem)
    actual, info = maml_with_an_empty_bias()
    assert_same_step(info, expected_info)
    assert_close(actual.policy, expected.policy)


def test_a_bias_of_no_components_is_reported_by_numbers() -> None:
    _, info = maml_with_an_empty_bias()
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(info))
