"""The lines of a comparison: trained runs, methods from scratch, and baselines."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Annotated, Any

import tyro

from maesn.envs import AnyEnv
from maesn.evaluation.evaluation import Evaluation, written_out
from maesn.evaluation.tables import adaptation_file, identity_of_run
from maesn.learners import (
    SCRATCH,
    AbstractFastLearner,
    GradientStep,
    baselines,
    reinforce,
    trpo,
    vime,
)
from maesn.learners.scratch.policy_gradient import TRPO
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.policies import USUAL
from maesn.report.style import DARK_GREY, METHOD_STYLES, MethodStyle
from maesn.rules import Trained
from maesn.runs.run import Run
from maesn.storage import RunError, refusals
from maesn.studies.curves import SeededLearner
from maesn.studies.world import ComparisonWorld


@dataclasses.dataclass(frozen=True, eq=False)
class LineSpec:
    """One line of a comparison, before it is adapted."""

    name: str
    style: MethodStyle
    learners: tuple[SeededLearner, ...]
    """One per seed."""
    trial_episodes: int | None = None
    """Number of episodes that meta-training has prepared for; None if there is no such limit."""
    training_steps: int | None = None
    """Environment steps that meta-training took, the most of any seed; None without any."""


@dataclasses.dataclass(frozen=True)
class Scratch:
    """Methods that begin anew in every task."""

    methods: Annotated[tuple[str, ...], tyro.conf.arg(name="scratch")] = ()
    """Methods that begin anew in every task: trpo, reinforce (alias vpg), vime. NAME:COUNT adapts
    to the first COUNT tasks alone, as in vime:30."""
    seeds: Annotated[tuple[int, ...], tyro.conf.arg(name="scratch-seeds")] = (0,)
    """Each method from scratch begins anew in every task with each of these seeds."""
    step_size: float = GradientStep().step_size
    """Of reinforce from scratch. Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`."""
    max_kl: float = TRPO.trust_region.max_kl
    """Of trpo and vime from scratch: bound on the mean KL divergence of an update. Published:
    0.01."""
    curiosity_weight: float = CuriosityBonus().weight
    """Of vime from scratch: the bonus for a transition of typical information gain. Published:
    1e-4."""

    def __post_init__(self) -> None:
        for name in ("step_size", "max_kl"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(
                    f"`{name}` must be positive and finite, got {getattr(self, name)}."
                )
        distinct = self.seeds and len(set(self.seeds)) == len(self.seeds)
        if not (distinct and all(0 <= seed < 2**32 for seed in self.seeds)):
            raise ValueError(
                "`seeds` (--scratch-seeds) must be different numbers between 0 and 2^32 - 1, at "
                f"least one, got {self.seeds}."
            )
        if not 0 <= self.curiosity_weight < math.inf:
            raise ValueError(
                f"`curiosity_weight` must be finite and at least 0, got {self.curiosity_weight}."
            )

    def learner(self, name: str, env: AnyEnv) -> AbstractFastLearner[Any]:
        """Return one of the methods, by its key in `SCRATCH`, for an environment."""
        make = SCRATCH[name]
        region = {"max_kl": self.max_kl}
        settings: dict[Any, dict[str, Any]] = {
            reinforce: {"step_size": self.step_size},
            trpo: region,
            vime: {**region, "curiosity": CuriosityBonus(self.curiosity_weight)},
        }
        policy = USUAL[env.action_kind]
        with refusals(f"`{name}` cannot learn in `{env.name}`: "):
            return make(env.observation_size, env.action_size, policy=policy, **settings[make])


def line_of_runs(
    name: str,
    style: MethodStyle,
    runs: Sequence[Run],
    world: ComparisonWorld,
    evaluation: Evaluation,
) -> LineSpec:
    """Return trained runs that differ in their seed alone, adapted by the rule of `evaluation`.

    Of each run the latest checkpoint takes part, never the best one.

    Raises:
        RunError: rule and method do not fit.
    """
    learners, trial_episodes, training_steps = [], None, 0
    name += evaluation.suffix
    of_all_tasks = dataclasses.replace(evaluation, num_tasks=None)
    for run in runs:
        trained = run.latest()
        training_steps = max(training_steps, trained.environment_steps)
        learner = evaluation.fast_learner(
            Trained(run.learner, trained.state), run.settings.method, world.env
        )
        trial_episodes = learner.capabilities.trial_episodes
        record = world.record(identity_of_run(run), evaluation)
        earlier = adaptation_file(run.directory, of_all_tasks)
        learners.append(SeededLearner(name, run.settings.seed, learner, record, earlier))
    style = _changed(style, evaluation)
    return LineSpec(name, style, tuple(learners), trial_episodes, training_steps)


def line_of_scratch(
    name: str, num_tasks: int | None, scratch: Scratch, world: ComparisonWorld
) -> LineSpec:
    """Return a method that begins anew in every task, with several seeds.

    Args:
        name: one of `SCRATCH`.
        num_tasks: the first so many tasks alone; None for all of the comparison.
        scratch: its settings; each seed is that of fresh policies and of the episodes.
        world: of the comparison.
    """
    learner, asked = scratch.learner(name, world.env), world.evaluation
    counts = [count for count in (num_tasks, asked.num_tasks) if count is not None]
    asked = dataclasses.replace(asked, num_tasks=min(counts, default=None))
    learners = [_untrained(name, learner, seed, world, asked) for seed in scratch.seeds]
    return LineSpec(name, METHOD_STYLES[name], tuple(learners))


def scratch_lines(scratch: Scratch, world: ComparisonWorld) -> list[LineSpec]:
    """Return the methods that begin anew in every task.

    Raises:
        RunError: there is no such method, or it is named twice.
    """
    chosen = [_method_and_count(text) for text in scratch.methods]
    names = [name for name, _ in chosen]
    for name in names:
        if names.count(name) > 1:
            raise RunError(
                f"`scratch` must name each method once, got {' '.join(scratch.methods)}: `{name}` "
                "is meant twice (`vpg` is `reinforce`)."
            )
    return [line_of_scratch(*one, scratch, world) for one in chosen]


def _method_and_count(text: str) -> tuple[str, int | None]:
    """Read NAME or NAME:COUNT."""
    name, colon, count = text.partition(":")
    if name not in SCRATCH:
        raise RunError(
            f"there is no method `{name}` that begins from scratch: known are {', '.join(SCRATCH)}."
        )
    if colon and not (count.isdecimal() and int(count)):
        raise RunError(
            f"the number of tasks in `{text}` must be a positive integer, as in `{name}:30`."
        )
    return SCRATCH[name].__name__, int(count) if colon else None


def baseline_lines(world: ComparisonWorld) -> list[LineSpec]:
    """Return the agents that learn nothing, of which the better one is the baseline."""
    env, asked = world.env, dataclasses.replace(world.evaluation, episodes=0)
    lines = []
    for label, learner in baselines(env.observation_size, env.action_size, env.action_kind).items():
        name = label.replace(" ", "_")
        one = _untrained(name, learner, asked.seed, world, asked)
        lines.append(LineSpec(name, MethodStyle(label, DARK_GREY, ":", "."), (one,)))
    return lines


def _untrained(
    name: str,
    learner: AbstractFastLearner[Any],
    seed: int,
    world: ComparisonWorld,
    evaluation: Evaluation,
) -> SeededLearner:
    """Return a learner that has not been trained before."""
    written = " ".join(f"{name} {written_out(learner)}".split())
    who = {"learner": written, "weights": ""}
    record = world.record(who, dataclasses.replace(evaluation, seed=seed))
    return SeededLearner(name, seed, learner, record)


def _changed(style: MethodStyle, evaluation: Evaluation) -> MethodStyle:
    """Return the style of a line whose label says what is changed; dashed if something is added."""
    if not evaluation.label:
        return style
    # Into parentheses that are there already, as in "MAML (bias only)".
    opened = f"{style.label[:-1]}; " if style.label.endswith(")") else f"{style.label} ("
    named = dataclasses.replace(style, label=f"{opened}{evaluation.label})")
    if not evaluation.wrappers:
        return named
    return dataclasses.replace(named, line=(0, (2.0, 1.0)), marker="d")
