"""Policies with memory: one stretch of an episode is the same as its steps."""

import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.numerics import Categorical, DiagonalGaussian
from maesn.policies import (
    AbstractPolicySettings,
    CategoricalMLP,
    GaussianMLP,
    PolicyInput,
    Recurrent,
)

OBSERVATION, ACTION, CONTEXT, STEPS = 3, 2, 2, 7
SETTINGS: dict[str, AbstractPolicySettings] = {
    "gaussian": GaussianMLP((4,)),
    "categorical": CategoricalMLP((4,)),
    "recurrent": Recurrent(hidden_size=4, readout_sizes=(3,)),
    "recurrent, discrete": Recurrent("discrete", (5,), 4, (3,)),
}


def random_inputs() -> PolicyInput:
    stream = np.random.default_rng(0)
    return PolicyInput(
        observation=jnp.asarray(stream.normal(size=(STEPS, OBSERVATION)), float),
        previous_action=jnp.asarray(stream.normal(size=(STEPS, ACTION)), float),
        previous_reward=jnp.asarray(stream.normal(size=STEPS), float),
        episode_start=jnp.arange(STEPS) % 4 == 0,
    )


@pytest.mark.parametrize("name", SETTINGS)
def test_unroll_is_step_by_step(name: str) -> None:
    policy = SETTINGS[name].init(jax.random.key(0), OBSERVATION, ACTION, CONTEXT)
    inputs, context = random_inputs(), jnp.asarray([0.5, -1.0])
    valid = jnp.asarray([True, True, False, True, True, True, False])
    along, last = policy.unroll(inputs, valid, context, policy.initial_carry())
    carry = policy.initial_carry()
    for t in range(STEPS):
        now = jax.tree.map(lambda x: x[t], inputs)  # noqa: B023
        distribution, after = policy(now, context, carry)
        carry = after if valid[t] else carry
        if valid[t]:
            here = jax.tree.map(lambda x: x[t], along)  # noqa: B023
            jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-6),
                         distribution, here)  # fmt: skip
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5), carry, last)


@pytest.mark.parametrize(
    "changed", ["observation", "previous_action", "previous_reward", "episode_start"]
)
def test_everything_that_is_told_is_remembered(changed: str) -> None:
    """What happens at step 2 reaches all later steps and no earlier one."""
    policy = SETTINGS["recurrent"].init(jax.random.key(0), OBSERVATION, ACTION, CONTEXT)
    inputs, context = random_inputs(), jnp.zeros(CONTEXT)

    def means(told: PolicyInput) -> np.ndarray:
        along, _ = policy.unroll(told, jnp.ones(STEPS, bool), context, policy.initial_carry())
        assert isinstance(along, DiagonalGaussian)
        return np.asarray(along.mean)

    value = getattr(inputs, changed)
    other: Any = value.at[2].set(~value[2] if value.dtype == bool else value[2] + 1.0)
    differs = (means(inputs) != means(inputs._replace(**{changed: other}))).any(-1)
    np.testing.assert_array_equal(differs, np.arange(STEPS) >= 2)


def test_kinds_of_actions() -> None:
    kinds = {
        name: settings.init(jax.random.key(0), OBSERVATION, ACTION, 0).action_kind
        for name, settings in SETTINGS.items()
    }
    assert kinds == {
        "gaussian": "continuous",
        "categorical": "discrete",
        "recurrent": "continuous",
        "recurrent, discrete": "discrete",
    }
    policy = SETTINGS["recurrent, discrete"].init(jax.random.key(0), OBSERVATION, ACTION, 0)
    first = jax.tree.map(lambda x: x[0], random_inputs())
    distribution, _ = policy(first, jnp.zeros(0), policy.initial_carry())
    assert isinstance(distribution, Categorical)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"hidden_size": 0}, "`hidden_size` must be at least 1, got 0"),
        ({"encoder_sizes": (3, 0)}, "`encoder_sizes` must be positive"),
        ({"readout_sizes": (-1,)}, "`readout_sizes` must be positive"),
        ({"initial_std": 0.0}, "`initial_std` must be positive"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Recurrent(**settings)


def test_misspelt_settings_do_not_count_as_the_other_one() -> None:
    # In a process of its own, because the run-time type checks of the tests would come first.
    program = """
from maesn.policies import Recurrent
for wrong in ({"action_kind": "both"}, {"observed_reward": "no"}):
    try:
        Recurrent(**wrong)
    except ValueError as error:
        print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == [
        "`action_kind` must be 'continuous' or 'discrete', got 'both'.",
        "`observed_reward` must be 'paid' or 'sparse', got 'no'.",
    ]


def test_hidden_sizes_of_the_feed_forward_policy_are_checked() -> None:
    with pytest.raises(ValueError, match="`hidden_sizes` must be positive"):
        CategoricalMLP((0,))
