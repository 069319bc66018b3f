"""TRPO's step on problems whose natural gradient is known in closed form."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.numerics import DiagonalGaussian
from maesn.numerics.trust_region import Candidate, TrustRegion, TrustRegionInfo

Array = Any
STD = np.array([0.5, 1.0, 2.0])
ONE = jnp.ones(1)


def gaussian(parameters: dict[str, Array]) -> DiagonalGaussian:
    """One distribution whose coordinates are the parameters themselves, `[1, 3]`."""
    return DiagonalGaussian(parameters["mean"][None], parameters["log_std"][None])


def start() -> dict[str, Array]:
    return {"mean": jnp.asarray([1.0, -2.0, 0.5]), "log_std": jnp.log(jnp.asarray(STD, float))}


def step(
    region: TrustRegion, loss: Callable[[dict[str, Array]], Array], parameters: Any = None
) -> tuple[dict[str, Array], TrustRegionInfo]:
    parameters = start() if parameters is None else parameters
    old = gaussian(parameters)

    def evaluate(candidate: dict[str, Array]) -> Candidate:
        return Candidate(loss(candidate), old.kl(gaussian(candidate))[0])

    return jax.jit(lambda x: region.step(x, evaluate, slopes(evaluate), gaussian, ONE))(parameters)


def slopes(evaluate: Callable[[Any], Candidate]) -> Callable[[Any], tuple[Array, Any]]:
    """The loss and its gradient."""
    return jax.value_and_grad(lambda x: evaluate(x).loss)


def bits(tree: object) -> list[bytes]:
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree)]


@pytest.mark.parametrize("damping", [1e-5, 0.1])
def test_the_step_is_the_natural_gradient_step(damping: float) -> None:
    """For a linear loss g·x and F = diag(1/std^2, 2): d = -(F + damping)^-1 g.

    The length makes d'(F + damping)d half a squared norm of max_kl; cg needs as many steps as F
    has different eigenvalues.
    """
    region = TrustRegion(max_kl=1e-4, damping=damping)
    g_mean, g_log_std = np.array([1.0, 0.5, -2.0]), np.array([0.3, -1.0, 0.2])

    def loss(x: dict[str, Array]) -> Array:
        return x["mean"] @ jnp.asarray(g_mean, float) + x["log_std"] @ jnp.asarray(g_log_std, float)

    after, info = step(region, loss)
    d_mean, d_log_std = -g_mean / (STD**-2 + damping), -g_log_std / (2 + damping)
    squared = d_mean @ ((STD**-2 + damping) * d_mean) + (2 + damping) * d_log_std @ d_log_std
    # Third-order terms of the KL may exceed the bound: then the step is shortened once.
    scale = math.sqrt(2e-4 / squared) * 0.8 ** int(info.backtracks)
    assert info.accepted
    assert info.backtracks <= 1
    before = start()
    np.testing.assert_allclose(after["mean"] - before["mean"], scale * d_mean, atol=1e-6)
    np.testing.assert_allclose(after["log_std"] - before["log_std"], scale * d_log_std, atol=1e-6)
    gain = scale * (g_mean @ d_mean + g_log_std @ d_log_std)
    np.testing.assert_allclose(info.loss_after - info.loss_before, gain, rtol=1e-3)
    norm = np.sqrt(g_mean @ g_mean + g_log_std @ g_log_std)
    np.testing.assert_allclose(info.gradient_norm, norm, rtol=1e-6)
    assert info.residual_norm < 1e-4 * norm


@pytest.mark.parametrize("distance", [0.01, 0.02, 0.04])
def test_backtracking_stops_at_the_first_candidate_that_is_better(distance: float) -> None:
    """From `distance` before the minimum, 0.8^k s helps if and only if it is below 2 distance.

    s = std sqrt(2 max_kl) is the whole step.
    """
    minimum = start()["mean"][0] + distance
    after, info = step(TrustRegion(), lambda x: (x["mean"][0] - minimum) ** 2)
    whole = STD[0] * math.sqrt(2 * 0.01)
    backtracks = max(0, math.ceil(math.log(2 * distance / whole) / math.log(0.8)))
    assert info.accepted
    assert info.backtracks == backtracks
    moved = after["mean"][0] - start()["mean"][0]
    np.testing.assert_allclose(moved, 0.8**backtracks * whole, rtol=1e-3)


@pytest.mark.parametrize("ratio", [0.5, 0.8])
def test_candidates_end_at_the_last(ratio: float) -> None:
    # Even the fourth candidate is more than twice too long, the fifth is not.
    whole = STD[0] * math.sqrt(2 * 0.01)
    distance = 0.45 * whole * ratio**3
    minimum = start()["mean"][0] + distance
    region = TrustRegion(backtrack_ratio=ratio, max_backtracks=4)
    after, info = step(region, lambda x: (x["mean"][0] - minimum) ** 2)
    assert not info.accepted
    assert info.backtracks == 3
    assert bits(after) == bits(start())
    one_more = TrustRegion(backtrack_ratio=ratio, max_backtracks=5)
    assert step(one_more, lambda x: (x["mean"][0] - minimum) ** 2)[1].accepted


@jax.jit
def step_to(value: Array, parameters: dict[str, Array]) -> tuple[dict[str, Array], TrustRegionInfo]:
    """Step where the loss is good at the start and `value` wherever the step leads."""
    here = start()["mean"][0]
    return step(
        TrustRegion(), lambda x: jnp.where(x["mean"][0] == here, x["mean"][0], value), parameters
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_candidates_that_are_not_finite_are_rejected(value: float) -> None:
    # A minus sign before zero and a denormal number are kept as well.
    parameters = start() | {"log_std": jnp.asarray([-0.0, 1e-40, 0.5])}
    after, info = step_to(jnp.asarray(value), parameters)
    assert not info.accepted
    assert info.backtracks == 14
    assert info.loss_after == info.loss_before == 1.0
    assert info.kl == 0.0
    assert bits(after) == bits(parameters)


@jax.jit
def step_from(value: Array) -> tuple[dict[str, Array], TrustRegionInfo]:
    return step(TrustRegion(), lambda x: value * jnp.sum(x["mean"] ** 2))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_start_that_is_not_finite_is_rejected(value: float) -> None:
    after, info = step_from(jnp.asarray(value))
    assert not info.accepted
    assert not np.isfinite(info.loss_before)
    assert bits(after) == bits(start())


def test_a_gradient_that_is_not_finite_is_rejected() -> None:
    zero = start()["mean"][0]
    after, info = step(TrustRegion(), lambda x: jnp.sqrt(jnp.abs(x["mean"][0] - zero)))
    assert np.isfinite(info.loss_before)
    assert not np.isfinite(info.gradient_norm)
    assert not info.accepted
    assert bits(after) == bits(start())


def test_the_curvature_weighs_the_distributions() -> None:
    # The second distribution is a thousand times more sensitive, but may have no weight.
    def two(x: Array) -> DiagonalGaussian:
        return DiagonalGaussian(jnp.stack([x, 1e3 * x]), jnp.zeros((2, 1)))

    at = jnp.zeros(1)
    old = two(at)

    def evaluate(x: Array) -> Candidate:
        return Candidate(jnp.sum(x), old.kl(two(x))[0])

    for weight, curvature in (([1.0, 0.0], 1.0), ([0.5, 0.5], 0.5 + 0.5e6)):
        region = TrustRegion(max_kl=0.02, damping=1e-2)
        stepped = jax.jit(partial(region.step, at, evaluate, slopes(evaluate), two))
        after, info = stepped(jnp.asarray(weight))
        assert info.accepted
        # d = -1/(c + damping); a constant 1e-8 keeps its length finite where curvature vanishes.
        direction = -1 / (curvature + 1e-2)
        expected = math.sqrt(2 * 0.02 / (-direction + 1e-8)) * direction
        np.testing.assert_allclose(after, expected, rtol=1e-4)
