"""Help, options that are nearly right, and `maesn doctor`."""

import contextlib
from pathlib import Path

import pytest

from maesn import cli


def test_train_shows_settings_without_a_method(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "90")
    with contextlib.suppress(SystemExit):
        cli.run(["train", "--help"])
    shown = capsys.readouterr().out
    for option in ("--iterations", "--episodes-per-task", "--outer.trust-region.max-kl"):
        assert option in shown


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["adapt", "wheeled", "--episode", "5"], "--episodes"),
        (["train", "maesn", "--famly", "point"], "--family"),
    ],
)
def test_options_that_do_not_exist_name_the_one_that_does(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        cli.run(words)
    assert end.value.code == cli.USAGE_ERROR
    said = capsys.readouterr().err
    assert f" {meant} " in said


def test_doctor_lets_a_robot_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["doctor"]) == 0
    shown = capsys.readouterr().out
    for word in ("maesn ", "mujoco ", "cpu", "blockpush", "all is well"):
        assert word in shown
    assert list(tmp_path.iterdir()) == []
