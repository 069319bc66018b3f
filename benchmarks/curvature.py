"""What an outer step gains on episodes that it has not seen, for several ways to find it.

    python benchmarks/curvature.py --iterations 60

A learner is trained for a while. Then, again and again, an outer step is computed from one batch of
episodes and judged on a second, independent batch of the same agents: by how much does it lower
the surrogate loss there? All steps are scaled to the same bound of the KL divergence, so a better
direction gains more. The table has one row per number of conjugate gradient steps and per stride
of the curvature's samples.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import numpy as np
import tyro
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.envs import find_family
from maesn.episodes import Episodes
from maesn.learners import PRESETS, GradientMetaLearner
from maesn.learners.gradient import step_weights
from maesn.learners.objective import MetaObjective, MetaParameters, start_agents
from maesn.rollout import Collector
from maesn.trust_region import TrustRegion
from maesn.worlds import make_world

CHOICES = ((10, 1), (10, 10), (20, 5), (20, 10), (20, 20), (40, 10))  # (cg_steps, stride)


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    family: str = "wheeled"
    """Family of tasks."""
    iterations: int = 60
    """Meta-iterations before the steps are judged."""
    repetitions: int = 6
    """Batches that every choice computes a step from."""
    episodes_per_task: int = 20
    """Episodes per task in the batch that a step is computed from."""
    judged_episodes: int = 60
    """Episodes per task in the batch that it is judged on."""


@eqx.filter_jit
def gain(
    trust_region: TrustRegion,
    parameters: MetaParameters,
    seen: MetaObjective,
    unseen: MetaObjective,
    thinned: Episodes,
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return how much a step lowers the surrogate on unseen episodes, and its KL on seen ones."""
    improved, info = trust_region.step(
        parameters,
        seen.evaluate,
        lambda varied: seen.distributions(varied, thinned),
        step_weights(thinned),
    )
    before, after = (
        unseen.evaluate(p).loss - unseen.penalties(p).mean() for p in (parameters, improved)
    )
    return before - after, info.kl


def objective(
    learner: GradientMetaLearner, parameters: MetaParameters, collect: Collector, key: Key
) -> MetaObjective:
    """Play one meta-iteration of the first tasks, and return its objective."""
    index = jax.numpy.arange(learner.meta_batch_size)
    pre_keys, post_keys = jax.random.split(key, (2, learner.meta_batch_size))
    agents = start_agents(learner.context, parameters, index)
    pre = collect(pre_keys, agents, index)
    advantages = jax.vmap(learner.advantage)(pre)
    adapted = learner.adaptation(agents, parameters.step_sizes, learner.context, pre, advantages)
    post = collect(post_keys, adapted, index)
    return MetaObjective(
        learner.context,
        learner.adaptation,
        index,
        ((pre, advantages),),
        post,
        jax.vmap(learner.advantage)(post),
    )


def main(settings: Settings) -> None:
    """Train, measure, print."""
    family = find_family(settings.family)
    env, learner = family.make_env(), PRESETS["maesn"]()
    world = make_world(env, family.task_set("training"))
    collect = Collector(world, settings.episodes_per_task)
    judge = Collector(world, settings.judged_episodes)
    state = learner.init(
        jax.random.key(0), env.observation_size, env.action_size, collect.num_tasks
    )
    for iteration in range(settings.iterations):
        state, _ = learner.step(jax.random.fold_in(jax.random.key(1), iteration), state, collect)
    gains: dict[tuple[int, int], list[float]] = {choice: [] for choice in CHOICES}
    divergences: dict[tuple[int, int], list[float]] = {choice: [] for choice in CHOICES}
    for repetition in range(settings.repetitions):
        first, second = jax.random.split(jax.random.fold_in(jax.random.key(2), repetition))
        seen = objective(learner, state.parameters, collect, first)
        unseen = objective(learner, state.parameters, judge, second)
        for steps, stride in CHOICES:
            thinned = seen.post.every(stride, 0)
            gained, kl = gain(TrustRegion(cg_steps=steps), state.parameters, seen, unseen, thinned)
            gains[steps, stride].append(float(gained))
            divergences[steps, stride].append(float(kl))
    print(f"{settings.family}, after {settings.iterations} meta-iterations")
    print("cg steps  stride  gain on unseen episodes (x 1000, +- standard error)  KL (x 1000)")
    for choice, values in gains.items():
        error = np.std(values, ddof=1) / len(values) ** 0.5
        print(
            f"{choice[0]:8d}  {choice[1]:6d}  {1000 * np.mean(values):20.2f} +- "
            f"{1000 * error:.2f} {1000 * np.mean(divergences[choice]):29.1f}"
        )


if __name__ == "__main__":
    main(tyro.cli(Settings))
