"""Whatever mistake a command is given, its answer is a sentence and an exit code."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_runs import create_tiny

from maesn import cli
from maesn.commands import runs as commands
from maesn.physics import PhysicsError
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.worlds import budget

HUGE = str(10**22)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return create_tiny(tmp_path_factory.mktemp("runs") / "run")


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What a command says that was given something wrong."""
    code, printed = cli.run(list(words)), capsys.readouterr().err
    assert code == cli.USAGE_ERROR, printed
    assert "Traceback" not in printed
    assert len(printed.splitlines()) == 1
    return printed


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("train maesn --iterations " + HUGE, "`iterations` must be at most 2147483647"),
        ("train maesn --episodes-per-task " + HUGE, "`episodes_per_task` must be at most"),
        ("train maesn --checkpoint-every " + HUGE, "`checkpoint_every` must be at most"),
        ("train maesn --num-threads " + HUGE, "`num_threads` must be at most"),
        ("train maesn --seed " + HUGE, "`seed` must be at most 4294967295"),
        ("resume {} --iterations " + HUGE, "`iterations` must be at most 2147483647, got 1000"),
        ("adapt {} --episodes " + HUGE, "`episodes` must be at most"),
        ("train maesn --family ..:x", "`family` is `..:x`"),
        ("train maesn --family :x", "`family` is `:x`"),
        ("train maesn --family x:", "`family` is `x:`"),
        ("train maesn --family {}:x", "`family` is"),
        (
            "adapt {} --out .",
            "cannot write `.` (Is a directory): mend that, or choose",
        ),
        ("adapt " + 5000 * "x", "File name too long"),
        ("adapt {} --tasks " + 5000 * "x", "File name too long"),
        ("export {} " + 5000 * "x", "File name too long"),
        ("report " + 5000 * "x", "File name too long"),
        ("render " + 5000 * "x", "File name too long"),
        ("resume " + 5000 * "x", "File name too long"),
    ],
)
def test_wrong_words_get_a_sentence(
    run: Run, capsys: pytest.CaptureFixture[str], words: str, sentence: str
) -> None:
    assert sentence in said(capsys, *words.format(run.directory).split())


@pytest.mark.parametrize("content", [b"", b"PK", b"x" * 1000])
@pytest.mark.parametrize("option", ["--tasks", "--latents"])
def test_files_that_hold_nothing_get_a_sentence(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, content: bytes
) -> None:
    (tmp_path / "file.npz").write_bytes(content)
    more = [str(tmp_path / "policy.npz"), "--task", "0"] if option == "--latents" else []
    words = ["export" if more else "adapt", str(run.directory), *more]
    sentence = said(capsys, *words, option, str(tmp_path / "file.npz"))
    assert "file.npz" in sentence


@pytest.mark.parametrize(
    "document",
    ["[" * 10**5, '{"a":' * 10**5, "", "\0", "[]", '{"schema": 2}', '{"schema": [[2]]}', "1e999"],
)
def test_damaged_configurations_get_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], document: str
) -> None:
    (tmp_path / "config.json").write_text(document)
    for words in (["resume"], ["adapt"], ["report"]):
        assert "config.json" in said(capsys, *words, str(tmp_path))


def test_pipes_are_refused_instead_of_waited_for(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    words = ["adapt", str(run.directory), "--tasks", str(pipe)]
    assert "it is a pipe or a device" in said(capsys, *words)
    pipe.rename(tmp_path / "config.json")
    assert "it is a pipe or a device" in said(capsys, "adapt", str(tmp_path))


def test_what_nobody_expected_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(options: list[str]) -> None:
        raise PhysicsError([3], "it fell")

    monkeypatch.setattr(commands, "resume", broken)
    with pytest.raises(PhysicsError, match="it fell"):
        cli.run(["resume"])


def test_an_interrupted_command_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(options: list[str]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "resume", interrupted)
    assert cli.run(["resume"]) == cli.INTERRUPTED
    assert capsys.readouterr().err == "maesn resume: interrupted\n"


def test_settings_are_refused_where_they_are_made() -> None:
    wrong: dict[str, Any] = {"iterations": 10**22, "episodes_per_task": 2**31}
    for name, value in wrong.items():
        with pytest.raises(ValueError, match=f"`{name}` must be at most 2147483647"):
            RunSettings(**{name: value})


def test_numbers_of_any_kind_are_read_from_json(tmp_path: Path) -> None:
    assert json.loads(json.dumps(np.float64(0.5))) == 0.5


def test_more_episodes_than_memory_are_refused_with_the_numbers(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = ["train", "maesn", "--family", "point", "--run", str(tmp_path / "new")]
    printed = said(capsys, *few, "--episodes-per-task", "1000000000")
    # Of 4 bytes each: 2 of the observation, 4 times 2 of the action, 6 more.
    assert "1,000,000,000 episodes of 40 steps of `point`" in printed
    assert "take at least 2,560.0 GB, but this machine has" in printed
    assert not (tmp_path / "new").exists()
    # The same of a batch that only adaptation plays.
    monkeypatch.setattr(budget, "memory", lambda: 64 * 40 * 2 * 50 - 1)
    adapt = ["adapt", str(run.directory), "--num-tasks", "2", "--episodes", "50"]
    assert "100 episodes of 40 steps of `point` at once" in said(capsys, *adapt)


def test_the_machines_memory_is_that_of_the_kernel() -> None:
    lines = Path("/proc/meminfo").read_text().splitlines()
    total = next(int(line.split()[1]) for line in lines if line.startswith("MemTotal"))
    assert 2**28 < budget.memory() <= 1024 * total


def test_what_takes_days_says_so_first(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    create_tiny(tmp_path / "few", iterations=10**5)
    assert not caplog.messages
    create_tiny(tmp_path / "many", iterations=24 * 10**6)
    # 24 million iterations of 3 episodes of one task at least, 40 steps each.
    assert caplog.messages == [
        "72,000,000 episodes of 40 steps are to be played. At 200,000 steps per second this "
        "takes 4 hours."
    ]


def test_a_long_adaptation_says_so_first(
    run: Run, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    many = ["--episodes", "2000000000", "--episodes-per-update", "2000000000"]
    printed = said(capsys, "adapt", str(run.directory), "--num-tasks", "2", *many)
    assert "4,000,000,000 episodes of 40 steps of `point` at once take at least" in printed
    (warning,) = caplog.messages
    assert warning.startswith("4,000,000,000 episodes of 40 steps are to be played.")
    assert "takes 222 hours" in warning


def test_tasks_that_a_small_file_states_are_limited(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tasks.npz"
    np.savez_compressed(path, goal=np.zeros((3 * 10**6, 2), np.float32))
    assert path.stat().st_size < 10**5
    printed = said(capsys, "adapt", str(run.directory), "--tasks", str(path))
    assert "it states 24 MB of arrays, at most 17" in printed
