"""Comparisons of runs that exist: a study in memory."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from maesn.evaluation.evaluation import USUAL, Evaluation
from maesn.learners import SCRATCH
from maesn.reporting.runs import read_run
from maesn.reporting.series import Series, group_series
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.storage import RunError
from maesn.studies.execution import Say
from maesn.studies.executors import AbstractExecutor, ExecutorName
from maesn.studies.jobs import TrainedRun
from maesn.studies.members import member_of_run
from maesn.studies.spec import EvaluationSpec, LineSpec, RunSpec, ScratchSpec, StudySpec
from maesn.studies.study import Results, Study, silent

NAME = "comparison"


def compare(
    runs: Sequence[str | Path | Run] = (),
    *,
    out: str | Path,
    evaluation: Evaluation = USUAL,
    scratch: Sequence[str] = (),
    oracle: str | Path | None = None,
    family: str | None = None,
    executor: ExecutorName | AbstractExecutor = "local",
    workers: int | None = None,
    say: Say = silent,
) -> Results:
    """Adapt methods to the same tasks; write curves, a figure and tables.

    Args:
        runs: trained runs, their directories, or names of policies that come with the library, each
            with its latest checkpoint. Those that differ in their seed alone become one line. If
            `evaluation` has a rule or wrappers, those that can be given them take part a second
            time, with them.
        out: directory for all that is written. What was computed there before is not repeated.
        evaluation: of all lines; its seed is also that of methods from scratch.
        scratch: methods that begin anew in every task: NAME, or NAME:COUNT for the first COUNT
            tasks alone.
        oracle: run of the preset `oracle`; without it there is no score.
        family: of the tasks; None for that of the runs. Your own is `module:name`.
        executor: where it is computed; see `Study.run`.
        workers: the same.
        say: receives messages of progress.

    Raises:
        RunError: a setting, a run or a directory cannot be used.
    """
    opened = [one if isinstance(one, Run) else Run.open(one, family) for one in runs]
    by_path = {run.directory: run for run in opened}
    members = {
        series.name: (series, [by_path[one.path] for one in series.runs])
        for series in group_series([read_run(path) for path in by_path])
    }
    own = Common(family, opened)
    evaluations = {"usual": EvaluationSpec(evaluation.changed(rule=None, wrappers=()))}
    lines = [LineSpec(run=name, evaluation=("usual",)) for name in members]
    if evaluation.rule is not None or evaluation.wrappers:
        evaluations["more"] = EvaluationSpec(evaluation)
        able = [name for name, (_, seeds) in members.items() if _can(name, seeds, evaluation, say)]
        lines += [LineSpec(run=name, evaluation=("more",)) for name in able]
    from_scratch = dict(map(_scratch, scratch))
    if len(from_scratch) < len(scratch):
        raise RunError(
            f"`scratch` must name each method once, got {' '.join(scratch)} (`vpg` is `reinforce`)."
        )
    lines += [LineSpec(scratch=name, evaluation=("usual",)) for name in from_scratch]
    if not lines:
        raise RunError("name at least one run directory, or a method with --scratch.")
    specs = {name: _spec(*member) for name, member in members.items()}
    if oracle is not None:
        specs["oracle"] = RunSpec(directories=(str(_oracle(oracle, family, opened)),))
    spec = StudySpec(
        name=NAME,
        file="compare",
        families=(own.of("family"),),
        seeds=(evaluation.seed,),
        variant=own.of("variant"),
        engine=evaluation.engine or own.of("engine"),
        evaluation_seed=evaluation.seed,
        threads=evaluation.num_threads or 1,
        oracle="" if oracle is None else "oracle",
        runs=specs,
        evaluations=evaluations,
        scratch=from_scratch,
        lines=tuple(lines),
    )
    return Study(spec).run(out, executor=executor, workers=workers, say=say)


class Common(NamedTuple):
    """What the runs of a comparison must have in common."""

    family: str | None
    runs: Sequence[Run]

    def of(self, name: str) -> Any:
        """Return a setting of the world: what was given, or that of all runs."""
        if name == "family" and self.family is not None:
            return self.family
        found = {getattr(run.settings, name) for run in self.runs}
        if len(found) > 1:
            raise RunError(
                f"the runs must agree in `{name}` to be compared, got "
                f"{' and '.join(sorted(found))}: compare fewer runs."
            )
        if not found and name == "family":
            raise RunError("`family` must be given where no run says it: --family NAME.")
        return next(iter(found), getattr(RunSettings(), name))


def _spec(series: Series, runs: Sequence[Run]) -> RunSpec:
    return RunSpec(label=series.label, directories=tuple(str(run.directory) for run in runs))


def _scratch(text: str) -> tuple[str, ScratchSpec]:
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
    method = SCRATCH[name].__name__
    return method, ScratchSpec(method, num_tasks=int(count) if colon else None)


def _can(name: str, runs: Sequence[Run], evaluation: Evaluation, say: Say) -> bool:
    """Whether runs can be given the additions of an evaluation."""
    try:
        member_of_run(TrainedRun(), runs[0]).check(evaluation)
    except RunError as error:
        say(f"{name} takes part as it is: {error}")
        return False
    return True


def _oracle(directory: str | Path, family: str | None, runs: Sequence[Run]) -> Path:
    """Return the directory of a run whose policy is given the task."""
    run = Run.open(directory, family)
    if run.settings.method != "oracle":
        raise RunError(
            f"`{run.directory}` must be a run of `oracle`, which is given the task, to be the "
            f"upper end of a score, but is one of `{run.settings.method}`: train one with `maesn "
            "train oracle`."
        )
    if any(one.settings.method == "oracle" for one in runs):
        raise RunError(
            "an oracle is among the runs, and --oracle names one as well: give one of the two."
        )
    return run.directory
