"""Studies from end to end: jobs that are found again, that fail, and that are killed."""

import contextlib
import csv
import dataclasses
import gzip
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from inline_executor import Here
from scripts import load_script
from study_files import files

from maesn.evaluation import exploration
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import PRESETS
from maesn.policies import USUAL, GaussianMLP
from maesn.reporting import report
from maesn.reporting.comparison import Comparison
from maesn.reporting.report import write_report
from maesn.reporting.sources import compare_study
from maesn.runs.log import METRICS, TIMING
from maesn.storage import LOCK, RunError, locked, read_json, write_json
from maesn.studies.execution import SECONDS_TO_BEGIN, AbstractExecutor, Execution
from maesn.studies.executors import LocalPool
from maesn.studies.jobs import STEPS_PER_SECOND, Job
from maesn.studies.members import RUN
from maesn.studies.spec import (
    RECORDED,
    EvaluationSpec,
    FigureSpec,
    LineSpec,
    RunSpec,
    ScratchSpec,
    StudySpec,
)
from maesn.studies.study import FailedJobsError, Study

FEW = EvaluationSpec(Evaluation(num_tasks=4, episodes=3, episodes_per_update=3, tasks_at_once=2))


SMALL = StudySpec(
    name="small",
    families=("point",),
    runs={
        "mine": RunSpec(
            preset="test_study_presets:small", changes={"iterations": 2, "episodes_per_task": 3}
        )
    },
    evaluations={"few": FEW},
    figures=(FigureSpec("ends", "dots"), FigureSpec("profiles", "profiles")),
)


@pytest.fixture(autouse=True)
def presets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a user's own module where it can be imported, and let policies from scratch be small."""
    folder = tmp_path / "modules"
    folder.mkdir()
    text = "from small_runs import tiny_maesn\nsmall = tiny_maesn\n"
    (folder / "test_study_presets.py").write_text(text)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setitem(USUAL, "continuous", GaussianMLP((4,)))


@dataclasses.dataclass
class Watched(AbstractExecutor):
    """This process, with a note of what is computed; some jobs fail a number of times."""

    failing: dict[str, int] = dataclasses.field(default_factory=dict)
    slots = 1

    def __post_init__(self) -> None:
        self.started: list[str] = []

    def submit(self, job: Job, jobs: Path) -> Future[str | None]:
        self.started.append(job.name)
        kind = job.name.partition("-")[0]
        if self.failing.get(kind, 0) == 0:
            return Here().submit(job, jobs)
        self.failing[kind] -= 1
        failed: Future[str | None] = Future()
        failed.set_result("an accident")
        return failed

    def close(self) -> None:
        pass


def returns_in(tables: dict[str, bytes]) -> list[float]:
    """Return the mean returns of tables, row after row."""
    texts = [gzip.decompress(table).decode() for name, table in tables.items() if "csv" in name]
    return [float(row["mean_return"]) for text in texts for row in csv.DictReader(text.split("\n"))]


def status(study: Study, out: Path) -> dict[str, str]:
    """Return how each job is."""
    execution = study.execution(out)
    return {name: execution.status(job)[0] for name, job in execution.jobs.items()}


@pytest.mark.usefixtures("figures_unsaved")
def test_a_study_is_trained_adapted_and_compared_once(tmp_path: Path) -> None:
    executor = Watched()
    done = Study(SMALL).run(tmp_path, executor=executor)
    # A run, its four tasks two at a time, and as many of each baseline.
    kinds = [name.partition("-")[0] for name in executor.started]
    assert sorted(kinds) == [*["adapt"] * 6, "train"]
    path = done.directory / "results.csv"
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["method"] for row in rows} == {"mine", "zero_action", "random_actions"}
    assert sum(row["method"] == "mine" for row in rows) == 4 * 2
    (comparison,) = compare_study(done.directory).comparisons
    told = comparison.lines[0].table.about["episodes_per_update"]
    assert told == FEW.usual.budget.per_update
    names = {name for name in files(done.directory) if name.endswith(".png")}
    kinds_of_figures = ("comparison", "ends", "profiles")
    assert names == {f"point/{kind}-point.png" for kind in kinds_of_figures}
    before = files(done.directory)
    again = Watched()
    Study(SMALL).run(tmp_path, executor=again)
    assert again.started == []
    assert files(done.directory) == before
    # A training that was removed is done again, and nothing else.
    (training,) = (tmp_path / "jobs").glob("train-*")
    shutil.rmtree(training)
    Study(SMALL).run(tmp_path, executor=again)
    assert again.started == [training.name]
    # Another study shares what it has in common, whatever it calls itself and its runs.
    other = Watched()
    runs, scratch = {"yours": SMALL.runs["mine"]}, {"vpg": ScratchSpec("reinforce")}
    more = dataclasses.replace(SMALL, name="other", runs=runs, scratch=scratch)
    Study(more).run(tmp_path, executor=other)
    assert [name.split("-")[2] for name in other.started] == ["reinforce", "reinforce"]


@pytest.mark.long
def test_figures_of_exploration_are_drawn_from_what_a_job_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, number in {"EXPLORATION_EPISODES": 4, "EXPLORATION_TASKS": 2}.items():
        monkeypatch.setattr(exploration, name, number)
    figures = tuple(FigureSpec(f"figure-{kind}", kind) for kind in RECORDED)
    study = Study(dataclasses.replace(SMALL, figures=figures))
    recorded = [name for name in study.jobs if name.startswith("record-")]
    assert len(recorded) == 1  # of one run, whatever the number of figures
    done = study.run(tmp_path, executor=Here())
    drawn = done.directory / "point"
    assert {path.stem for path in drawn.glob("figure-*.pdf")} == {
        f"figure-{kind}-point" for kind in RECORDED
    }
    # A report reads nothing but the study's own folder.
    before, jobs = files(drawn), tmp_path / "jobs"
    jobs.rename(tmp_path / "elsewhere")
    write_report(compare_study(done.directory), done.directory)
    assert files(drawn) == before
    # Another evaluation of the line may keep no latents: those of the one before do not stay.
    (tmp_path / "elsewhere").rename(jobs)
    assert list(done.directory.rglob("*.latents.npz"))
    for path in jobs.glob("*/latents.npz"):
        path.unlink()
    study.run(tmp_path, executor=Here())
    assert not list(done.directory.rglob("*.latents.npz"))


@pytest.mark.usefixtures("figures_unsaved")
def test_what_was_pruned_is_computed_again_only_where_no_table_has_it(tmp_path: Path) -> None:
    study, jobs, executor = Study(SMALL), tmp_path / "jobs", Watched()
    done = study.run(tmp_path, executor=Here())
    computed = files(done.directory / "tables")
    load_script("results/prune.py").prune(tmp_path)
    rounded = files(done.directory / "tables")
    # No figure shows the latents.
    assert rounded.keys() == {name for name in computed if not name.endswith(".latents.npz")}
    assert returns_in(rounded) == pytest.approx(returns_in(computed), rel=0, abs=0.00501)
    (run,) = jobs.glob("train-*/run")
    assert {path.name for path in run.iterdir()} == {"checkpoints", "config.json", "metrics.jsonl"}
    assert [path.name for path in run.glob("checkpoints/*")] == ["iteration-000002.safetensors"]
    study.run(tmp_path, executor=executor)
    assert executor.started == []
    assert files(done.directory / "tables") == rounded
    # Another study, which never had them, computes them again; but trains nothing.
    other = Study(dataclasses.replace(study.spec, name="other")).run(tmp_path, executor=executor)
    assert {name.partition("-")[0] for name in executor.started} == {"adapt"}
    assert files(other.directory / "tables") == computed
    # So is what another study has computed and pruned: this one's table is of an earlier setting.
    longer = {"few": EvaluationSpec(dataclasses.replace(FEW.usual, episodes=6))}
    changed = dataclasses.replace(study.spec, evaluations=longer)
    Study(dataclasses.replace(changed, name="other")).run(tmp_path, executor=executor)
    load_script("results/prune.py").prune(tmp_path)
    assert "waiting" in status(Study(changed), tmp_path).values()
    assert set(status(study, tmp_path).values()) == {"done"}
    # What is kept of a run is enough to find its metrics again, and to see where they differ.
    repeat, log = load_script("results/repeat.py").repeat, run / "metrics.jsonl"
    with pytest.raises(SystemExit, match="0"):
        repeat(run.parent, iterations=2)
    log.write_text(log.read_text().replace('"iteration": 2', '"iteration": 3'))
    with pytest.raises(SystemExit, match="1"):
        repeat(run.parent, iterations=2)


@pytest.mark.usefixtures("figures_unsaved")
def test_a_figure_can_show_one_of_several_evaluations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[list[str]] = []

    def note(comparison: Comparison) -> None:
        drawn.append([line.name for line in comparison.lines])

    monkeypatch.setitem(report._KINDS, "curves", note)
    figures = (FigureSpec("one", lines=("mine-more",)), FigureSpec("both", lines=("mine",)))
    evaluations = {"few": FEW, "more": EvaluationSpec(dataclasses.replace(FEW.usual, episodes=6))}
    spec = dataclasses.replace(SMALL, figures=figures, evaluations=evaluations)
    Study(spec).run(tmp_path, executor=Here())
    assert drawn == [["mine-more"], ["mine-few", "mine-more"]]


def test_figures_train_no_run_that_is_not_compared() -> None:
    mine = SMALL.runs["mine"]
    runs = {"mine": mine, "other": dataclasses.replace(mine, seeds=(7,))}
    lines, figures = (LineSpec(run="mine"),), (FigureSpec(kind="exploration"),)
    study = Study(dataclasses.replace(SMALL, runs=runs, lines=lines, figures=figures))
    assert not [name for name in study.jobs if "seed-7" in name]
    assert [one.recorded.keys() for one in study.comparisons] == [{"mine"}]


def test_files_of_tasks_of_one_name_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("a", "b"):
        Path(folder).mkdir()
        np.savez(Path(folder) / "goals.npz", goal=np.ones((2, 2), np.float32))
    evaluations = {
        folder: EvaluationSpec(dataclasses.replace(FEW.usual, tasks=f"{folder}/goals.npz"))
        for folder in ("a", "b")
    }
    with pytest.raises(RunError, match="two files of tasks, have the same name: rename one"):
        Study(dataclasses.replace(SMALL, evaluations=evaluations))


def test_what_another_study_computes_is_waited_for(tmp_path: Path) -> None:
    job = Job("train-x", (), 1, lambda directory: {"by": "us"})
    executor, execution = Watched(), Execution({job.name: job}, tmp_path)
    with locked(tmp_path / job.name):
        working = threading.Thread(target=execution.run, args=(executor, lambda sentence: None))
        working.start()
        time.sleep(0.3)
        assert execution.status(job)[0] == "running"
        assert executor.started == []
        write_json(tmp_path / job.name / "done.json", {"steps": 1, "seconds": 1, "by": "them"})
    working.join()
    assert executor.started == [job.name]  # and finds it done
    assert execution.failed == {}
    assert execution.done(job.name) == {"steps": 1, "seconds": 1, "by": "them"}


def test_a_job_whose_process_was_killed_does_not_run(tmp_path: Path) -> None:
    job = Job("train-x", (), 1, lambda directory: {})
    (tmp_path / job.name).mkdir()
    (tmp_path / job.name / LOCK).write_text("process 1 on a machine")
    assert Execution({job.name: job}, tmp_path).status(job) == ("waiting", "")


def test_an_error_of_the_users_code_is_told_as_it_is() -> None:
    with contextlib.closing(LocalPool(1, 1)) as executor:
        assert executor.describe(KeyError("reward")) == "it ended with KeyError('reward')."


@pytest.mark.usefixtures("figures_unsaved")
def test_what_failed_by_accident_is_tried_again(tmp_path: Path) -> None:
    said: list[str] = []
    executor = Watched({"train": 2})
    Study(SMALL).run(tmp_path, executor=executor, say=said.append)
    assert sum(name.startswith("train") for name in executor.started) == 3
    assert sum("again: train" in sentence for sentence in said) == 2


@pytest.mark.usefixtures("figures_unsaved")
def test_what_does_not_depend_on_a_failed_job_goes_on(tmp_path: Path) -> None:
    spec = dataclasses.replace(SMALL, scratch={"reinforce": ScratchSpec("reinforce")})
    study, executor = Study(spec), Watched({"train": 3})
    with pytest.raises(FailedJobsError, match="an accident") as raised:
        study.run(tmp_path, executor=executor)
    (name,), done = raised.value.failed, raised.value.results
    assert name.startswith("train")
    assert done.tables
    assert sum("presets" in name for name in executor.started) == 3
    states = status(study, tmp_path)
    assert {states[name] for name in states if "presets" in name and "adapt" in name} == {"waiting"}
    assert (done.directory / "results.csv").exists()  # of the others
    Study(spec).run(tmp_path, executor=Watched())


def test_estimates_of_time_say_what_they_rest_on(tmp_path: Path) -> None:
    quick = Study.load("quick").execution(tmp_path)
    estimate = quick.left(workers=2)
    # On two cores it takes 4 minutes and 20 seconds.
    assert int(estimate.split()[1]) in range(3, 7)
    assert "to begin a job" in estimate
    jobs = {
        name: Job(name, needs, 1000, lambda directory: {})
        for name, needs in {"a-x-1": (), "a-x-2": (), "a-x-3": ("a-x-2",)}.items()
    }
    write_json(tmp_path / "a-x-1" / "done.json", {"steps": 10, "seconds": 6})
    # The last waits for the one before it: more workers do not help.
    for workers, minutes in {1: 20, 2: 20, 8: 20}.items():
        said = Execution(jobs, tmp_path).left(workers)
        assert said.startswith(f"About {minutes} min left with {workers} at a time")
        assert "jobs of the same kind" in said


def test_estimates_count_what_is_left_of_a_training_and_how_long_it_learns(tmp_path: Path) -> None:
    an_hour = 3600 * STEPS_PER_SECOND
    job = Job("train-x", (), an_hour, lambda directory: {}, iterations=4, effort=2 * an_hour)
    log = tmp_path / job.name / RUN / METRICS
    log.parent.mkdir(parents=True)
    log.write_text("{}\n{}\n{}\n")
    left = Execution({job.name: job}, tmp_path).hours_left([job.name])
    assert left == pytest.approx((2 + SECONDS_TO_BEGIN / 3600) / 4)
    # Once iterations were timed, the median one counts, for jobs of its kind as well.
    (log.parent / TIMING).write_text('{"seconds": 900.0}\n' + 2 * '{"seconds": 360.0}\n')
    other = dataclasses.replace(job, name="train-x-other")
    execution = Execution({job.name: job, other.name: other}, tmp_path)
    assert execution.hours_left([job.name]) == pytest.approx(0.1)
    assert execution.hours_left([other.name]) == pytest.approx(0.4)
    efforts = {name: preset().effort(1000, 1) for name, preset in PRESETS.items()}
    assert {name for name, effort in efforts.items() if effort == 1000} >= {"maesn", "latent_space"}
    slow = ("maml", "rl2", "varibad", "pearl")
    assert [efforts[name] for name in slow] == [2000, 2000, 4000, 701_000]


SCRIPT = """
import maesn

evaluations = {"few": maesn.EvaluationSpec(maesn.Evaluation(num_tasks=1, episodes=0))}
scratch = {"trpo": maesn.ScratchSpec("trpo")}
spec = maesn.StudySpec("small", ("point",), scratch=scratch, evaluations=evaluations)
maesn.Study(spec).run("studies", workers=1)
"""


@pytest.mark.long
def test_a_script_without_a_main_guard_is_told_so(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, "script.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.count("Traceback") == 1
    assert '`if __name__ == "__main__":`' in done.stderr.splitlines()[-1]


@pytest.mark.usefixtures("figures_unsaved")
def test_one_job_of_an_array(tmp_path: Path) -> None:
    study = Study(SMALL)
    train, *others = study.jobs
    with pytest.raises(RunError, match=f"needs `{train}` to be done before"):
        study.run(tmp_path, executor=Here(), only=others[0])
    with pytest.raises(RunError, match="no job `nothing`: `maesn study status` lists"):
        study.run(tmp_path, executor=Here(), only="nothing")
    Study(SMALL).run(tmp_path, executor=Here(), only=train)
    assert list(status(study, tmp_path).values()) == ["done", *["waiting"] * len(others)]


def test_names_of_jobs_say_what_decides_their_numbers() -> None:
    def names(**changed: object) -> set[str]:
        return set(Study(dataclasses.replace(SMALL, **changed)).jobs)

    usual = names()
    assert names(name="another", figures=()) == usual
    assert not names(threads=2) & usual
    assert not {name for name in names(seeds=(1,)) & usual if "maesn" in name}
    other = EvaluationSpec(dataclasses.replace(FEW.usual, seed=1))
    assert names(evaluations={"few": other}) == usual  # the seed of episodes is the study's
    assert not {name for name in names(evaluation_seed=1) & usual if "adapt" in name}


@dataclasses.dataclass
class Killing(AbstractExecutor):
    """Kills the process that trains, once, when it has done an iteration."""

    executor: AbstractExecutor
    killed: int = 0

    @property
    def slots(self) -> int:  # type: ignore[override]
        return self.executor.slots

    def submit(self, job: Job, jobs: Path) -> Future[str | None]:
        if not self.killed and job.name.startswith("train"):
            threading.Thread(target=self.kill, args=(jobs / job.name / "run",)).start()
        return self.executor.submit(job, jobs)

    def kill(self, run: Path) -> None:
        log = run / "metrics.jsonl"
        while not (log.exists() and log.stat().st_size):
            time.sleep(0.02)
        self.killed = int((run / LOCK).read_text().split()[1])
        os.kill(self.killed, signal.SIGKILL)

    def close(self) -> None:
        self.executor.close()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Ray forks
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
@pytest.mark.parametrize("name", ["local", "ray"])
def test_a_killed_worker_changes_no_byte(tmp_path: Path, name: str) -> None:
    changes = {"iterations": 60, "episodes_per_task": 3}
    runs = {"mine": dataclasses.replace(SMALL.runs["mine"], changes=changes)}
    study = Study(dataclasses.replace(SMALL, runs=runs))
    whole = study.run(tmp_path / "whole", workers=2)
    jobs = tmp_path / "killed" / "jobs"
    pool = LocalPool(2, 1) if name == "local" else import_module("ray_cluster").Ray(2, 1, jobs)
    executor = Killing(pool)
    done = study.run(tmp_path / "killed", executor=executor)
    assert executor.killed
    assert files(done.directory) == files(whole.directory)


def ending(after: float, directory: Path) -> dict[str, int]:
    """Say which process computes a job, and perhaps end that a little later."""
    if after:
        threading.Timer(after, os.kill, (os.getpid(), signal.SIGKILL)).start()
    return {"process": os.getpid()}


@pytest.mark.long
def test_a_worker_that_dies_while_it_waits_is_replaced(tmp_path: Path) -> None:
    pool, processes = LocalPool(1, 1), []
    with contextlib.closing(pool):
        for name, after in {"first": 0.5, "second": 0.0, "third": 0.0}.items():
            assert pool.submit(Job(name, (), 0, partial(ending, after)), tmp_path).result() is None
            processes.append(read_json(tmp_path / name / "done.json")["process"])
            if after:
                while Path(f"/proc/{processes[0]}").exists():
                    time.sleep(0.05)
                time.sleep(0.5)  # until the pool knows
    assert processes[0] != processes[1] == processes[2]
