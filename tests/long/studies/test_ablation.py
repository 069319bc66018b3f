"""The ablation from training to the figure."""

from pathlib import Path

import pytest
from small_runs import tensors

from maesn import cli
from maesn.runs.run import Run

OPTIONS = [
    *("ablation", "--family", "point", "--iterations", "2", "--meta-batch-size", "3"),
    *("--episodes-per-task", "3", "--episodes-per-update", "3", "--num-tasks", "3"),
    *("--episodes", "3", "--radii", "0.8", "1.0", "--only", "maml_bias_only", "maesn_fixed_steps"),
]


def test_the_whole_chain_and_how_it_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [*OPTIONS, "--out", str(tmp_path)]
    assert cli.run(command) == 0
    for radius in ("0.8", "1"):
        assert (tmp_path / f"radius-{radius}" / "comparison.png").stat().st_size > 5000
        table = (tmp_path / f"radius-{radius}" / "table.csv").read_text()
        assert len(table.splitlines()) == 1 + 2 * 3 * 2 + 2 * 3
    assert "MAESN, fixed steps" in capsys.readouterr().out
    run = tmp_path / "runs" / "maml_bias_only-seed-0"
    checkpoints = [path.read_bytes() for path in Run.open(run).checkpoints()]
    # A run that was stopped goes on, one that is finished does not; a new seed joins.
    other = Run.open(tmp_path / "runs" / "maesn_fixed_steps-seed-0")
    last = other.checkpoints()[-1]
    finished = tensors(last)
    last.unlink()
    assert cli.run([*command, "--radii", "1.0"]) == 0
    assert tensors(last) == finished
    assert [path.read_bytes() for path in Run.open(run).checkpoints()] == checkpoints
    assert "done before" in capsys.readouterr().out
    assert cli.run([*command, "--radii", "1.0", "--training-seed", "1"]) == 0
    table = (tmp_path / "radius-1" / "table.csv").read_text()
    assert len(table.splitlines()) == 1 + 2 * 2 * 3 * 2 + 2 * 3
