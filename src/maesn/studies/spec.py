"""What a study is: runs, evaluations of them, methods from scratch, and what is compared.

A file says it in TOML (`maesn.studies.reading`); `maesn compare` says it in Python.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

from maesn.envs import Variant
from maesn.evaluation.evaluation import USUAL, Evaluation
from maesn.runs.config import RunSettings
from maesn.settings import check_number, check_positive
from maesn.worlds import EngineName

FigureKind: TypeAlias = Literal[
    "curves", "dots", "profiles", "tasks", "exploration", "noise", "latents"
]
# Kinds of figures that need recorded paths.
RECORDED: tuple[FigureKind, ...] = ("tasks", "exploration", "noise", "latents")


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """`[runs.NAME]`: what is trained, on each family with each seed; none: on those of the study.

    All other keys are settings of the run or of the learner, as in `maesn train`. Those in
    `[runs.NAME.on.FAMILY]` hold on one family.
    """

    preset: str = ""
    """Method, or `module:name` of your own; empty: NAME."""
    label: str = ""
    """In figures and tables; empty: that of the method."""
    source: Literal["recommended", "reference"] = "recommended"
    """Defaults: what was found to work on the family, or the published settings."""
    seeds: tuple[int, ...] = ()
    families: tuple[str, ...] = ()
    init_from: str = ""
    """Directory of a run, or name of a policy that comes with the library, to start from."""
    directories: tuple[str, ...] = ()
    """Runs that exist, of one family; they take part as they are, and nothing is trained."""
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Path of a setting, or nested settings -> value."""
    on: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)
    """Family -> the same for it alone."""


@dataclasses.dataclass(frozen=True)
class EvaluationSpec:
    """`[evaluations.NAME]`: an evaluation, with what differs on single families."""

    usual: Evaluation = USUAL
    on: Mapping[str, Evaluation] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class ScratchSpec:
    """`[scratch.NAME]`: a method that begins anew in every task; `label` is as of a run."""

    method: str = ""
    """trpo, reinforce (alias vpg) or vime; empty: NAME."""
    label: str = ""
    seeds: tuple[int, ...] = ()
    """Of fresh policies and of the episodes. None: those of the study."""
    num_tasks: int | None = None
    """The first so many tasks alone; None: those of the evaluation."""
    max_kl: float | None = None
    """Of trpo and vime: bound on the mean KL divergence of an update. None: 0.01, as published."""
    step_size: float | None = None
    """Of reinforce. Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`. None: the usual."""
    curiosity_weight: float | None = None
    """Of vime: the bonus for a transition of typical information gain. None: 1e-4, as published."""

    def __post_init__(self) -> None:
        check_number("num_tasks", self.num_tasks, 1)
        check_positive(self, "max_kl", "step_size", "curiosity_weight")


@dataclasses.dataclass(frozen=True)
class LineSpec:
    """`[[lines]]`: a run or a method from scratch, one line for each of its evaluations.

    No evaluations, or no families: all.
    """

    run: str = ""
    scratch: str = ""
    evaluation: tuple[str, ...] = ()
    families: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if bool(self.run) == bool(self.scratch):
            raise ValueError("a line needs `run` or `scratch`, one of both.")


@dataclasses.dataclass(frozen=True)
class FigureSpec:
    """`[[figures]]`: some lines in a figure of their own, for some families, or for each."""

    name: str = "figure"
    """Of the file; that of the family is added."""
    kind: FigureKind = "curves"
    """curves, over episodes in the new task; dots, where each line ends, with its interval;
    profiles, in which share of the tasks it ends above each return. Of runs: tasks, the goals;
    exploration, paths before any adaptation; noise, the same with z held; latents, before and after
    adaptation."""
    lines: tuple[str, ...] = ()
    """Names of runs and methods, or of one evaluation of these: `maesn-search`. None: all."""
    families: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class StudySpec:
    """All that a study's file says."""

    name: str
    """Of its directory."""
    families: tuple[str, ...]
    """Names, or `module:name` of your own."""
    file: str = "study"
    """What messages call it."""
    seeds: tuple[int, ...] = (0,)
    """Of everything that is trained or begins anew; see `evaluation_seed`."""
    variant: Variant = "reference"
    engine: EngineName = "native"
    evaluation_seed: int = 0
    """Of the episodes in which runs adapt."""
    threads: int = 1
    """Of each job. Numbers depend on it in their last digits."""
    oracle: str = ""
    """Name of the run that is given the task, the upper end of the score."""
    runs: Mapping[str, RunSpec] = dataclasses.field(default_factory=dict)
    evaluations: Mapping[str, EvaluationSpec] = dataclasses.field(
        default_factory=lambda: {"usual": EvaluationSpec()}
    )
    scratch: Mapping[str, ScratchSpec] = dataclasses.field(default_factory=dict)
    lines: tuple[LineSpec, ...] = ()
    """None: each run and each method from scratch, with all evaluations."""
    figures: tuple[FigureSpec, ...] = ()
    """None: the curves of all lines."""

    def __post_init__(self) -> None:
        check_number("threads", self.threads, 1)
        check_number("evaluation_seed", self.evaluation_seed, 0, 2**32 - 1)

    def names_of(self, line: LineSpec) -> dict[str, str]:
        """Return the name of a line with each of its evaluations: that of its source if alone."""
        source, asked = line.run or line.scratch, line.evaluation or tuple(self.evaluations)
        rivals = sum(source == (one.run or one.scratch) for one in self.all_lines)
        is_alone = len(asked) == rivals == 1
        return {one: source if is_alone else f"{source}-{one}" for one in asked}

    def world(self, family: str) -> RunSettings:
        """Return what all runs have in common on a family."""
        return RunSettings(
            family=family, variant=self.variant, engine=self.engine, num_threads=self.threads
        )

    @property
    def all_lines(self) -> tuple[LineSpec, ...]:
        """The lines as given, or all that there can be."""
        return self.lines or (
            *(LineSpec(run=name) for name in self.runs if name != self.oracle),
            *(LineSpec(scratch=name) for name in self.scratch),
        )
