"""Run directories are made by one process at a time, which removes nothing that is not its own."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from faults.processes import on_a_full_disk
from small_runs import create, finish

from maesn import api
from maesn.evaluation import running
from maesn.runs.run import Run
from maesn.runs.training import train
from maesn.storage import LOCK, RunError, locked


def content(directory: Path) -> dict[str, bytes]:
    files = (path for path in directory.rglob("*") if path.is_file())
    return {str(path.relative_to(directory)): path.read_bytes() for path in files}


def test_a_directory_that_holds_a_run_is_kept(tmp_path: Path) -> None:
    run = finish(create(tmp_path / "run"))
    (run.directory / LOCK).touch()  # of a process that was killed
    before = content(run.directory)
    with pytest.raises(RunError, match=r"holds a run; choose another directory.*maesn resume"):
        create(run.directory)
    assert content(run.directory) == {n: x for n, x in before.items() if n != LOCK}


@pytest.mark.parametrize("name", ["notes.txt", "checkpoints/iteration-000100.txt", "a/b"])
def test_what_nobody_knows_is_kept(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("mine")
    create(tmp_path)
    assert file.read_text() == "mine"


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
    said = f"process {process} on .* is at work in `{run.directory}`"
    with pytest.raises(RunError, match=said):
        next(train(run))
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


def test_that_a_table_can_be_written_is_known_before_anything_is_played(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "evaluate", lambda *_: pytest.fail("it has played"))
    with pytest.raises(RunError, match="cannot write"):
        api.adapt(directory, out=directory)
    with pytest.raises(RunError, match="cannot write"):
        on_a_full_disk(lambda: api.adapt(directory), 100)()
    assert list((directory / "adaptation").iterdir()) == []
