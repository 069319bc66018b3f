"""Soft actor-critic: its losses in NumPy, its gradients, a problem whose soft value is known."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from maesn.learners.pearl.replay import Batch
from maesn.learners.pearl.sac import ActorCritic, SoftActorCritic, predict
from maesn.networks import MLP

SAC = SoftActorCritic((6,), batch_size=5, discount=0.9, reward_scale=3.0)


def problem(kind: Any = jnp.float64) -> tuple[ActorCritic, Batch, jax.Array, jax.Array]:
    """Networks of a task with 2 observations, 2 actions and 3 latents."""
    networks = SAC.init(jax.random.key(0), 2, 2, 3, "own")
    keys = iter(jax.random.split(jax.random.key(1), 8))
    batch = Batch(
        jax.random.normal(next(keys), (5, 2)),
        jnp.tanh(jax.random.normal(next(keys), (5, 2))),
        jax.random.normal(next(keys), (5,)),
        jnp.zeros(5),
        jax.random.normal(next(keys), (5, 2)),
        jnp.asarray([0.0, 1.0, 0.0, 0.0, 1.0]),
    )
    z, noise = jax.random.normal(next(keys), (5, 3)), jax.random.normal(next(keys), (5, 2))
    found: Any = jax.tree.map(lambda x: x.astype(kind), (networks, batch, z, noise))
    return found


def by_hand(network: MLP, *inputs: jax.Array) -> np.ndarray:
    x = np.concatenate([np.asarray(one) for one in inputs], axis=1)
    for layer in network.layers[:-1]:
        x = np.maximum(x @ np.asarray(layer.weight) + np.asarray(layer.bias), 0.0)
    return x @ np.asarray(network.layers[-1].weight) + np.asarray(network.layers[-1].bias)


def test_losses_equal_their_formulas(x64: None) -> None:
    networks, batch, z, noise = problem()
    following = by_hand(networks.target, batch.next_observation, z)[:, 0]
    wanted = 3.0 * np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * following
    errors = [by_hand(q, batch.observation, batch.action, z)[:, 0] - wanted for q in networks.q]
    expected = sum((error**2).mean() for error in errors)
    actual = SAC.q_loss(networks.q, networks.target, batch, z)
    assert float(actual) == pytest.approx(expected, rel=1e-9)

    outputs = by_hand(networks.policy.mlp, batch.observation, z)
    mean, log_std = outputs[:, :2], outputs[:, 2:]
    u = mean + np.exp(log_std) * np.asarray(noise)
    log_prob = -0.5 * np.asarray(noise) ** 2 - log_std - 0.5 * np.log(2 * np.pi)
    log_prob = (log_prob - np.log(1 - np.tanh(u) ** 2)).sum(1)
    qs = [by_hand(q, batch.observation, np.tanh(u), z)[:, 0] for q in networks.q]
    penalty = 1e-3 * ((mean**2).mean() + (log_std**2).mean())
    loss, (soft, entropy) = SAC.policy_loss(
        networks.policy, networks.q, batch.observation, z, noise
    )
    assert float(loss) == pytest.approx((log_prob - np.minimum(*qs)).mean() + penalty, rel=1e-9)
    np.testing.assert_allclose(soft, np.minimum(*qs) - log_prob, rtol=1e-9)
    assert float(entropy) == pytest.approx(-log_prob.mean(), rel=1e-9)


def test_gradients_equal_finite_differences(x64: None) -> None:
    networks, batch, z, noise = problem()

    def q_loss(q: Any, z: Any = z) -> Any:
        return SAC.q_loss(q, networks.target, batch, z)

    def policy_loss(policy: Any) -> Any:
        return SAC.policy_loss(policy, networks.q, batch.observation, z, noise)[0]

    # The target has no gradient.
    following = predict(networks.target, batch.next_observation, z)

    def held(z: Any) -> Any:
        wanted = 3.0 * batch.reward + 0.9 * (1 - batch.terminal) * following
        errors = (predict(q, batch.observation, batch.action, z) - wanted for q in networks.q)
        return sum((error**2).mean() for error in errors)

    gradient = jax.jit(jax.grad(lambda z: q_loss(networks.q, z)))(z)
    np.testing.assert_allclose(gradient, jax.jit(jax.grad(held))(z), rtol=1e-9)
    for loss, at in (
        (lambda q: q_loss(q, z), networks.q),
        (held, z),
        (policy_loss, networks.policy),
    ):
        check_grads(jax.jit(loss), (at,), order=1, modes=["rev"], eps=1e-6)


def test_a_step_moves_all_networks_and_the_slow_copy_slowly() -> None:
    networks = SAC.init(jax.random.key(0), 2, 2, 3, "own")
    _, batch, _, _ = problem(jnp.float32)
    encoder = jnp.ones((5, 3))

    @jax.jit
    def step(networks: Any, encoder: Any) -> Any:
        optimisers, key = SAC.init_optimisers(networks, encoder), jax.random.key(0)
        return SAC.step(
            key, networks, encoder, optimisers, batch, lambda z: (z, 0.1 * jnp.sum(z**2))
        )

    after, moved, _, losses = step(networks, encoder)
    pairs = zip(*map(jax.tree.leaves, (after, networks)), strict=True)
    assert all(bool((x != y).any()) for x, y in pairs)
    assert bool((moved != encoder).all())
    for slow, old, new in zip(
        *map(jax.tree.leaves, (after.target, networks.target, after.value)), strict=True
    ):
        np.testing.assert_allclose(slow, old + 0.005 * (new - old), rtol=1e-5, atol=1e-7)
    assert all(np.isfinite(x) for x in jax.tree.leaves(losses))


def test_the_soft_value_of_a_linear_quadratic_problem_is_found() -> None:
    """With s' = A s + B a and the reward -(s² + r a²), the soft value is -P s² + k.

    P solves a Riccati equation, and k = log(π / M) / 2 / (1 - γ) is the entropy of Gaussian actions
    with M = c r + γ P B²: log ∫ exp(-M (a - a*)²) da. Their standard deviation is a quarter of the
    limits of an action, which therefore hardly matter.
    """
    a, b, r, discount, scale = 0.6, 0.4, 0.5, 0.7, 10.0
    p = scale
    for _ in range(200):
        m = scale * r + discount * p * b**2
        p = scale + discount * p * a**2 - (discount * p * a * b) ** 2 / m
    constant = 0.5 * np.log(np.pi / m) / (1 - discount)
    sac = SoftActorCritic(
        (32, 32), discount=discount, reward_scale=scale, learning_rate=3e-3, target_rate=0.05,
        output_penalty=0.0,
    )  # fmt: skip
    networks = sac.init(jax.random.key(0), 1, 1, 0, "own")
    nothing = jnp.zeros((128, 0))

    def one(now: Any, key: jax.Array) -> Any:
        state_key, action_key, step_key = jax.random.split(key, 3)
        s = jax.random.uniform(state_key, (128, 1), minval=-1.0)
        action = jax.random.uniform(action_key, (128, 1), minval=-1.0)
        reward = -(s**2 + r * action**2)[:, 0]
        batch = Batch(s, action, reward, reward, a * s + b * action, jnp.zeros(128))
        networks, optimisers = now
        networks, _, optimisers, losses = sac.step(
            step_key, networks, (), optimisers, batch, lambda _: (nothing, jnp.zeros(()))
        )
        return (networks, optimisers), losses

    keys = jax.random.split(jax.random.key(1), 1500)
    start = networks, sac.init_optimisers(networks, ())
    (networks, _), _ = jax.jit(lambda start: jax.lax.scan(one, start, keys))(start)
    s = jnp.linspace(-0.9, 0.9, 19)[:, None]
    value = predict(networks.value, s)
    np.testing.assert_allclose(value, constant - p * s[:, 0] ** 2, atol=0.3)
    actions = jax.vmap(networks.policy.actions)(s, jnp.zeros((19, 0)))
    expected = -discount * p * a * b / m * s
    np.testing.assert_allclose(actions.mode(), expected, atol=0.06)
    np.testing.assert_allclose(actions.std(), np.full((19, 1), np.sqrt(0.5 / m)), rtol=0.2)
