"""Comparisons of runs that exist: a study in memory."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from maesn.evaluation.arguments import AnyEvaluation, AnyPath, AnyRun, OptionalPath
from maesn.evaluation.evaluation import USUAL, Evaluation
from maesn.learners import SCRATCH
from maesn.reporting.runs import read_run
from maesn.reporting.sources import group_series
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.storage import RunError
from maesn.studies.execution import Say
from maesn.studies.executors import AbstractExecutor, ExecutorName
from maesn.studies.members import trained_run
from maesn.studies.spec import EvaluationSpec, LineSpec, RunSpec, ScratchSpec, StudySpec
from maesn.studies.study import Results, Study


def compare(
    runs: tyro.conf.Positional[Sequence[AnyRun]] = (),
    *,
    out: AnyPath = Path("comparison"),
    scratch: Sequence[str] = (),
    oracle: OptionalPath = None,
    family: str | None = None,
    workers: int | None = None,
    evaluation: AnyEvaluation = USUAL,
    executor: Annotated[ExecutorName | AbstractExecutor, tyro.conf.Suppress] = "local",
    say: Annotated[Say, tyro.conf.Suppress] = lambda sentence: None,
) -> Results:
    """Adapt trained runs and methods from scratch to the same tasks, and compare them.

    With `--rule`, `--then` or `--bonus`, every run that can be given it takes part a second time
    with it. For anything else write a study (`maesn study run`).

    Args:
        runs: Directories of trained runs; those that differ in their seed alone become one line.
        out: Directory of figure, tables and jobs; what was interrupted goes on there.
        scratch: Methods that begin anew in every task: trpo, reinforce (alias vpg), vime.
            NAME:COUNT adapts to the first COUNT tasks alone, as in vime:30.
        oracle: Directory of a run of the preset `oracle`, the upper end of the score.
        family: Of the tasks, where there are no runs; or `module:name` of the runs' own.
        workers: Tasks at a time, in chunks; None: as many as there are CPUs for.
        evaluation: of all lines; its seed is also that of methods from scratch.
        executor: where it is computed; see `Study.run`.
        say: receives messages of progress.

    Raises:
        RunError: a setting, a run or a directory cannot be used.
    """
    opened = [Run.open(one, family) for one in runs]
    by_path = {run.directory: run for run in opened}
    grouped = group_series([read_run(path) for path in by_path])
    specs = {
        one.name: RunSpec(
            label=one.style.label, directories=tuple(str(run.path) for run in one.runs)
        )
        for one in grouped
    }
    evaluations = {"usual": EvaluationSpec(evaluation.changed(rule=None, wrappers=()))}
    lines = [LineSpec(run=name, evaluation=("usual",)) for name in specs]
    if evaluation.rule is not None or evaluation.wrappers:
        evaluations["more"] = EvaluationSpec(evaluation)
        lines += [
            LineSpec(run=one.name, evaluation=("more",))
            for one in grouped
            if _can(one.name, by_path[one.runs[0].path], evaluation, say)
        ]
    from_scratch = dict(map(_scratch, scratch))
    if len(from_scratch) < len(scratch):
        raise RunError(
            f"`scratch` must name each method once, got {' '.join(scratch)} (`vpg` is `reinforce`)."
        )
    lines += [LineSpec(scratch=name, evaluation=("usual",)) for name in from_scratch]
    if not lines:
        raise RunError("name at least one run directory, or a method with --scratch.")
    if oracle is not None:
        specs["oracle"] = RunSpec(directories=(str(_oracle(oracle, family, opened)),))
    if family is None and not opened:
        raise RunError("`family` must be given where no run says it: --family NAME.")
    spec = StudySpec(
        name="comparison",
        file="compare",
        families=(family or _common("family", opened),),
        seeds=(evaluation.seed,),
        variant=_common("variant", opened),
        engine=evaluation.engine or _common("engine", opened),
        evaluation_seed=evaluation.seed,
        threads=evaluation.num_threads or 1,
        oracle="" if oracle is None else "oracle",
        runs=specs,
        evaluations=evaluations,
        scratch=from_scratch,
        lines=tuple(lines),
    )
    return Study(spec).run(out, executor=executor, workers=workers, say=say)


def _common(name: str, runs: Sequence[Run]) -> Any:
    """Return a setting of the world that all runs must have in common."""
    found = {getattr(run.settings, name) for run in runs}
    if len(found) > 1:
        raise RunError(
            f"the runs must agree in `{name}` to be compared, got {' and '.join(sorted(found))}: "
            "compare fewer runs."
        )
    return next(iter(found), getattr(RunSettings(), name))


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


def _can(name: str, run: Run, evaluation: Evaluation, say: Say) -> bool:
    """Whether a run can be given the additions of an evaluation."""
    try:
        trained_run(run).trial_episodes(evaluation)
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
