"""RL2 by TRPO solves a probe that needs memory, as RL2 by PPO does in `tests/learners`."""

from learning_problems.memory import assert_a_probe_of_memory_is_solved


def test_a_probe_that_needs_memory_across_episodes_is_solved() -> None:
    assert_a_probe_of_memory_is_solved("rl2_trpo")
