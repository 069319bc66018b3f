"""Meta-gradients of the fillings that the reference does not have, by finite differences.

Deterministic contexts and learned step sizes of theta: the directional derivative of the outer
loss, in double precision, along directions that move every array of parameters.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.compiling import quick_compilation as quick_compilation
from learning_problems.prepared import ACTION, OBSERVATION, SIZES, UNEQUAL, make_problem
from learning_problems.translation import experience_for

from maesn.adaptation import Adaptation, InnerStep
from maesn.context import BiasContext
from maesn.learners import PRESETS
from maesn.learners.objective import MetaObjective
from maesn.policies import GaussianMLP

ROWS = (3, 0)
# The paper's fillings, and MAESN with theta from the first iteration on.
FILLINGS: dict[str, dict[str, Any]] = {
    "maml_bias": {"context": BiasContext(2)},
    "maesn_theta": {"adaptation": Adaptation(InnerStep(0.1), InnerStep(0.5))},
}


@pytest.mark.parametrize("preset", FILLINGS)
@pytest.mark.usefixtures("x64", "quick_compilation")
def test_meta_gradient(preset: str) -> None:
    learner = PRESETS[preset](
        policy=GaussianMLP(SIZES[1:-1]), meta_batch_size=len(ROWS), **FILLINGS[preset]
    )
    problem = make_problem(2, UNEQUAL, latent=2)
    *pre, post = experience_for(learner, problem, ROWS)
    objective = MetaObjective(
        learner.context, learner.adaptation, jnp.asarray(ROWS), tuple(pre), *post
    )
    state = learner.init(jax.random.key(0), OBSERVATION, ACTION, len(problem.tasks))
    flat, unravel = ravel_pytree(state.parameters)
    rng = np.random.default_rng(0)
    # Beside the start, where biases are 0 and step sizes equal.
    here = flat + 0.1 * rng.normal(size=flat.shape)
    loss = eqx.filter_jit(lambda x: objective.evaluate(unravel(x)).loss)
    gradient = unravel(jax.jit(jax.grad(loss))(here))
    groups = (gradient.policy, gradient.context, gradient.step_sizes)
    assert all(np.abs(leaf).max() > 0 for leaf in jax.tree.leaves(groups))
    slope, _ = ravel_pytree(gradient)
    for direction in rng.normal(size=(5, len(flat))):
        ahead, behind = (loss(here + side * direction) for side in (1e-6, -1e-6))
        expected = (ahead - behind) / 2e-6
        np.testing.assert_allclose(slope @ direction, expected, rtol=1e-6, atol=1e-8)
