"""The meta-gradient of the filling that the reference does not have, by finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.prepared import ACTION, OBSERVATION, SIZES, UNEQUAL, make_problem
from learning_problems.translation import experience_for

from maesn import maml_bias
from maesn.context import BiasContext
from maesn.learners import Problem
from maesn.learners.gradient.objective import MetaObjective
from maesn.policies import GaussianMLP

ROWS = (3, 0)


@pytest.mark.usefixtures("x64")
def test_a_bias_and_learned_step_sizes_of_theta() -> None:
    """Directional derivatives of the outer loss and of the KL; they move every array."""
    policy = GaussianMLP(SIZES[1:-1])
    learner = maml_bias(context=BiasContext(2), policy=policy, meta_batch_size=len(ROWS))
    problem = make_problem(2, UNEQUAL)
    *pre, post = experience_for(learner, problem, ROWS)
    objective = MetaObjective(
        learner.context, learner.adaptation, jnp.asarray(ROWS), tuple(pre), *post
    )
    state = learner.init(jax.random.key(0), Problem(OBSERVATION, ACTION, len(problem.tasks)))
    flat, unravel = ravel_pytree(state.parameters)
    rng = np.random.default_rng(0)
    # Beside the start, where biases are 0 and step sizes equal.
    here = flat + 0.1 * rng.normal(size=flat.shape)
    evaluate = eqx.filter_jit(lambda x: tuple(objective.evaluate(unravel(x))))
    slopes = jax.jit(jax.jacfwd(lambda x: tuple(objective.evaluate(unravel(x)))))(here)
    loss, own = jax.jit(lambda x: objective.loss_and_gradient(unravel(x)))(here)
    np.testing.assert_allclose(loss, evaluate(here)[0], rtol=1e-12)
    np.testing.assert_allclose(ravel_pytree(own)[0], slopes[0], rtol=1e-9, atol=1e-12)
    for slope in slopes:
        for leaf in jax.tree.leaves(unravel(slope)):
            assert np.abs(leaf).max() > 0
    for direction in rng.normal(size=(5, len(flat))):
        ahead, behind = (evaluate(here + side * direction) for side in (1e-6, -1e-6))
        for slope, high, low in zip(slopes, ahead, behind, strict=True):
            expected = (high - low) / 2e-6
            np.testing.assert_allclose(slope @ direction, expected, rtol=1e-6, atol=1e-8)
