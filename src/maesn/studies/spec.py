"""What a study is: runs, evaluations of them, methods from scratch, and what is compared.

A file says it in TOML (`maesn.studies.reading`); `maesn compare` says it in Python.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, TypeAlias, cast

from maesn.envs import TaskFamily, Variant, split_variant
from maesn.envs.sources import resolve_family
from maesn.evaluation.evaluation import USUAL, Evaluation
from maesn.runs.config import RunSettings
from maesn.settings import check_choice, check_number, check_positive, suggestion
from maesn.storage import RunError

FigureKind: TypeAlias = Literal[
    "curves", "dots", "profiles", "tasks", "exploration", "noise", "latents"
]
# Kinds of figures that need recorded paths.
RECORDED: tuple[FigureKind, ...] = ("tasks", "exploration", "noise", "latents")


class Place(NamedTuple):
    """A place in a study's file."""

    file: str
    key: str = ""

    def __truediv__(self, key: object) -> "Place":
        return Place(self.file, f"{self.key}.{key}".lstrip("."))

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """Name the place in what the block refuses."""
        try:
            yield
        except (RunError, ValueError) as error:
            at = f", `{self.key}`" if self.key else ""
            raise RunError(f"`{self.file}`{at}: {error}") from error

    def check(self, names: str | Iterable[str], known: Iterable[str], what: str = "name") -> None:
        """Refuse names, or one, that are not known; an empty one stands for none."""
        for name in [names] if isinstance(names, str) else names:
            if name and name not in known:
                hint = suggestion(name, known) or f" Known are: {', '.join(known)}."
                with self.refusing():
                    raise ValueError(f"there is no {what} `{name}`.{hint}")


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """`[runs.NAME]`: a method that is trained on each family with each seed.

    All other keys are settings of the run or of the learner, as in `maesn train`. Those in
    `[runs.NAME.on.FAMILY]` hold on one family.
    """

    preset: str = ""
    """Method, or `module:name` of your own, which `directories` of its runs need; empty: NAME."""
    label: str = ""
    """Name in figures and tables; empty: that of the method."""
    seeds: tuple[int, ...] = ()
    """Seeds of training; none: those of the study."""
    families: tuple[str, ...] = ()
    """Families to train on; none: those of the study."""
    init_from: str = ""
    """Directory of a run, or name of a policy that comes with the library, to start from."""
    directories: tuple[str, ...] = ()
    """Runs that exist, of one family; they take part as they are, and nothing is trained."""
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Settings by their path, or nested."""
    on: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)
    """Family -> settings that hold there alone."""


@dataclasses.dataclass(frozen=True)
class EvaluationSpec:
    """`[evaluations.NAME]`: an evaluation, with what differs on single families."""

    usual: Evaluation = USUAL
    on: Mapping[str, Evaluation] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class ScratchSpec:
    """`[scratch.NAME]`: a method that begins anew in every task."""

    method: str = ""
    """trpo, reinforce (alias vpg) or vime; empty: NAME."""
    label: str = ""
    """Name in figures and tables; empty: that of the method."""
    seeds: tuple[int, ...] = ()
    """Seeds of fresh policies and of the episodes; none: those of the study."""
    num_tasks: int | None = None
    """Number of tasks, the first ones; None: all of the evaluation."""
    max_kl: float | None = None
    """Bound on the mean KL divergence of an update of trpo or vime. None: 0.01, as published."""
    step_size: float | None = None
    """Step size of reinforce. Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`. None: the
    usual."""
    curiosity_weight: float | None = None
    """Bonus of vime for a transition of typical information gain. None: 1e-4, as published."""

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
    """`[[figures]]`: a figure of some lines, for each family."""

    name: str = "figure"
    """Beginning of the file's name; that of the family is added."""
    kind: FigureKind = "curves"
    """curves: returns over episodes in the new task. dots: where each line ends, with its interval.
    profiles: the share of tasks in which a line ends above each return. Of runs: tasks, the goals;
    exploration, paths before any adaptation; noise, the same with z held; latents, before and after
    adaptation."""
    lines: tuple[str, ...] = ()
    """Names of runs and methods, or of one evaluation of these: `maesn-search`. None: all."""
    families: tuple[str, ...] = ()
    """Families that have the figure; none: all."""


@dataclasses.dataclass(frozen=True)
class StudySpec:
    """All that a study's file says."""

    name: str
    """Name of the study's directory."""
    families: tuple[str, ...]
    """Names, or `module:name` of your own. `sparse_point:varibad` is one variant of a family."""
    file: str = "study"
    """Name of the study in messages."""
    seeds: tuple[int, ...] = (0,)
    """Seeds of everything that is trained or begins anew; see `evaluation_seed`."""
    variant: Variant = "reference"
    evaluation_seed: int = 0
    """Seed of the episodes in which runs adapt."""
    threads: int = 1
    """Threads of each job. The last digits of numbers depend on it."""
    oracle: str = ""
    """Name of the run that is given the task, the upper end of the score."""
    runs: Mapping[str, RunSpec] = dataclasses.field(default_factory=dict)
    evaluations: Mapping[str, EvaluationSpec] = dataclasses.field(
        default_factory=lambda: {"usual": EvaluationSpec()}
    )
    scratch: Mapping[str, ScratchSpec] = dataclasses.field(default_factory=dict)
    lines: tuple[LineSpec, ...] = ()
    """Lines to compare; none: each run and method from scratch, with all evaluations."""
    figures: tuple[FigureSpec, ...] = ()
    """Figures to draw; none: the curves of all lines."""

    def __post_init__(self) -> None:
        check_number("threads", self.threads, 1)
        check_number("evaluation_seed", self.evaluation_seed, 0, 2**32 - 1)
        if not self.seeds:
            raise ValueError("a study needs seeds, as in `seeds = [0, 1, 2]`.")
        if not self.families:
            raise ValueError('a study needs families, as in `family = "wheeled"`.')
        if not self.all_lines:
            raise ValueError("nothing is compared: add `[runs.NAME]` or `[scratch.NAME]`.")

    def names_of(self, line: LineSpec) -> dict[str, str]:
        """Return the name of a line with each of its evaluations: that of its source if alone."""
        source, asked = line.run or line.scratch, line.evaluation or tuple(self.evaluations)
        rivals = sum(source == (one.run or one.scratch) for one in self.all_lines)
        is_alone = len(asked) == rivals == 1
        return {one: source if is_alone else f"{source}-{one}" for one in asked}

    def world(self, family: str) -> RunSettings:
        """Return what all runs have in common on a family."""
        name, own = split_variant(family)
        check_choice("variant", variant := own or self.variant, Variant)
        return RunSettings(
            family=name,
            variant=cast(Variant, variant),
            num_threads=self.threads,
        )

    def family(self, name: str) -> TaskFamily:
        """Return one of the families; `RunError` if there is none of that name."""
        return resolve_family(self.world(name).family)

    @property
    def all_lines(self) -> tuple[LineSpec, ...]:
        """The lines as given, or all that there can be."""
        return self.lines or (
            *(LineSpec(run=name) for name in self.runs if name != self.oracle),
            *(LineSpec(scratch=name) for name in self.scratch),
        )


def is_for(family: str, part: RunSpec | LineSpec | FigureSpec) -> bool:
    """Whether a part of a study is for a family: for this one among others, or for all."""
    return family in (part.families or [family])
