"""The guide to a family from Gymnasium, taken at its word: its file, its commands."""

from pathlib import Path

import pytest
from guides import Guide

from maesn.runs.run import Run

GUIDE = Guide("own_environment_gymnasium.md", "hidden_gravity")
VERBS = ("train", "adapt", "report", "export")


def test_its_commands_do_what_they_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert {*VERBS, "prior"} == GUIDE.verbs
    GUIDE.imported(tmp_path, monkeypatch)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # as the guide says, for the processes
    GUIDE.follow(*VERBS)
    run = tmp_path / "runs" / "gravity"
    assert list((run / "adaptation").glob("test-sparse*.csv"))
    assert (tmp_path / "gravity.npz").exists()
    # The family has to be named again, and the command says so.
    advice = "next:    maesn adapt runs/gravity --family hidden_gravity:family"
    assert advice in capsys.readouterr().out
    normalized = "runs/maesn-family-0"
    assert Run.open(normalized, "hidden_gravity:family").learner.normalize_observations
