"""Programs that are asked for by threads of their own."""

from collections.abc import Callable
from threading import Barrier

import pytest

from maesn.learners.side_by_side import side_by_side


def test_programs_run_at_the_same_time_and_answer_in_their_order() -> None:
    # Each waits for the other: one after the other they would never meet.
    meeting = Barrier(2, timeout=10)

    def meet(name: str) -> Callable[[], str]:
        return lambda: (meeting.wait(), name)[1]

    assert side_by_side(meet("first"), meet("second")) == ["first", "second"]


@pytest.mark.parametrize("broken", [0, 1])
def test_what_one_of_them_raises_is_raised(broken: int) -> None:
    def fail() -> int:
        raise FloatingPointError("this one")

    programs: list[Callable[[], int]] = [lambda: 1, lambda: 2]
    programs[broken] = fail
    with pytest.raises(FloatingPointError, match="this one"):
        side_by_side(*programs)
