"""What is shown while training runs."""

import io
import signal
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from small_runs import Drift, create

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
    assert train_live(run, console=console) is None
    assert f"{run.directory} has done 6 iterations: nothing is left" in text.getvalue()


def test_control_c_tells_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, step = create(tmp_path / "run"), Drift.step

    def interrupted(learner: Drift, key: Any, state: Any, collect: Any) -> Any:
        if int(state.iteration) == 3:
            signal.raise_signal(signal.SIGINT)
        return step(learner, key, state, collect)

    monkeypatch.setattr(Drift, "step", interrupted)
    text = io.StringIO()
    with pytest.raises(KeyboardInterrupt):
        train_live(run, console=Console(file=text, width=40))
    assert f"Stopped, and saved. To go on: maesn resume {run.directory}\n" in text.getvalue()
    assert run.latest().iteration == 3
