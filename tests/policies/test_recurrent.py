"""Policies along episodes: the same as step by step, with memory and without."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.axes import RecurrentState
from maesn.numerics import Categorical, DiagonalGaussian
from maesn.policies import (
    AbstractPolicy,
    AbstractPolicySettings,
    CategoricalMLP,
    GaussianMLP,
    HyperRecurrent,
    PolicyInput,
    Recurrent,
)

OBSERVATION, ACTION, CONTEXT, EPISODES, STEPS = 3, 2, 2, 3, 7
SETTINGS: dict[str, AbstractPolicySettings] = {
    "gaussian": GaussianMLP((4,)),
    "categorical": CategoricalMLP((4,)),
    "recurrent": Recurrent(hidden_size=4, readout_sizes=(3,)),
    "recurrent, discrete": Recurrent("discrete", (5,), 4, (3,)),
    "hypernetwork": HyperRecurrent(hidden_size=4, readout_sizes=(3,), symlog=True),
}


def random_inputs() -> PolicyInput:
    stream = np.random.default_rng(0)
    return PolicyInput(
        observation=jnp.asarray(stream.normal(size=(EPISODES, STEPS, OBSERVATION)), float),
        previous_action=jnp.asarray(stream.normal(size=(EPISODES, STEPS, ACTION)), float),
        previous_reward=jnp.asarray(stream.normal(size=(EPISODES, STEPS)), float),
        episode_start=jnp.asarray(stream.random((EPISODES, STEPS)) < 0.3),
    )


def fresh_memory(policy: AbstractPolicy) -> RecurrentState:
    return jax.tree.map(lambda x: jnp.stack([x] * EPISODES), policy.initial_recurrent_state())


@eqx.filter_jit
def unroll(policy: AbstractPolicy, *given: Any) -> Any:
    return policy.unroll(*given)


@eqx.filter_jit
def advance(policy: AbstractPolicy, *given: Any) -> Any:
    return policy(*given)


@pytest.mark.parametrize("name", SETTINGS)
def test_unroll_is_step_by_step(name: str) -> None:
    policy = SETTINGS[name].init(jax.random.key(0), OBSERVATION, ACTION, CONTEXT)
    stream = np.random.default_rng(1)
    # A hypernetwork does not read the recurrent state at its start.
    policy = jax.tree.map(
        lambda x: x + jnp.asarray(0.1 * stream.normal(size=x.shape), float), policy
    )
    inputs, context = random_inputs(), jnp.asarray(stream.normal(size=(EPISODES, CONTEXT)), float)
    valid = stream.random((EPISODES, STEPS)) < 0.7
    before = jax.tree.map(
        lambda x: x + jnp.asarray(stream.normal(size=x.shape), float), fresh_memory(policy)
    )
    along, last = unroll(policy, inputs, valid, context, before)
    inputs, context, before, along, last = jax.tree.map(
        np.asarray, (inputs, context, before, along, last)
    )
    for episode in range(EPISODES):
        carry = jax.tree.map(lambda x: x[episode], before)  # noqa: B023
        for t in np.flatnonzero(valid[episode]):
            now, here = jax.tree.map(lambda x: x[episode, t], (inputs, along))  # noqa: B023
            distribution, carry = advance(policy, now, context[episode], carry)
            jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-6),
                         distribution, here)  # fmt: skip
        kept = jax.tree.map(lambda x: x[episode], last)  # noqa: B023
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-5), carry, kept)


def test_symlog_is_what_the_network_reads_of_all_that_is_a_number() -> None:
    own, plain = (
        HyperRecurrent(hidden_size=4, symlog=one).init(jax.random.key(0), OBSERVATION, ACTION, 0)
        for one in (True, False)
    )
    *numbers, start = (100.0 * np.asarray(x) for x in random_inputs())
    valid, z = jnp.ones((EPISODES, STEPS), bool), jnp.zeros((EPISODES, 0))
    logs = (jnp.asarray(np.sign(x) * np.log(1.0 + np.abs(x)), float) for x in numbers)
    read, given = (
        PolicyInput(*(jnp.asarray(x, float) for x in found), jnp.asarray(start > 0))
        for found in (logs, numbers)
    )
    found, expected = (
        unroll(policy, inputs, valid, z, fresh_memory(policy))
        for policy, inputs in ((own, given), (plain, read))
    )
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-6), found, expected)


@pytest.mark.parametrize(
    "changed", ["observation", "previous_action", "previous_reward", "episode_start"]
)
def test_everything_that_is_told_is_remembered(changed: str) -> None:
    """What happens at step 2 reaches all later steps of its episode, and no other."""
    # Without rectified layers, which may be deaf to it.
    policy = Recurrent(hidden_size=4).init(jax.random.key(0), OBSERVATION, ACTION, CONTEXT)
    inputs, context = random_inputs(), jnp.zeros((EPISODES, CONTEXT))
    valid = jnp.ones((EPISODES, STEPS), bool)

    def means(inputs: PolicyInput) -> np.ndarray:
        along, _ = unroll(policy, inputs, valid, context, fresh_memory(policy))
        assert isinstance(along, DiagonalGaussian)
        return np.asarray(along.mean)

    value = getattr(inputs, changed)
    here = (1, 2)
    other: Any = value.at[here].set(~value[here] if value.dtype == bool else value[here] + 1.0)
    differs = (means(inputs) != means(inputs._replace(**{changed: other}))).any(-1)
    later = np.arange(STEPS) >= 2
    np.testing.assert_array_equal(differs, (np.arange(EPISODES)[:, None] == 1) & later)


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
        "hypernetwork": "continuous",
    }
    policy = SETTINGS["recurrent, discrete"].init(jax.random.key(0), OBSERVATION, ACTION, 0)
    first = jax.tree.map(lambda x: x[0, 0], random_inputs())
    distribution, _ = policy(first, jnp.zeros(0), policy.initial_recurrent_state())
    assert isinstance(distribution, Categorical)


@pytest.mark.usefixtures("no_type_checks")
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"action_kind": "both"}, "`action_kind` must be 'continuous' or 'discrete', got 'both'."),
        ({"observed_reward": "no"}, "`observed_reward` must be 'own' or 'sparse', got 'no'."),
    ],
)
def test_misspelt_settings_do_not_count_as_the_other_one(
    wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        Recurrent(**wrong)


def test_a_policy_that_amplifies_its_action_before_stays_finite() -> None:
    policy = Recurrent(hidden_size=4).init(jax.random.key(0), OBSERVATION, ACTION, 0)
    threefold = 3.0 * jnp.eye(ACTION)
    policy = eqx.tree_at(
        lambda one: one.network.readout.layers[-1].weight,
        policy,
        replace_fn=lambda weight: weight.at[OBSERVATION : OBSERVATION + ACTION].set(threefold),
    )
    (hidden,), action = fresh_memory(policy)[:1], jnp.ones(ACTION)
    for _ in range(200):  # 3^200 exceeds single precision
        seen = PolicyInput(jnp.zeros(OBSERVATION), action, jnp.zeros(()), jnp.zeros((), bool))
        actions, hidden = advance(policy, seen, jnp.zeros(0), hidden)
        action = actions.mode()
    assert 100.0 < jnp.abs(action).max() < 1000.0
