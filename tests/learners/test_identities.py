"""What the presets have in common: one method with a part switched off is another method."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.analytic import ACTION, OBSERVATION, AnalyticCollect
from learning_problems.prepared import SIZES, UNEQUAL, Problem, make_problem
from learning_problems.translation import experience_for, to_library

from maesn.adaptation import Adaptation, InnerStep, StepSizes
from maesn.context import BiasContext
from maesn.learners import GradientInfo, GradientMetaLearner, GradientState
from maesn.learners.objective import Experience, MetaParameters
from maesn.learners.presets import POLICY_STEP, latent_space, maesn, maesn_theta, maml, maml_bias
from maesn.policies import GaussianMLP

ROWS = (1, 4, 2)
SMALL: dict[str, Any] = {
    "policy": GaussianMLP(SIZES[1:-1]), "meta_batch_size": 3, "curvature_stride": 1
}  # fmt: skip
LEARNED, THETA_AT_REST = InnerStep(1.0), InnerStep(0.0, learned=False)
pytestmark = pytest.mark.usefixtures("x64", "quick_compilation")


def problem() -> Problem:
    return make_problem(2, UNEQUAL)


def improve(
    learner: GradientMetaLearner, parameters: MetaParameters, played: tuple[Experience, ...]
) -> tuple[MetaParameters, GradientInfo]:
    adaptation = learner.adaptation.at(0)
    return learner._improve(adaptation, parameters, jnp.asarray(ROWS), played, jax.random.key(0))


def assert_close(actual: Any, expected: Any, atol: float = 1e-9) -> None:
    assert jax.tree.structure(actual) == jax.tree.structure(expected)
    for x, y in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(x, y, rtol=0, atol=atol)


def assert_same_step(actual: GradientInfo, expected: GradientInfo) -> None:
    """Loss, gradient, KL and number of candidates agree, and something was learned."""
    assert expected.trust_region.accepted
    assert_close(actual.trust_region, expected.trust_region)
    assert_close(actual.penalty, expected.penalty)


def test_maesn_with_steps_fixed_at_zero_is_latent_space() -> None:
    data = problem()
    parameters = to_library(data.parameters)
    without_sizes = MetaParameters(parameters.policy, parameters.context, StepSizes(None, None))
    at_rest = maesn(adaptation=Adaptation(context=InnerStep(0.0, learned=False)), **SMALL)
    # Only the weight of the penalty differs between the presets.
    other = latent_space(context=at_rest.context, outer_batches=1, **SMALL)
    pre, post = experience_for(at_rest, data, ROWS)
    expected, expected_info = improve(other, without_sizes, (post,))
    actual, info = improve(at_rest, without_sizes, (pre, post))
    assert_same_step(info, expected_info)
    assert_close(actual, expected)


def test_maesn_theta_with_theta_at_rest_is_maesn() -> None:
    data = problem()
    parameters = to_library(data.parameters)
    at_rest = maesn_theta(adaptation=Adaptation(THETA_AT_REST, LEARNED), **SMALL)
    played = experience_for(at_rest, data, ROWS)
    expected, expected_info = improve(maesn(**SMALL), parameters, played)
    actual, info = improve(at_rest, parameters, played)
    assert_same_step(info, expected_info)
    assert_close(actual, expected)


def test_maesn_theta_before_its_stage_is_maesn() -> None:
    data = problem()
    parameters = to_library(data.parameters)
    theta_sizes = jax.tree.map(lambda x: jnp.full_like(x, POLICY_STEP), parameters.policy)
    sizes = StepSizes(theta_sizes, parameters.step_sizes.context)
    staged = maesn_theta(**SMALL)
    played = experience_for(staged, data, ROWS)
    with_sizes = MetaParameters(parameters.policy, parameters.context, sizes)
    expected, expected_info = improve(maesn(**SMALL), parameters, played)
    actual, info = improve(staged, with_sizes, played)
    assert_same_step(info, expected_info)
    assert_close((actual.policy, actual.context), (expected.policy, expected.context))
    assert_close(actual.step_sizes.context, expected.step_sizes.context)
    for old, new in zip(
        jax.tree.leaves(theta_sizes), jax.tree.leaves(actual.step_sizes.policy), strict=True
    ):
        np.testing.assert_array_equal(old, new)


def meta_train(learner: GradientMetaLearner) -> tuple[GradientState, GradientInfo]:
    state = learner.init(jax.random.key(0), OBSERVATION, ACTION, 7)
    collect = AnalyticCollect(num_tasks=7)
    for iteration in range(2):
        state, info = learner.step(jax.random.key(iteration), state, collect)
    return state, info


def test_maml_with_a_bias_of_no_components_is_maml() -> None:
    """Two meta-iterations from the same seed, collected anew: the whole path, not the step alone."""
    fixed = InnerStep(POLICY_STEP, learned=False)
    empty = maml_bias(
        context=BiasContext(0), adaptation=Adaptation(fixed, InnerStep(POLICY_STEP)), **SMALL
    )
    expected, expected_info = meta_train(maml(**SMALL))
    actual, info = meta_train(empty)
    assert_same_step(info, expected_info)
    assert_close(actual.parameters.policy, expected.parameters.policy)
    assert_close(info.return_after, expected_info.return_after)
    # Nothing was learned about the bias, and the report of it is a number all the same.
    assert [leaf.size for leaf in jax.tree.leaves(actual.parameters.step_sizes)] == [0]
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(info))
