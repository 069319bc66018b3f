"""All figures of run directories: what is drawn, what is said, what is refused."""

import subprocess
import sys
from pathlib import Path

import pytest
from synthetic_runs import write_run

from maesn.reporting.report import write_report
from maesn.reporting.sources import compare_runs
from maesn.storage import RunError

LEARNER_AND_PHYSICS = {"equinox", "jax", "mujoco", "tensorboardX", "tyro"}


def draw(directories: list[Path], out: Path) -> set[str]:
    """Draw, check that the files are there in pairs, and return their names."""
    written = write_report(compare_runs(directories), out).files
    assert len(written) == len(set(written))
    assert {file for file in out.rglob("*") if file.is_file()} >= set(written)
    names = {str(file.relative_to(out).with_suffix("")) for file in written}
    assert len(written) == 2 * len(names)
    return names


@pytest.mark.usefixtures("figures_unsaved")
def test_one_run_gives_every_figure(tmp_path: Path) -> None:
    names = draw([write_run(tmp_path / "run")], tmp_path / "run" / "figures")
    of_comparison = ("curves", "tasks", "exploration", "noise", "latents")
    assert names == {"learning-dense", *(f"{kind}-test-sparse" for kind in of_comparison)}


@pytest.mark.usefixtures("figures_unsaved")
def test_several_runs_share_figures(tmp_path: Path) -> None:
    runs = [
        write_run(tmp_path / "a", seed=0, without=["exploration"]),
        write_run(tmp_path / "b", seed=1, without=["exploration"]),
        write_run(tmp_path / "c", method="maml", without=["metrics"]),
    ]
    names = draw(runs, tmp_path / "out")
    of_comparison = ("curves", "tasks", "exploration", "latents")
    assert names == {"learning-dense", *(f"{kind}-test-sparse" for kind in of_comparison)}


@pytest.mark.usefixtures("figures_unsaved")
def test_rewards_are_kept_apart_and_what_was_not_adapted_has_no_line(tmp_path: Path) -> None:
    without = ["adaptation", "exploration"]
    runs = [
        write_run(tmp_path / "a", without=without),
        write_run(tmp_path / "b", without=without, reward="sparse"),
    ]
    names = draw(runs, tmp_path / "out")
    assert names == {"learning-dense", "learning-sparse"}
    whole = write_run(tmp_path / "whole", "maml", without=["exploration", "metrics"])
    names = draw([runs[0], whole], tmp_path / "other")
    assert names == {"learning-dense", "curves-test-sparse"}


@pytest.mark.parametrize("name", ["metrics.jsonl", "adaptation/test-sparse.csv", "config.json"])
def test_a_broken_file_is_refused_by_name(tmp_path: Path, name: str) -> None:
    run = write_run(tmp_path / "run", without=["metrics"])
    (run / name).write_text("broken\n")
    with pytest.raises(RunError, match=f"{name}`"):
        write_report(compare_runs([run]), tmp_path / "out")


def test_plotting_loads_no_learner_no_physics_and_no_windows() -> None:
    program = "import sys, maesn.reporting.report; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    loaded = set(output.split())
    assert not {name.partition(".")[0] for name in loaded} & LEARNER_AND_PHYSICS
    assert "matplotlib.figure" in loaded
    assert "matplotlib.pyplot" not in loaded
