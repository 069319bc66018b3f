"""A method that a user brings: named on the command line, and never imported by reading a file."""

import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripts import load_script
from small_runs import tiny_maesn

from maesn import cli
from maesn.runs.checkpoint import digest_of_arrays, read_checkpoint
from maesn.runs.config import NotNamedError, RunSettings
from maesn.runs.run import Run
from maesn.storage import RunError

USUAL = ["--family", "point", "--checkpoint-every", "1"]


def train(directory: Path, *options: str, method: str = "walk:Walk", iterations: int = 3) -> Run:
    words = ["--run", str(directory), "--iterations", str(iterations), *USUAL, *options]
    assert cli.run(["train", method, *words]) == 0
    return Run.open(directory)


@pytest.fixture
def unnamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of a module that is not imported."""
    train(tmp_path / "run")
    monkeypatch.delitem(sys.modules, "walk")
    return tmp_path / "run"


def test_its_settings_are_options_and_are_recorded(tmp_path: Path) -> None:
    run = train(tmp_path / "run", "--stride.length", "2.5", "--memory", "7")
    assert run.settings.method == "walk:Walk"
    assert (run.learner.stride.length, run.learner.memory) == (2.5, 7)
    assert run.metrics()[-1]["distance"] > 0


def test_a_value_is_a_method_as_well(tmp_path: Path) -> None:
    assert train(tmp_path / "run", method="walk:long_walk").learner.stride.length == 10.0


@pytest.mark.parametrize(
    "name", ["walk:not_a_method", "walk:nothing", "nowhere:Walk", "walk:Stride"]
)
def test_what_is_no_method_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["train", name, "--run", str(tmp_path / "run"), *USUAL]) == cli.USAGE_ERROR
    assert name in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_reading_a_run_imports_nothing_and_says_what_to_type(
    unnamed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(NotNamedError):
        Run.open(unnamed)
    assert cli.run(["resume", str(unnamed)]) == cli.USAGE_ERROR
    assert "walk" not in sys.modules
    typed = capsys.readouterr().err.splitlines()[-1].removeprefix("Type: maesn ").split()
    assert cli.run([*typed, "--iterations", "4"]) == 0
    assert Run.open(unnamed).latest().iteration == 4


def test_only_what_is_missing_is_printed(unnamed: Path) -> None:
    error = NotNamedError(unnamed, {"method": "walk:Walk", "family": "mine:family"})
    words = ["resume", str(unnamed), "--family=mine:family"]
    typed = f"Type: maesn resume {unnamed} --family=mine:family --method walk:Walk"
    assert cli._commands(error, words) == [typed]
    # It was given, and is another one.
    (said,) = cli._commands(error, ["resume", str(unnamed), "--method", "walk:Stride"])
    assert not said.startswith("Type:")


def test_no_command_is_printed_that_would_not_work(
    unnamed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begun = ["train", "maesn", "--run", str(tmp_path / "begun"), "--init-from", str(unnamed)]
    for words in ([*begun, *USUAL], ["resume", str(unnamed), "--method", "small_runs:tiny_maesn"]):
        assert cli.run(words) == cli.USAGE_ERROR
        said = capsys.readouterr().err
        assert "module" in said
        assert "Type:" not in said


def test_its_own_advice_works_as_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    train(tmp_path / "a run")
    monkeypatch.delitem(sys.modules, "walk")
    advice = shlex.split(capsys.readouterr().out.splitlines()[-1].split("maesn ")[-1])
    small = ["--num-tasks", "2", "--episodes", "2", "--episodes-per-update", "1", "--rule", "none"]
    assert cli.run([*advice, *small]) == 0
    # A second run in the same place is told how to go on with the first.
    monkeypatch.delitem(sys.modules, "walk")
    words = ["--run", str(tmp_path / "a run"), *USUAL]
    assert cli.run(["train", "walk:Walk", *words]) == cli.USAGE_ERROR
    monkeypatch.delitem(sys.modules, "walk")
    advice = shlex.split(capsys.readouterr().err.splitlines()[-1].split("maesn ")[-1])
    assert cli.run(advice) == 0


def test_a_run_that_python_made_gives_the_same_advice(tmp_path: Path) -> None:
    from walk import Walk

    from maesn.policies import GaussianMLP

    settings = RunSettings(family="point", iterations=0)
    made = Run.create(tmp_path / "run", Walk(), settings)
    assert made.typed == Run.open(tmp_path / "run").typed == f"{tmp_path}/run --method walk:Walk"
    usual = Run.create(tmp_path / "usual", tiny_maesn(policy=GaussianMLP((4,))), settings)
    assert usual.typed == f"{tmp_path}/usual"


def test_it_goes_on_bit_for_bit_replay_included(tmp_path: Path) -> None:
    whole = train(tmp_path / "whole", iterations=4)
    train(tmp_path / "parts", iterations=2)
    assert cli.run(["resume", str(tmp_path / "parts"), "--iterations", "4"]) == 0
    parts = Run.open(tmp_path / "parts")
    assert parts.metrics() == whole.metrics()
    assert digest_of_arrays(parts.latest_state()) == digest_of_arrays(whole.latest_state())


def test_the_newest_checkpoint_alone_holds_the_replay(tmp_path: Path) -> None:
    run = train(tmp_path / "run", "--keep", "0")
    assert len(list(run.directory.glob("checkpoints/replay-*"))) == 1
    for path in run.checkpoints():
        assert "past" not in read_checkpoint(path)[0]
    assert np.any(run.latest_state().past != 0)
    before = run.load(run.checkpoints()[-2])
    assert run.latest().is_whole
    assert not before.is_whole
    assert before.iteration == 2
    assert not np.any(before.state.past)


def test_a_damaged_replay_costs_no_policy(tmp_path: Path) -> None:
    run = train(tmp_path / "run")
    (replay,) = run.directory.glob("checkpoints/replay-*")
    replay.write_bytes(replay.read_bytes()[:-1])
    latest = run.latest()
    assert (latest.iteration, latest.is_whole) == (3, False)
    assert not np.any(latest.state.past)


def test_pruning_keeps_the_last_checkpoint_and_no_replay(tmp_path: Path) -> None:
    run = train(tmp_path / "run")
    load_script("results/prune.py").prune_run(run.directory, needed=True)
    assert [path.name for path in run.directory.glob("checkpoints/*")] == [
        "iteration-000003.safetensors"
    ]


def test_a_replay_that_is_too_large_is_refused(tmp_path: Path) -> None:
    rows = str(300_000_000 // 12)
    words = ["train", "walk:Walk", "--run", str(tmp_path / "run"), "--memory", rows, *USUAL]
    assert cli.run(words) == cli.USAGE_ERROR
    assert not (tmp_path / "run").exists()


def test_another_run_starts_from_the_weights_alone(tmp_path: Path) -> None:
    source = train(tmp_path / "source").latest_state()
    begun = train(tmp_path / "begun", "--init-from", str(tmp_path / "source"), iterations=0)
    state = begun.latest_state()
    np.testing.assert_array_equal(state.position, source.position)
    assert (int(state.iteration), int(state.visits), float(abs(state.past).max())) == (0, 0, 0.0)


def test_weights_that_are_no_part_of_the_state_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import walk

    train(tmp_path / "source", iterations=0)
    monkeypatch.setattr(walk.Walk, "weights", lambda self, state: np.array(state.position))
    settings = RunSettings(family="point", iterations=0)
    with pytest.raises(RunError, match="parts of its state"):
        Run.create(tmp_path / "run", walk.Walk(), settings, init_from=tmp_path / "source")


def test_the_weights_are_the_identity_of_a_run(tmp_path: Path) -> None:
    run = train(tmp_path / "run")
    weights = digest_of_arrays(run.latest_state().position)
    assert run.identity()["weights"] == weights


def test_a_file_cannot_name_what_is_no_setting(tmp_path: Path) -> None:
    from maesn.learners import AbstractMetaLearner
    from maesn.serialization import from_json, to_json

    document: dict[str, Any] = to_json(train(tmp_path / "run").learner)
    for tag in ("walk:WalkState", "os:system", "walk:not_a_method", "walk:Stride", "Walk"):
        with pytest.raises((ValueError, RunError)):
            from_json(document | {"type": tag}, AbstractMetaLearner)
