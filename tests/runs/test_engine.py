"""The engine of a run: chosen, recorded, and kept apart from others."""

import json
from pathlib import Path

import pytest
from small_runs import create

from maesn.physics import EngineError
from maesn.runs.config import CONFIG
from maesn.storage import RunError


def test_the_engine_of_a_run_is_recorded(tmp_path: Path) -> None:
    run = create(tmp_path / "run", family="wheeled", engine="mjx")
    config = json.loads((run.directory / CONFIG).read_text())
    assert (config["engine"], config["settings"]["engine"]) == ("mujoco.mjx", "mjx")
    assert "mujoco-mjx" in config["versions"]


def test_an_engine_that_cannot_move_the_family_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="`engine` must be"):
        create(tmp_path / "run", family="point", engine="mjx")
    assert not (tmp_path / "run").exists()


def test_a_missing_engine_leaves_no_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(EngineError, match=r"pip install -e '\.\[gpu\]'"):
        create(tmp_path / "run", family="wheeled", engine="mjx")
    assert not (tmp_path / "run").exists()
