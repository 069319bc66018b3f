"""The curvature of the outer step against the dense product, for every preset."""

from dataclasses import replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.prepared import ACTION, LATENT, OBSERVATION, UNEQUAL, make_problem
from learning_problems.translation import experience_for

from maesn.context import BiasContext, LatentContext
from maesn.experience.episodes import Thinning
from maesn.inner.surrogate import post_distributions
from maesn.learners import PRESETS, Problem
from maesn.learners.gradient.curvature import sampled_distributions, step_weights
from maesn.learners.gradient.meta_learner import GradientMetaLearner
from maesn.learners.gradient.objective import MetaObjective, MetaParameters
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import GaussianMLP

ROWS = (3, 0, 4)
# What an inner update moves decides what is differentiated: latents, biases, theta, or nothing.
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "maesn": ("maesn", {}),
    "maesn_theta": ("maesn_theta", {}),
    "maml_bias": ("maml_bias", {}),
    "latent_space": ("latent_space", {}),
    "reparameterized": ("maesn", {"context": LatentContext(gradient="reparameterized")}),
    "maml, two updates": ("maml", {"inner_updates": 2}),
    "maml_bias_only, two updates": ("maml_bias_only", {"inner_updates": 2}),
}
# What the others are made of.
LONG = ["maesn", "maml_bias", "maml, two updates"]
every_case = pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.long] if case in LONG else []) for case in CASES]
)
a_bias = pytest.param("maml_bias", marks=pytest.mark.long)
REGION = TrustRegion(damping=1e-3)
ALL, SOME, OTHERS = Thinning(1, 0), Thinning(2, 1), Thinning(3, 0)
pytestmark = pytest.mark.usefixtures("x64")


@cache
def problem_of(case: str) -> tuple[MetaObjective, MetaParameters]:
    """Return an objective, and parameters beside those where biases are 0 and sizes equal."""
    method, settings = CASES[case]
    learner = PRESETS[method](policy=GaussianMLP((4,)), meta_batch_size=len(ROWS), **settings)
    assert isinstance(learner, GradientMetaLearner)
    if "bias" in method:
        learner = replace(learner, context=BiasContext(2))
    latent = LATENT if learner.adaptation.context is not None else 0
    updates = max(learner.inner_updates, 1)
    problem = make_problem(2, UNEQUAL, inner_updates=updates, latent=latent)
    *pre, post = experience_for(learner, problem, ROWS)
    objective = MetaObjective(
        learner.context, learner.adaptation, jnp.asarray(ROWS), tuple(pre), *post
    )
    state = learner.init(jax.random.key(0), Problem(OBSERVATION, ACTION, len(problem.tasks)))
    flat, unravel = ravel_pytree(state.parameters)
    return objective, unravel(flat + 0.2 * jax.random.normal(jax.random.key(1), flat.shape))


def products(
    objective: MetaObjective, parameters: MetaParameters, outer: Thinning, inner: Thinning
) -> jax.Array:
    """Return the curvature's matrix, column by column."""
    flat, unravel = ravel_pytree(parameters)

    @jax.jit
    def columns(x: jax.Array) -> jax.Array:
        updated = objective.updated(unravel(x))
        product = REGION._curvature_product(
            lambda x: sampled_distributions(objective, unravel(x), updated, outer, inner),
            x,
            step_weights(objective.post.every(*outer)),
        )
        return jax.vmap(product)(jnp.eye(x.size))

    return columns(flat)


def dense(jacobian: Any, at: Any, weight: jax.Array) -> np.ndarray:
    """Return J'FJ + damping I, with F = diag(1/std^2, 2) of Gaussians."""
    size = jacobian.mean.shape[-1]
    rows = [
        np.asarray(j).reshape(-1, size) * np.sqrt(np.asarray(f * weight[..., None]).reshape(-1, 1))
        for j, f in (
            (jacobian.mean, jnp.exp(-2 * at.log_std)),
            (jacobian.log_std, jnp.full_like(at.log_std, 2.0)),
        )
    ]
    return sum(r.T @ r for r in rows) + REGION.damping * np.eye(size)


@every_case
def test_with_stride_one_it_is_the_exact_product(case: str) -> None:
    """J by forward mode through the whole definition, without a loop and without sampling."""
    objective, parameters = problem_of(case)
    flat, unravel = ravel_pytree(parameters)

    def distribution(x: jax.Array) -> Any:
        return objective.distributions(unravel(x), objective.post)

    at, jacobian = jax.jit(lambda x: (distribution(x), jax.jacfwd(distribution)(x)))(flat)
    expected = dense(jacobian, at, step_weights(objective.post))
    actual = products(objective, parameters, ALL, ALL)
    np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


@every_case
def test_sampling_changes_derivatives_alone(case: str) -> None:
    objective, parameters = problem_of(case)

    @jax.jit
    def both(p: MetaParameters) -> Any:
        updated = objective.updated(p)
        sampled = sampled_distributions(objective, p, updated, SOME, OTHERS)
        return sampled, objective.distributions(p, objective.post.every(*SOME))

    sampled, exact = both(parameters)
    np.testing.assert_allclose(sampled.mean, exact.mean, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(sampled.log_std, exact.log_std, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    "case", ["maesn_theta", a_bias, pytest.param("reparameterized", marks=pytest.mark.long)]
)
def test_derivatives_of_the_inner_step_are_of_the_sampled_steps(case: str) -> None:
    """Where the inner update goes through the policy.

    By the chain rule: the exact policy's Jacobian times that of the update on a sample.
    """
    objective, parameters = problem_of(case)
    pre = tuple((e.every(*OTHERS), a.every(*OTHERS)) for e, a in objective.pre)
    sample = replace(objective, pre=pre)
    flat, unravel = ravel_pytree(parameters)
    adapted = eqx.filter_jit(objective.adapted)(parameters)
    moved, unravel_agents = ravel_pytree(adapted)
    post = objective.post.every(*SOME)

    def distribution(agents: jax.Array) -> Any:
        return unravel_agents(agents).map(post_distributions, post, how="vmap")

    update = jax.jit(jax.jacfwd(lambda x: ravel_pytree(sample.adapted(unravel(x)))[0]))(flat)
    at, outer = jax.jit(lambda x: (distribution(x), jax.jacfwd(distribution)(x)))(moved)
    jacobian = jax.tree.map(lambda x: x @ update, outer)
    expected = dense(jacobian, at, step_weights(post))
    actual = products(objective, parameters, SOME, OTHERS)
    np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())
    exact = products(objective, parameters, SOME, ALL)
    assert np.abs(exact - expected).max() > 1e-3 * np.abs(exact).max()


@pytest.mark.parametrize("case", ["maesn_theta", "latent_space", a_bias])
def test_task_by_task_is_all_at_once(case: str) -> None:
    """Loss, divergence and gradient of the loop, against those of the whole batch."""
    objective, parameters = problem_of(case)

    @jax.jit
    def found(p: MetaParameters) -> Any:
        return objective.evaluate(p), objective.loss_and_gradient(p)

    @jax.jit
    def at_once(p: MetaParameters) -> Any:
        loss = jax.value_and_grad(lambda varied: objective.evaluate_at_once(varied).loss)
        return objective.evaluate_at_once(p), loss(p)

    evaluations = found(parameters), at_once(parameters)
    kl = float(evaluations[1][0].kl)
    bounded = eqx.filter_jit(objective.evaluate)
    assert bounded(parameters, largest_kl=jnp.asarray(1.01 * kl)) == evaluations[0][0]
    # The first tasks are enough to know.
    assert 0.1 * kl < bounded(parameters, largest_kl=jnp.asarray(0.1 * kl)).kl < 0.99 * kl
    for actual, expected in zip(*map(jax.tree.leaves, evaluations), strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-11, atol=1e-13)
