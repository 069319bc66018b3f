"""What a meta-iteration computes from fixed episodes stays as it was, to the last digits.

    python tests/learners/test_steps_stay.py      # records the numbers anew

`test_curvature.py` and `test_against_reference.py` prove gradient and curvature against dense and
NumPy references; these numbers hold whole steps, for changes that only make them faster.
"""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.prepared import ACTION, LATENT, OBSERVATION, UNEQUAL, make_problem, stack
from learning_problems.translation import experience_for

from maesn import ProximalStep, RecurrentMetaLearner, RecurrentValue, rl2
from maesn.context import BiasContext
from maesn.experience.episodes import Thinning
from maesn.learners import PRESETS, Problem
from maesn.learners.gradient.curvature import sampled_distributions, step_weights
from maesn.learners.gradient.meta_learner import GradientMetaLearner
from maesn.learners.gradient.objective import MetaObjective
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.numerics import MinibatchDescent
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import GaussianMLP, Recurrent

RECORD = Path(__file__).with_name("steps.npz")
METHODS = ("maesn", "maesn_theta", "maml", "maml_bias", "maml_bias_only", "rl2")
LONG = ("maesn_theta", "maml_bias", "maml_bias_only")  # mixtures of the others
ROWS = (3, 0, 4, 1)
# Conjugate gradients enlarge rounding, tenfold to a thousandfold in each step.
REGION = TrustRegion(cg_steps=5, damping=1e-3)
SECOND_STAGE = 150


def computed(method: str) -> dict[str, np.ndarray]:
    """Return the numbers of one method."""
    if method == "rl2":
        return of_trials(rl2(
            meta_batch_size=len(ROWS),
            policy=Recurrent(hidden_size=5, readout_sizes=(4,)),
            policy_step=ProximalStep(descent=MinibatchDescent(minibatches=2)),
            value=RecurrentValue(hidden_size=5, descent=MinibatchDescent(minibatches=2)),
        ))  # fmt: skip
    outer = TrustRegionOuterStep(REGION, curvature_stride=2, hessian_stride=3)
    bias = {"context": BiasContext(LATENT)} if "bias" in method else {}
    settings = {"policy": GaussianMLP((5, 4)), "outer": outer, **bias}
    learner = PRESETS[method](meta_batch_size=len(ROWS), **settings)
    assert isinstance(learner, GradientMetaLearner)
    return of_gradients(learner)


def of_gradients(learner: GradientMetaLearner) -> dict[str, np.ndarray]:
    """Return loss, gradient, a curvature product and an outer step, away from the start."""
    size = learner.context.init(jax.random.key(0), 1, 0).size
    problem = make_problem(2, UNEQUAL, latent=LATENT if size else 0)
    *pre, post = experience_for(learner, problem, ROWS)
    adaptation = learner.adaptation.at(SECOND_STAGE)
    rows = jnp.asarray(ROWS)
    objective = MetaObjective(learner.context, adaptation, rows, tuple(pre), *post)
    state = learner.init(jax.random.key(0), Problem(OBSERVATION, ACTION, len(problem.tasks)))
    flat, unravel = ravel_pytree(state.parameters)
    rng = np.random.default_rng(0)
    flat = flat + 0.2 * jnp.asarray(rng.normal(size=flat.shape))
    outer, inner = Thinning(2, 1), Thinning(3, 0)

    # As if these parameters had played, so that the line search can succeed.
    behaviour = eqx.filter_jit(objective.distributions)(unravel(flat), objective.post)
    noise = jnp.asarray(rng.normal(size=behaviour.mean.shape))
    action = behaviour.sample_from_noise(noise)
    played = replace(objective.post, behaviour=behaviour, action=action)
    objective = replace(objective, post=played)

    @jax.jit
    def numbers(x: jax.Array) -> dict[str, jax.Array]:
        parameters = unravel(x)
        updated = objective.updated(parameters)
        product = REGION._curvature_product(
            lambda y: sampled_distributions(objective, unravel(y), updated, outer, inner),
            x,
            step_weights(objective.post.every(*outer)),
        )
        loss, gradient = objective.loss_and_gradient(parameters)
        key = jax.random.key(1)
        moved, _, info = learner.outer(key, parameters, None, objective, updated)
        return {
            "loss": jnp.stack([loss, info.loss_after, info.kl]),
            "gradient": ravel_pytree(gradient)[0],
            "product": product(jnp.sin(jnp.arange(x.size))),
            "step": ravel_pytree(moved)[0] - x,
        }

    return {name: np.asarray(x) for name, x in numbers(flat).items()}


def of_trials(learner: RecurrentMetaLearner) -> dict[str, np.ndarray]:
    """Return the improved policy and value function, less those before."""
    problem = make_problem(2, UNEQUAL, latent=0)
    episodes = tuple(stack([problem.batches(phase)[row] for row in ROWS]) for phase in range(2))
    state = learner.init(jax.random.key(0), Problem(OBSERVATION, ACTION, len(ROWS)))
    after, info = learner.improved(jax.random.key(1), state, episodes)
    moved = jax.tree.map(
        jnp.subtract, (after.policy, after.value.network), (state.policy, state.value.network)
    )
    return {"step": np.asarray(ravel_pytree(moved)[0]), "loss": np.asarray(info.policy_step.loss)}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "method", [pytest.param(x, marks=[pytest.mark.long] if x in LONG else []) for x in METHODS]
)
def test_a_step_is_what_it_was(method: str) -> None:
    with np.load(RECORD) as recorded:
        for name, actual in computed(method).items():
            expected = recorded[f"{method}/{name}"]
            largest = np.abs(expected).max()
            assert largest > 0
            np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-7 * largest)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    found = {f"{m}/{name}": x for m in METHODS for name, x in computed(m).items()}
    np.savez_compressed(RECORD, **found)
    print({name: (x.shape, float(np.abs(x).max())) for name, x in found.items()})
