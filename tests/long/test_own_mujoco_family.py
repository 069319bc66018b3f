"""The guide's commands for a family on a MuJoCo model do what they say."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from guides import Guide
from pictures import can_draw

GUIDE = Guide("own_environment_mujoco.md", "puck")


VERBS = ("train", "adapt", "report", "render", "export")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where the guide's file is, and can be imported from."""
    directory = tmp_path_factory.mktemp("own")
    GUIDE.write(directory)
    sys.path.insert(0, str(directory))
    yield directory
    sys.path.remove(str(directory))
    del sys.modules["puck"]


def test_its_commands_do_what_they_say(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    GUIDE.follow(*(VERBS if can_draw() else set(VERBS) - {"render"}))
    for name in ("puck", "unknown"):
        assert (folder / "runs" / name / "adaptation" / "test-sparse.csv").exists()
    assert (folder / "runs" / "puck" / "figures" / "exploration-test-sparse.png").exists()
    film = folder / "runs" / "puck" / "render" / "test-sparse-task-0.gif"
    assert film.exists() == can_draw()
    assert (folder / "puck.npz").exists()
