"""What an outer step gains on episodes that it has not seen, for several ways to find it.

    python benchmarks/curvature.py --iterations 60
    python benchmarks/curvature.py --method maml
    python benchmarks/curvature.py --run runs/maml

A learner is trained for a while, or taken from a run as it stands. Then, again and again, an outer
step is computed from one batch of episodes and judged on a second, independent batch of the same
agents: by how much does it lower the surrogate loss there? All steps are scaled to the same bound
of the KL divergence, so a better direction gains more; what it gains on its own batch beyond that
is chance that it took for a rule. The table has one row per number of conjugate gradient steps, per
damping, per stride of the curvature's samples, and per stride of those of the inner loss's Hessian
(which `maesn` has none of). Backtracks tell how far the curvature errs: with the right one there
are few. Seconds are the least that step and judgement took, so without compilation; the others are
means.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
import tyro
from jaxtyping import Array, Float

from maesn import GradientMetaLearner
from maesn.axes import Key
from maesn.envs import find_family
from maesn.experience.episodes import Thinning
from maesn.learners import PRESETS, Problem
from maesn.learners.gradient.curvature import sampled_distributions, step_weights
from maesn.learners.gradient.meta_learner import GradientState
from maesn.learners.gradient.objective import MetaObjective, MetaParameters, start_agents
from maesn.numerics.trust_region import TrustRegion, TrustRegionInfo
from maesn.runs.run import Run
from maesn.worlds import AbstractWorld, make_world
from maesn.worlds.collector import Collector

HEADING = (
    "cg steps  damping  stride  Hessian's  gain (x 1000, +- standard error)  on its own batch  "
    "KL (x 1000)  backtracks  seconds"
)


class Choice(NamedTuple):
    """A way to find a step."""

    cg_steps: int
    stride: int
    hessian_stride: int
    damping: float = TrustRegion().damping


IN_CLOSED_FORM = [Choice(*c, 1) for c in ((10, 1), (10, 10), (20, 5), (20, 10), (20, 20), (40, 10))]
THROUGH_POLICY = [
    Choice(*c)
    for c in (
        (20, 20, 20), (10, 20, 20), (20, 20, 4), (10, 20, 4), (5, 20, 4),
        (10, 20, 2), (5, 20, 2), (10, 20, 1), (5, 20, 1), (10, 4, 4), (20, 1, 1),
        (20, 20, 4, 1e-2), (10, 20, 4, 1e-2), (10, 20, 4, 1.0), (10, 20, 20, 1.0),
    )
]  # fmt: skip


class Outcome(NamedTuple):
    """Of one step."""

    gain: float
    """By how much it lowers the surrogate on unseen episodes."""
    own_gain: float
    """By how much it lowers the surrogate on the episodes that it was computed from."""
    kl: float
    backtracks: int
    seconds: float


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    method: Literal["maesn", "maml", "maml_bias", "maml_bias_only"] = "maesn"
    """Preset of a method with an inner update."""
    family: str = "wheeled"
    """Family of tasks."""
    run: Path | None = None
    """Directory of a run of such a method, whose latest checkpoint is judged, in the run's own
    world. None: train `method` on `family`."""
    iterations: int = 60
    """Meta-iterations of that training."""
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
    outer: int,
    inner: int,
) -> tuple[Float[Array, ""], Float[Array, ""], TrustRegionInfo]:
    """Return how much a step lowers the loss on unseen and on seen episodes, and its record."""
    updated = seen.updated(parameters)
    strides = Thinning(outer, 0), Thinning(inner, 0)
    improved, info = trust_region.step(
        parameters,
        seen.evaluate,
        seen.loss_and_gradient,
        lambda varied: sampled_distributions(seen, varied, updated, *strides),
        step_weights(seen.post.every(outer, 0)),
    )

    def gained(objective: MetaObjective) -> Float[Array, ""]:
        before, after = (
            objective.evaluate(p).loss - objective.penalties(p).mean()
            for p in (parameters, improved)
        )
        return before - after

    return gained(unseen), gained(seen), info


def outcome(
    choice: Choice, parameters: MetaParameters, seen: MetaObjective, unseen: MetaObjective
) -> Outcome:
    """Find a step in one way, and judge it."""
    begun = time.perf_counter()
    *gains, info = gain(
        TrustRegion(cg_steps=choice.cg_steps, damping=choice.damping),
        parameters,
        seen,
        unseen,
        choice.stride,
        choice.hessian_stride,
    )
    found, own = map(float, gains)
    seconds = time.perf_counter() - begun
    return Outcome(found, own, float(info.kl), int(info.backtracks), seconds)


def objective(
    learner: GradientMetaLearner, parameters: MetaParameters, collect: Collector, key: Key
) -> MetaObjective:
    """Play one meta-iteration of the first tasks, and return its objective."""
    index = jax.numpy.arange(learner.meta_batch_size)
    pre_keys, post_keys = jax.random.split(key, (2, learner.meta_batch_size))
    agents = start_agents(learner.context, parameters, index)
    pre = collect(pre_keys, agents, index)
    advantages_of = eqx.filter_jit(learner.advantage.of_tasks)
    advantages = advantages_of(pre)
    adapted = eqx.filter_jit(learner.adaptation)(
        agents, parameters.step_sizes, learner.context, pre, advantages
    )
    post = collect(post_keys, adapted, index)
    return MetaObjective(
        learner.context,
        learner.adaptation,
        index,
        ((pre, advantages),),
        post,
        advantages_of(post),
    )


def subject(settings: Settings) -> tuple[GradientMetaLearner, GradientState, AbstractWorld]:
    """Return the learner whose steps are judged, its state, and the world that it learns in."""
    if settings.run is not None:
        run = Run.open(settings.run)
        assert isinstance(run.learner, GradientMetaLearner)
        return run.learner, run.latest_state(), run.world()
    learner, family = PRESETS[settings.method](), find_family(settings.family)
    assert isinstance(learner, GradientMetaLearner)
    world = make_world(family.make_env(), family.task_set("training"))
    return learner, trained(learner, world, settings), world


def trained(
    learner: GradientMetaLearner, world: AbstractWorld, settings: Settings
) -> GradientState:
    """Train a while, and return the state."""
    env, collect = world.env, Collector(world, settings.episodes_per_task)
    state = learner.init(
        jax.random.key(0), Problem(env.observation_size, env.action_size, collect.num_tasks)
    )
    for iteration in range(settings.iterations):
        state, _ = learner.step(jax.random.fold_in(jax.random.key(1), iteration), state, collect)
    return state


def main(settings: Settings) -> None:
    """Train or load, measure, print."""
    learner, state, world = subject(settings)
    collect = Collector(world, settings.episodes_per_task)
    judge = Collector(world, settings.judged_episodes)
    has_hessian = learner.adaptation.policy is not None or learner.context.is_pathwise
    choices = THROUGH_POLICY if has_hessian else IN_CLOSED_FORM
    outcomes: dict[Choice, list[Outcome]] = {choice: [] for choice in choices}
    for repetition in range(settings.repetitions):
        first, second = jax.random.split(jax.random.fold_in(jax.random.key(2), repetition))
        seen = objective(learner, state.parameters, collect, first)
        unseen = objective(learner, state.parameters, judge, second)
        for choice in choices:
            outcomes[choice].append(outcome(choice, state.parameters, seen, unseen))
    world.close()
    of = settings.method if settings.run is None else settings.run
    print(f"{of} on {world.env.name}, after {int(state.iteration)} meta-iterations")
    print(HEADING)
    for choice, found in outcomes.items():
        print(row(choice, found))


def row(choice: Choice, found: list[Outcome]) -> str:
    """Return one line of the table."""
    gains = 1000 * np.array([one.gain for one in found])
    error = gains.std(ddof=1) / len(gains) ** 0.5
    return (
        f"{choice.cg_steps:8d}  {choice.damping:7.0e}  {choice.stride:6d}  "
        f"{choice.hessian_stride:9d}  {f'{gains.mean():.2f} +- {error:.2f}':>32s}  "
        f"{1000 * np.mean([one.own_gain for one in found]):16.2f}  "
        f"{1000 * np.mean([one.kl for one in found]):11.1f}  "
        f"{np.mean([one.backtracks for one in found]):10.1f}  "
        f"{min(one.seconds for one in found):7.2f}"
    )


if __name__ == "__main__":
    main(tyro.cli(Settings))
