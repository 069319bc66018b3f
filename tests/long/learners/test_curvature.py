"""The curvature of the outer step, for the cases that `tests/learners` leaves out."""

import pytest
from learners import test_curvature as short

pytestmark = pytest.mark.usefixtures("x64")


@pytest.mark.parametrize("case", short.LONG)
def test_the_curvature_is_exact(case: str) -> None:
    short.test_with_stride_one_it_is_the_exact_product(case)
    short.test_sampling_changes_derivatives_alone(case)


def test_through_the_policy_with_a_bias() -> None:
    short.test_derivatives_of_the_inner_step_are_of_the_sampled_steps("maml_bias")
    short.test_task_by_task_is_all_at_once("maml_bias")
