"""Comparisons of runs that exist and of methods from scratch, without a study's file."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from maesn import storage
from maesn.evaluation.arguments import AnyPath, AnyRun, OptionalPath
from maesn.evaluation.evaluation import USUAL, AnyEvaluation
from maesn.learners import SCRATCH
from maesn.reporting.runs import read_run
from maesn.reporting.sources import group_series
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.settings import suggestion
from maesn.storage import RunError
from maesn.studies.execution import AbstractExecutor, Say
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
    method: str | None = None,
    workers: int | None = None,
    evaluation: AnyEvaluation = USUAL,
    executor: Annotated[AbstractExecutor | None, tyro.conf.Suppress] = None,
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
        method: The runs' method as `module:name`, if it is your own.
        workers: Tasks at a time, in chunks; None: as many as there are CPUs for.
        evaluation: of all lines; its seed is also that of methods from scratch.
        executor: where it is computed; see `Study.run`.
        say: receives messages of progress.

    Raises:
        FailedJobsError: some jobs failed; all others are done.
        RunError: a setting, a run or a directory cannot be used.
    """
    if isinstance(runs, str | Path | Run):
        runs = [runs]
    if not (runs or scratch):
        raise RunError("name at least one run directory, or a method with --scratch.")
    opened = {run.directory: run for run in [Run.open(one, family, method) for one in runs]}
    if family is None and not opened:
        raise RunError("`family` must be given where no run says it: --family NAME.")
    with storage.refusals("each run takes part without `--rule` as well, for which "):
        usual = dataclasses.replace(evaluation, rule=None, wrappers=())
    evaluations = {"usual": EvaluationSpec(usual)}
    specs, lines, more = {}, [], []
    for one in group_series([read_run(path) for path in opened]):
        paths = [run.path for run in one.runs]
        specs[one.name] = RunSpec(label=one.style.label, directories=tuple(map(str, paths)))
        lines.append(LineSpec(run=one.name, evaluation=("usual",)))
        if evaluation.rule is not None or evaluation.wrappers:
            evaluations["more"] = EvaluationSpec(evaluation)
            try:
                trained_run(opened[paths[0]]).trial_episodes(evaluation)
                more.append(LineSpec(run=one.name, evaluation=("more",)))
            except RunError as error:
                say(f"{one.name} takes part as it is: {error}")
    from_scratch = dict(map(_scratch, scratch))
    if len(from_scratch) < len(scratch):
        raise RunError("`scratch` must name each method once.")
    lines += [*more, *(LineSpec(scratch=name, evaluation=("usual",)) for name in from_scratch)]
    if oracle is not None:
        preset = Run.open(oracle, family).settings.method
        if preset != "oracle" or "oracle" in specs:
            raise RunError(f"`oracle` must be the only run of the method `oracle`, got `{preset}`.")
        specs["oracle"] = RunSpec(directories=(str(oracle),))
    spec = StudySpec(
        name="comparison",
        file="compare",
        families=(family or _common("family", opened.values()),),
        seeds=(evaluation.seed,),
        variant=_common("variant", opened.values()),
        evaluation_seed=evaluation.seed,
        threads=evaluation.num_threads or 1,
        oracle="" if oracle is None else "oracle",
        runs=specs,
        evaluations=evaluations,
        scratch=from_scratch,
        lines=tuple(lines),
    )
    return Study(spec).run(out, executor=executor, workers=workers, say=say)


def _common(name: str, runs: Iterable[Run]) -> Any:
    found = {getattr(run.settings, name) for run in runs}
    if len(found) > 1:
        raise RunError(f"the runs must agree in `{name}`, got {' and '.join(sorted(found))}.")
    return next(iter(found), getattr(RunSettings(), name))


def _scratch(text: str) -> tuple[str, ScratchSpec]:
    """Read NAME or NAME:COUNT."""
    name, _, count = text.partition(":")
    if name not in SCRATCH or not (count or "1").isdecimal():
        known = f"one of {', '.join(SCRATCH)}, perhaps as in vime:30"
        hint = "" if name in SCRATCH else suggestion(name, SCRATCH)
        raise RunError(f"`scratch` must be {known}, got `{text}`.{hint}")
    method = SCRATCH[name].__name__
    with storage.refusals():
        return method, ScratchSpec(method, num_tasks=int(count) if count else None)
