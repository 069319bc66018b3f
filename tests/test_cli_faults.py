"""Whatever mistake a command is given, its answer is a sentence and an exit code."""

from pathlib import Path

import numpy as np
import pytest
from small_runs import create_tiny

from maesn import cli
from maesn.commands import runs as commands
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
    ("words", "named"),
    [
        ("trian", "Did you mean `train`?"),
        ("train measn", "`maesn`"),
        ("train maesn --settings", "`settings`"),
        ("train maesn --settings wrong", "`settings`"),
        ("train maesn --family weeled", "`wheeled`"),
        ("train maesn --family ..:x", "`..:x`"),
        ("train maesn --family {}:x", "`family`"),
        ("train maesn --iterations " + HUGE, "`iterations`"),
        ("train maesn --seed -1", "`seed`"),
        ("train maesn --meta-batch-size 0", "`meta_batch_size`"),
        ("train maesn --tasks absent.npz", "absent.npz"),
        ("train maesn --family point --run {}/config.json", "config.json"),
        ("train maesn --family puck", "got `puck`. Give your own"),
        ("train maesn --family sparse_point:pearl", "with `pearl` as its `variant`"),
        ("train maesn --family point --meta-batch-size 1000", "`meta_batch_size`"),
        ("resume absent", "absent"),
        ("report {}/..", "there is no run in `{0}/..` itself, but in `{0}/../run`"),
        ("resume {} --iterations " + HUGE, "`iterations`"),
        ("adapt {} --episodes -50", "`episodes`"),
        ("adapt {} --num-tasks 101", "`num_tasks` must be at most 100"),
        ("adapt {} --rule serch", "Did you mean `search`?"),
        ("adapt {} --out .", "Is a directory"),
        ("adapt {} --tasks " + 5000 * "x", "File name too long"),
        ("export {} " + 5000 * "x", "File name too long"),
        ("report", "run or study"),
        ("render " + 5000 * "x", "File name too long"),
    ],
)
def test_wrong_words_get_a_sentence(
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: str,
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    printed = said(capsys, *words.format(run.directory).split())
    assert named.format(run.directory) in printed
    assert not list(tmp_path.iterdir())


def test_an_interrupted_command_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(options: list[str]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "resume", interrupted)
    assert cli.run(["resume"]) == cli.INTERRUPTED
    assert capsys.readouterr().err == "maesn resume: interrupted\n"


def test_more_episodes_than_memory_are_refused_with_the_numbers(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = ["train", "maesn", "--family", "point", "--run", str(tmp_path / "new")]
    printed = said(capsys, *few, "--episodes-per-task", "1000000000")
    # Of 4 bytes each: 2 of the observation, 4 times 2 of the action, 6 more.
    assert "2,560.0 GB" in printed
    assert not (tmp_path / "new").exists()
    # The same of a batch that only adaptation plays.
    monkeypatch.setattr(budget, "memory", lambda: 64 * 40 * 2 * 50 - 1)
    adapt = ["adapt", str(run.directory), "--num-tasks", "2", "--episodes", "50"]
    adapt += ["--tasks-at-once", "2"]
    assert "100 episodes" in said(capsys, *adapt)


def test_the_machines_memory_is_that_of_the_kernel() -> None:
    lines = Path("/proc/meminfo").read_text().splitlines()
    total = next(int(line.split()[1]) for line in lines if line.startswith("MemTotal"))
    assert 2**28 < budget.memory() <= 1024 * total


def test_tasks_that_a_small_file_states_are_limited(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tasks.npz"
    np.savez_compressed(path, goal=np.zeros((3 * 10**6, 2), np.float32))
    assert path.stat().st_size < 10**5
    printed = said(capsys, "adapt", str(run.directory), "--tasks", str(path))
    assert "24 MB" in printed
