"""The reference's parameters as the library's, and back; learners that match its settings."""

from dataclasses import asdict

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from reference.parameters import LATENT_NAMES, Parameters
from reference.policy import num_layers
from reference.trust_region import TrustRegionSettings

from learning_problems.prepared import LATENT, ROWS, SIZES, Problem, stack
from maesn import GradientMetaLearner
from maesn.context import Latent, LatentContext, NoContext, Nothing
from maesn.experience.episodes import Episodes
from maesn.inner.adaptation import Adaptation, InnerStep, StepSizes
from maesn.inner.advantage import AdvantageEstimator, Advantages
from maesn.learners.gradient.objective import Experience, MetaObjective, MetaParameters
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.networks.mlp import MLP, Linear
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import GaussianMLP, GaussianMLPPolicy

META_BATCH = 3


def learner_for(problem: Problem, **settings: object) -> GradientMetaLearner:
    """Return the library's learner with the problem's settings."""
    theta_step = problem.settings.theta_step
    theta = InnerStep(theta_step, learned=False) if theta_step else None
    has_latent = problem.parameters["latent_mean"].size > 0
    latent = LatentContext(LATENT, problem.settings.kl_weight, gradient=problem.settings.gradient)
    return GradientMetaLearner(
        **{
            "context": latent if has_latent else NoContext(),
            "adaptation": Adaptation(theta, InnerStep() if has_latent else None),
            "policy": GaussianMLP(SIZES[1:-1]),
            "advantage": AdvantageEstimator(**asdict(problem.advantage)),
            "meta_batch_size": META_BATCH,
            "inner_updates": len(problem.tasks[0].pre),
            "outer": TrustRegionOuterStep(TrustRegion(**asdict(TrustRegionSettings())), 1),
            **settings,
        }
    )


def to_policy(parameters: Parameters) -> GaussianMLPPolicy:
    """Return theta in the library's form, in the precision that is switched on."""
    layers = [
        Linear(
            jnp.asarray(parameters[f"weight_{layer}"], dtype=float),
            jnp.asarray(parameters[f"bias_{layer}"], dtype=float),
        )
        for layer in range(num_layers(parameters))
    ]
    return GaussianMLPPolicy(MLP(tuple(layers)), jnp.asarray(parameters["log_std"], dtype=float))


def to_library(parameters: Parameters) -> MetaParameters:
    """Return all parameters in the library's form; without latents, those of MAML."""
    policy = to_policy(parameters)
    if parameters["latent_mean"].size == 0:
        return MetaParameters(policy, Nothing(), StepSizes(None, None))
    mean, log_std, mean_step, log_std_step = (
        jnp.asarray(parameters[name], dtype=float) for name in LATENT_NAMES
    )
    sizes = StepSizes(None, Latent(mean_step, log_std_step))
    return MetaParameters(policy, Latent(mean, log_std), sizes)


def policy_to_reference(policy: GaussianMLPPolicy) -> Parameters:
    """Return theta in the reference's form."""
    theta = {}
    for layer, linear in enumerate(policy.mlp.layers):
        theta[f"weight_{layer}"] = np.asarray(linear.weight, dtype=np.float64)
        theta[f"bias_{layer}"] = np.asarray(linear.bias, dtype=np.float64)
    theta["log_std"] = np.asarray(policy.log_std, dtype=np.float64)
    return theta


def to_reference(parameters: MetaParameters) -> Parameters:
    """Undo `to_library`; gradients and steps have the same structure and translate alike."""
    result = policy_to_reference(parameters.policy)
    if isinstance(parameters.context_table, Latent):
        sizes = parameters.step_sizes.context
        latents = (
            parameters.context_table.mean,
            parameters.context_table.log_std,
            sizes.mean,
            sizes.log_std,
        )
    else:
        latents = np.zeros((ROWS, 0)), np.zeros((ROWS, 0)), np.zeros(0), np.zeros(0)
    for name, array in zip(LATENT_NAMES, latents, strict=True):
        result[name] = np.asarray(array, dtype=np.float64)
    return result


# Compiled once for all learners, unlike the learner's own method.
@eqx.filter_jit
def advantages_of(estimator: AdvantageEstimator, episodes: Episodes) -> Advantages:
    """Return the library's advantages, `[task, ...]`."""
    return estimator.of_tasks(episodes)


def experience_for(
    learner: GradientMetaLearner, problem: Problem, rows: tuple[int, ...], garbage: float = 0.0
) -> tuple[Experience, ...]:
    """Return what was played in some rows, collection by collection, in the library's form."""
    played = []
    for phase in range(learner.inner_updates + 1):
        batch = problem.batches(phase)
        episodes = stack([batch[row] for row in rows], garbage)
        played.append((episodes, advantages_of(learner.advantage, episodes)))
    return tuple(played)


def objective_for(
    learner: GradientMetaLearner, problem: Problem, rows: tuple[int, ...]
) -> MetaObjective:
    """Return the library's outer problem on the experience of some rows."""
    *pre, post = experience_for(learner, problem, rows)
    adaptation = learner.adaptation.at(0)
    return MetaObjective(learner.context, adaptation, jnp.asarray(rows), tuple(pre), *post)
