"""PPO's loss and TRPO's step on trials whose numbers are known."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn import ProximalStep, TrustRegionStep
from maesn.learners import GradientStep
from maesn.learners.policy_steps import AbstractPolicyStep
from maesn.learners.trials import Trials
from maesn.numerics import Categorical, MinibatchDescent
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import PolicyInput, Recurrent, RecurrentPolicy

TRIALS, STEPS, CHOICES, CLIP, ENTROPY = 5, 4, 3, 0.2, 0.1


def random_trials(logits: np.ndarray | None = None) -> tuple[Trials, np.ndarray]:
    """Trials of a categorical policy, and advantages of both signs; some steps are invalid."""
    stream = np.random.default_rng(0)
    shape = (TRIALS, STEPS)
    behaviour = stream.normal(size=(*shape, CHOICES)) if logits is None else logits
    action = np.eye(CHOICES)[stream.integers(0, CHOICES, shape)]
    valid = np.ones(shape, bool)
    valid[0, 2:] = valid[1, 1] = False
    trials = Trials(
        inputs=PolicyInput(
            observation=jnp.asarray(stream.normal(size=(*shape, 1)), float),
            previous_action=jnp.asarray(np.roll(action, 1, axis=1), float),
            previous_reward=jnp.asarray(stream.normal(size=shape), float),
            episode_start=jnp.zeros(shape, bool).at[:, 0].set(True),
        ),
        action=jnp.asarray(action, float),
        reward=jnp.zeros(shape),
        valid=jnp.asarray(valid),
        behaviour=Categorical(jnp.asarray(behaviour, float)),
        z=jnp.zeros((TRIALS, 0)),
    )
    return trials, stream.normal(size=shape)


def reference_loss(
    logits: np.ndarray, trials: Trials, advantages: np.ndarray
) -> tuple[float, float]:
    """Equation 7 of Schulman et al. (2017) with the entropy, step by step; and clipped share."""
    gains, clipped, entropies = [], [], []
    old = np.float64(trials.behaviour.log_probabilities)  # type: ignore[attr-defined]
    new = logits - np.log(np.exp(logits).sum(-1, keepdims=True))
    for i, t in np.argwhere(np.asarray(trials.valid)):
        arm = int(np.argmax(trials.action[i, t]))
        ratio, a = math.exp(new[i, t, arm] - old[i, t, arm]), advantages[i, t]
        bounded = min(max(ratio, 1 - CLIP), 1 + CLIP)
        gains.append(min(ratio * a, bounded * a))
        clipped.append(ratio != bounded)
        entropies.append(-np.sum(np.exp(new[i, t]) * new[i, t]))
    return -np.mean(gains) - ENTROPY * np.mean(entropies), float(np.mean(clipped))


def moved_logits(trials: Trials) -> np.ndarray:
    """So far from what was played that some ratios are clipped, on both sides."""
    return np.float64(trials.behaviour.logits) + np.random.default_rng(1).normal(  # type: ignore[attr-defined]
        scale=0.3, size=(TRIALS, STEPS, CHOICES)
    )


@eqx.filter_jit
def loss_and_gradient(
    step: ProximalStep, logits: jax.Array, trials: Trials, advantages: jax.Array
) -> Any:
    """((loss, info), gradient in the logits)."""
    return jax.value_and_grad(
        lambda varied: step.loss(Categorical(varied), trials, advantages), has_aux=True
    )(logits)


def test_the_loss_is_the_formula() -> None:
    trials, advantages = random_trials()
    logits = moved_logits(trials)
    (loss, info), _ = loss_and_gradient(
        ProximalStep(CLIP, ENTROPY), np.float32(logits), trials, np.float32(advantages)
    )
    expected, clipped = reference_loss(logits, trials, advantages)
    assert 0.1 < clipped < 0.9
    assert float(loss) == pytest.approx(expected, rel=1e-5)
    assert float(info.clipped) == pytest.approx(clipped)


def test_the_gradient_is_that_of_finite_differences() -> None:
    trials, advantages = random_trials()
    logits = moved_logits(trials)
    step, width = ProximalStep(CLIP, ENTROPY), 1e-6
    gradient = np.asarray(
        loss_and_gradient(step, np.float32(logits), trials, np.float32(advantages))[1]
    )
    assert not gradient[~np.asarray(trials.valid)].any()
    for index in np.ndindex(logits.shape):
        direction = np.zeros_like(logits)
        direction[index] = width
        high, low = (reference_loss(logits + s * direction, trials, advantages)[0] for s in (1, -1))
        assert gradient[index] == pytest.approx((high - low) / (2 * width), rel=1e-3, abs=1e-6)


distributions = eqx.filter_jit(Trials.distributions)


@eqx.filter_jit
def take(step: AbstractPolicyStep, policy: RecurrentPolicy, state: Any, *data: Any) -> Any:
    """One program for each kind of step, as the learner compiles it."""
    return step(jax.random.key(0), policy, state, *data)


@cache
def own_trials() -> tuple[RecurrentPolicy, Trials, jax.Array]:
    """A policy, and trials whose recorded distributions are its own."""
    policy = Recurrent("discrete", (), 3, ()).init(jax.random.key(0), 1, CHOICES, 0)
    trials, advantages = random_trials()
    played = distributions(trials, policy)
    return policy, replace(trials, behaviour=played), jnp.asarray(advantages, float)


BOUNDED = [
    ProximalStep(descent=MinibatchDescent(3e-3, minibatches=2)),
    TrustRegionStep(TrustRegion(cg_steps=5), curvature_stride=1),
]
every_step = pytest.mark.parametrize("step", BOUNDED)


@every_step
def test_a_step_makes_what_was_good_likelier(step: ProximalStep | TrustRegionStep) -> None:
    policy, trials, advantages = own_trials()
    state = step.init(policy)
    improved, _, info = take(step, policy, state, trials, advantages)
    before, after = (p.log_prob(trials.action) for p in
                     (trials.behaviour, distributions(trials, improved)))  # fmt: skip
    gain = np.where(trials.valid, (after - before) * advantages, 0.0).sum()
    assert gain > 0.01
    assert bool(info.accepted)
    assert 0 < float(info.kl) < 0.05


@pytest.mark.parametrize("step", [*BOUNDED, GradientStep()])
def test_what_is_not_finite_is_rejected(step: AbstractPolicyStep) -> None:
    policy, trials, advantages = own_trials()
    broken = advantages.at[2, 0].set(jnp.nan)
    state = step.init(policy)
    kept, after, info = take(step, policy, state, trials, broken)
    assert not bool(info.accepted)
    jax.tree.map(np.testing.assert_array_equal, (kept, after), (policy, state))


@every_step
def test_garbage_changes_nothing(step: ProximalStep | TrustRegionStep) -> None:
    policy, trials, advantages = own_trials()
    state = step.init(policy)
    clean = take(step, policy, state, trials, advantages)[0]
    invalid = ~trials.valid
    logits = jnp.where(invalid[..., None], jnp.nan, trials.behaviour.logits)  # type: ignore[attr-defined]
    dirty = replace(trials, behaviour=Categorical(logits))
    spoiled = take(step, policy, state, dirty, jnp.where(invalid, jnp.nan, advantages))
    jax.tree.map(np.testing.assert_array_equal, clean, spoiled[0])
