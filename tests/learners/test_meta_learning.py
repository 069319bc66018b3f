"""Gradient-based methods learn to learn, from scratch."""

import pytest
from learning_problems.hidden_side import assert_updates_raise_the_return_after_meta_training_alone


@pytest.mark.parametrize(
    ("method", "updates"),
    [
        ("maesn", 1),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in (("maml", 1), ("latent_space", 2))
        ),
    ],
)
def test_methods_learn_to_learn(method: str, updates: int) -> None:
    assert_updates_raise_the_return_after_meta_training_alone(method, updates)
