"""What is shown while training runs."""

import io
from pathlib import Path

import pytest
from rich.console import Console
from small_runs import create

from maesn.runs.training import train_live


@pytest.mark.parametrize(("terminal", "width"), [(True, 120), (True, 80), (False, 80)])
def test_progress_is_shown(tmp_path: Path, terminal: bool, width: int) -> None:
    text = io.StringIO()
    console = Console(file=text, force_terminal=terminal, width=width)
    run = create(tmp_path / "run")
    last = train_live(run, console=console)
    assert last is not None
    assert last.iteration == 6
    assert "6/6" in text.getvalue()
    assert "steps/s" in text.getvalue()
    assert "left" in text.getvalue()
    assert ("\x1b[" in text.getvalue()) == terminal
    assert train_live(run, iterations=5, console=console) is None
    assert f"{run.directory} has done 6 iterations: nothing is left" in text.getvalue()
