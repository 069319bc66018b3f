"""MAESN learns to learn, from scratch. `tests/long` has the other methods."""

from learning_problems.hidden_side import assert_updates_raise_the_return_after_meta_training_alone


def test_maesn_learns_to_learn() -> None:
    assert_updates_raise_the_return_after_meta_training_alone("maesn", updates=1)
