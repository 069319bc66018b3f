"""Help that can be read, options that are nearly right, and `maesn doctor`."""

import contextlib
import itertools
import re
from pathlib import Path

import pytest

from maesn import cli

WORDS = [[name] for name in cli.COMMANDS] + [["train", "maesn"]]


def help_of(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    monkeypatch.setenv("COLUMNS", "90")
    with contextlib.suppress(SystemExit):
        cli.run([*words, "--help"])
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("words", WORDS, ids=" ".join)
def test_help_wraps_once(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # A line ends only where the next word would not have fitted, or a sentence ends.
    lines = [re.sub("[│|]", " ", line).rstrip() for line in help_of(words, capsys, monkeypatch)]
    boxed = [line for line in lines if line.startswith(" ")]
    assert boxed
    longest = max(map(len, boxed), default=0)
    for line, after in itertools.pairwise(boxed):
        begun = re.match(r" {8,}\S|.*\S {2,}\S", line) and not line.endswith((")", "."))
        if begun and re.match(r" {8,}\S", after):
            assert len(line) + 1 + len(after.split()[0]) > longest, (line, after)


def test_train_shows_settings_without_a_method(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = "\n".join(help_of(["train"], capsys, monkeypatch))
    for option in ("--iterations", "--episodes-per-task", "--trust-region.max-kl"):
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
    assert "Perhaps you meant:" in said
    assert f" {meant} " in said


def test_doctor_lets_a_robot_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MAESN_CACHE", "off")
    monkeypatch.chdir(tmp_path)
    assert cli.run(["doctor"]) == 0
    shown = capsys.readouterr().out
    for word in ("maesn ", "mujoco ", "cpu", "blockpush", "all is well"):
        assert word in shown
    assert list(tmp_path.iterdir()) == []
