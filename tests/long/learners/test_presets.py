"""What all presets have in common, for those that `tests/learners` leaves out."""

from collections.abc import Callable

import pytest
from learners import test_presets as short

CHECKS = [
    short.test_states_and_agents_hold_arrays_only,
    short.test_states_keep_structure_shapes_and_types,
    short.test_parameters_stay_finite_and_change,
    short.test_infos_are_finite_scalars,
    short.test_accepted_steps_lower_the_loss_within_the_trust_region,
    short.test_shares_of_the_step_sum_to_one,
    short.test_the_iteration_is_counted,
    short.test_nothing_is_compiled_after_the_first_step,
    short.test_fast_updates_are_compiled_once,
    short.test_tasks_are_drawn_without_replacement,
]


@pytest.mark.parametrize("preset", short.LONG)
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_presets_with_a_bias(check: Callable[[str], None], preset: str) -> None:
    check(preset)
