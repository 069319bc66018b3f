"""Run directories are made by one process at a time, which removes nothing that is not its own."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from dying import Crash, Death, files_no_larger_than
from small_runs import create, finish, reopened

from maesn import cli
from maesn.evaluation import running
from maesn.runs.changes import change_run
from maesn.runs.run import Run
from maesn.runs.training import train
from maesn.storage import LOCK, RunError, locked, new_directory, write_whole


def content(directory: Path) -> dict[str, bytes]:
    files = (path for path in directory.rglob("*") if path.is_file())
    return {str(path.relative_to(directory)): path.read_bytes() for path in files}


FILES = ["a/first", "last"]


def fill(directory: Path) -> None:
    with new_directory(directory, FILES):
        for name in FILES:
            write_whole(directory / name, name.encode())


def test_death_at_any_moment_of_the_making_leaves_what_is_whole_or_can_be_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = {name: name.encode() for name in FILES}
    for moment in range(1000):
        directory, death = tmp_path / str(moment), Death(moment)
        with monkeypatch.context() as patch:
            death.at_files(patch, "mkdir", "rmdir")
            with contextlib.suppress(Crash):
                fill(directory)
        left = content(directory)
        if "last" in left:
            assert left.items() >= whole.items()
            with pytest.raises(RunError, match="must be a new or an empty directory, but holds"):
                fill(directory)
            assert content(directory).items() >= whole.items()
        else:
            fill(directory)
            assert {n: x for n, x in content(directory).items() if "partial" not in n} == whole
        if not death.dead:
            break
    assert moment > 10


def test_a_finished_run_is_kept_whatever_marks_it_as_unfinished(tmp_path: Path) -> None:
    run = finish(create(tmp_path / "run"))
    before = content(run.directory)
    for marker in (LOCK, ".unfinished"):
        (run.directory / marker).touch()
        with pytest.raises(RunError, match=r"must be a new or an empty directory.*maesn resume"):
            create(run.directory)
        (run.directory / marker).unlink(missing_ok=True)
        assert content(run.directory) == before


@pytest.mark.parametrize("name", ["notes.txt", "checkpoints/iteration-000100.safetensors", "a/b"])
@pytest.mark.parametrize("begun", [True, False])
def test_what_nobody_knows_is_kept(tmp_path: Path, name: str, begun: bool) -> None:
    """Also where another process has died, or says that it has."""
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("mine")
    if begun:
        (tmp_path / LOCK).touch()
    with pytest.raises(RunError, match="must be a new or an empty directory, but holds files"):
        create(tmp_path)
    assert file.read_text() == "mine"


def test_a_failure_removes_what_the_block_has_made_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for directory in (tmp_path / "new", tmp_path / "empty"):
        with contextlib.suppress(KeyError), new_directory(directory, FILES):
            write_whole(directory / FILES[0], b"")
            (directory / "of another").touch()
            raise KeyError
        assert [path.name for path in directory.iterdir()] == ["of another"]
    with pytest.raises(KeyError), new_directory(tmp_path / "gone", FILES):
        raise KeyError
    assert not (tmp_path / "gone").exists()


HOLDS = """
import sys
from pathlib import Path
from maesn.storage import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def occupied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Run, int]]:
    """A run that another process works in, and that process."""
    run = create(tmp_path_factory.mktemp("occupied") / "run")
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(run.directory)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"locked\n"
        yield run, process.pid
        process.kill()
    assert (run.directory / LOCK).exists()
    next(train(run))  # whoever comes after it can work


def test_the_process_that_is_at_work_is_named(occupied: tuple[Run, int]) -> None:
    run, process = occupied
    before = content(run.directory)
    said = f"process {process} on .* is at work in `{run.directory}`: wait for it, stop it, or"
    with pytest.raises(RunError, match=said):
        next(train(run))
    with pytest.raises(RunError, match=said):
        change_run(run, {"seed": 5})
    with pytest.raises(RunError, match=said):
        create(run.directory)
    assert content(run.directory) == before


def test_a_lock_that_was_removed_locks_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its owner removes it when it ends, while another one may have it open."""
    flock = "maesn.storage.fcntl.flock"
    with monkeypatch.context() as patch:
        patch.setattr(flock, lambda *_: (tmp_path / LOCK).unlink())
        with pytest.raises(RunError, match="another process is at work"), locked(tmp_path):
            pass
    with locked(tmp_path):
        assert (tmp_path / LOCK).exists()
    assert not (tmp_path / LOCK).exists()


def test_a_run_that_was_changed_since_it_was_opened_is_not_trained(tmp_path: Path) -> None:
    run = create(tmp_path / "run")
    change_run(run, {"seed": 5})
    with pytest.raises(RunError, match="has changed since the run was opened: open it again"):
        next(train(run))
    assert next(train(reopened(run))).iteration == 1


@pytest.mark.parametrize(
    "name", ["metrics.jsonl", "timing.jsonl", "adaptation", "checkpoints/more"]
)
def test_training_writes_nothing_through_a_link(
    finished_drift: Run, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    directory = finished_drift.directory
    victim, link = directory.parent / "victim", directory / name
    victim.write_text("precious")
    (directory.parent / "folder").mkdir(exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to("../folder" if name == "adaptation" else directory.parent / "victim")
    assert cli.run(["resume", str(directory)]) == cli.USAGE_ERROR
    assert f"`{link}` must be a file or a folder itself, but is a link" in capsys.readouterr().err
    assert victim.read_text() == "precious"
    assert not list((directory.parent / "folder").iterdir())


@pytest.fixture
def finished_drift(tmp_path: Path) -> Run:
    return finish(create(tmp_path / "run", iterations=1))


def test_a_pipe_hangs_nobody(finished_drift: Run) -> None:
    path = finished_drift.directory / "metrics.jsonl"
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(RunError, match="must be a file or a folder itself"):
        next(train(finished_drift))


def test_what_killed_writers_left_is_cleaned_by_who_comes_next(finished_drift: Run) -> None:
    directory = finished_drift.directory
    left = [
        directory / "config.json.123.partial",
        directory / "checkpoints" / "iteration-000003.safetensors.9.partial",
    ]
    kept = [directory / "film.partial", directory / "adaptation" / "a.csv.77.partial"]
    kept[1].parent.mkdir()
    for path in (*left, *kept):
        path.touch()
    finish(finished_drift, 2)
    assert [path.exists() for path in (*left, *kept)] == [False, False, True, True]
    write_whole(directory / "adaptation" / "a.csv", b"")  # somebody may be writing the other one
    assert kept[1].exists()
    os.utime(kept[1], (0, 0))
    write_whole(directory / "adaptation" / "a.csv", b"")
    assert not kept[1].exists()


def test_that_a_table_can_be_written_is_known_before_anything_is_played(
    directory: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def playing(*_: object) -> None:
        raise AssertionError("it has played")

    monkeypatch.setattr(running, "evaluate", playing)
    (directory / "file").touch()
    for out, said in [
        (directory, "Is a directory): name a file in it."),
        (directory / "file" / "x.csv", "choose another directory."),
    ]:
        assert cli.run(["adapt", str(directory), "--out", str(out)]) == cli.USAGE_ERROR
        error = capsys.readouterr().err
        assert error.startswith("maesn adapt: cannot write `")
        assert said in error
    with files_no_larger_than(100):
        assert cli.run(["adapt", str(directory)]) == cli.USAGE_ERROR
    assert "(File too large): free some space there" in capsys.readouterr().err
    assert list((directory / "adaptation").iterdir()) == []
