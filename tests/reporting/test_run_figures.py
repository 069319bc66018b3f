"""All figures of run directories: what is drawn, what is said, what is refused."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from figure_checks import legend
from matplotlib.figure import Figure
from synthetic_runs import write_run

from maesn.reporting.run_figures import draw_runs
from maesn.reporting.runs import Latents
from maesn.reporting.style import Drawn
from maesn.storage import RunError

LEARNER_AND_PHYSICS = {"equinox", "jax", "mujoco", "tensorboardX", "tyro"}


@pytest.fixture
def unsaved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Touch the files of figures instead of laying them out, which takes a second each."""

    def touch(drawn: Drawn, directory: Path, name: str) -> list[Path]:
        assert drawn.figure.axes
        directory.mkdir(parents=True, exist_ok=True)
        files = [directory / f"{name}.png", directory / f"{name}.pdf"]
        for file in files:
            file.touch(exist_ok=False)
        return files

    monkeypatch.setattr("maesn.reporting.run_figures.save_figure", touch)


def draw(directories: list[Path], out: Path) -> tuple[set[str], str]:
    """Draw, check that the files are there in pairs, and return their names and what was said."""
    said: list[str] = []
    written = draw_runs(directories, out, said.append)
    assert len(written) == len(set(written))
    assert {file for file in out.rglob("*") if file.is_file()} >= set(written)
    names = {str(file.relative_to(out).with_suffix("")) for file in written}
    assert len(written) == 2 * len(names)
    return names, "\n".join(said)


def test_one_run_gives_every_figure(tmp_path: Path) -> None:
    names, said = draw([write_run(tmp_path / "run")], tmp_path / "run" / "figures")
    assert names == {
        "learning-curves-dense",
        "adaptation-curves-test-sparse",
        "task-distribution",
        "exploration",
        "structured-noise-maesn",
        "latents-maesn-test-sparse",
    }
    (sentence,) = said.splitlines()
    assert sentence.startswith("MAESN: ")
    assert sentence.endswith("of the 8 goals (test tasks) are reached within 50 prior episodes.")


@pytest.mark.usefixtures("unsaved")
def test_several_runs_share_figures(tmp_path: Path) -> None:
    runs = [
        write_run(tmp_path / "a", seed=0, without=["exploration"]),
        write_run(tmp_path / "b", seed=1, without=["exploration"]),
        write_run(tmp_path / "c", method="maml", without=["metrics"]),
        tmp_path / "a" / ".." / "a",  # given twice
    ]
    names, said = draw(runs, tmp_path / "out")
    assert names == {
        "learning-curves-dense",
        "adaptation-curves-test-sparse",
        "latents-maesn-test-sparse",
        "task-distribution",
        "exploration",
    }
    assert f"No exploration trajectories in `{runs[0]}`, `{runs[1]}`: " in said
    assert f"No metrics in `{runs[2]}`: " in said


@pytest.mark.usefixtures("unsaved")
def test_rewards_are_kept_apart_and_worlds_refused(tmp_path: Path) -> None:
    without = ["adaptation", "exploration"]
    runs = [
        write_run(tmp_path / "a", without=without),
        write_run(tmp_path / "b", without=without, reward="sparse"),
        write_run(tmp_path / "c", without=without, family="point"),
    ]
    names, _ = draw(runs[:2], tmp_path / "out")
    assert names == {"learning-curves-dense", "learning-curves-sparse"}
    with pytest.raises(RunError, match="same `family`, got point and wheeled: report on each"):
        draw(runs, tmp_path / "other")


def test_what_is_missing_is_said_with_the_command_that_makes_it(tmp_path: Path) -> None:
    bare = write_run(tmp_path / "bare", without=["metrics", "adaptation", "exploration"])
    names, said = draw([bare], tmp_path / "out")
    assert names == set()
    assert said.splitlines() == [
        f"No metrics in `{bare}`: `maesn train` or `maesn resume DIR` writes them.",
        f"No adaptation in `{bare}`: `maesn adapt DIR` writes it.",
        f"No exploration trajectories in `{bare}`: `maesn report DIR` records them, if the family "
        "says where things are in a plane.",
    ]


@pytest.mark.usefixtures("unsaved")
def test_other_rules_are_lines_of_the_same_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = write_run(tmp_path / "run", without=["exploration", "metrics"])
    table = run / "adaptation" / "test-sparse.csv"
    tuned = table.with_name("test-sparse-10-then-trpo.csv")
    tuned.write_bytes(table.read_bytes())
    tuned.with_suffix(".settings.json").write_text('{"label": "then TRPO"}')
    figures: dict[str, Drawn] = {}

    def keep(drawn: Drawn, _: Path, name: str) -> list[Path]:
        figures[name] = drawn
        return []

    monkeypatch.setattr("maesn.reporting.run_figures.save_figure", keep)
    draw_runs([run], tmp_path / "out", print)
    assert set(figures) == {"adaptation-curves-test-sparse", "latents-maesn-test-sparse"}
    assert set(legend(figures["adaptation-curves-test-sparse"].figure)) == {
        "MAESN",
        "MAESN (then TRPO)",
    }


@pytest.mark.usefixtures("unsaved")
def test_a_method_that_was_not_adapted_is_named(tmp_path: Path) -> None:
    whole = write_run(tmp_path / "whole", without=["exploration", "metrics"])
    bare = write_run(tmp_path / "bare", "maml", without=["adaptation", "exploration", "metrics"])
    names, said = draw([whole, bare], tmp_path / "out")
    assert names == {"adaptation-curves-test-sparse", "latents-maesn-test-sparse"}
    assert (
        f"No adaptation to the test tasks with sparse reward in `{bare}`: `maesn adapt DIR "
        "--tasks test --reward sparse` writes it."
    ) in said


@pytest.mark.usefixtures("unsaved")
def test_goals_of_another_task_set_do_not_colour_latents(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", without=["metrics"])
    file = run / "figures" / "exploration.npz"
    arrays = dict(np.load(file))
    cut = ("goals", "untrained_success_rate", "solved_at_reset")
    np.savez(file, **arrays | {name: arrays[name][:3] for name in cut})
    names, said = draw([run], tmp_path / "out")
    assert "latents-maesn-test-sparse" in names
    assert "prior episodes" not in said


def test_the_goals_of_the_test_tasks_colour_no_other_latents(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where two task sets have as many tasks."""
    run = write_run(tmp_path / "run", without=["metrics"])
    for name in ("test-sparse.csv", "test-sparse.latents.npz"):
        file = run / "adaptation" / name
        file.with_name(name.replace("test", "ood")).write_bytes(file.read_bytes())
    coloured: list[bool] = []

    def plot(_: Latents, goals: np.ndarray | None) -> Drawn:
        coloured.append(goals is not None)
        return Drawn(Figure())

    monkeypatch.setattr("maesn.reporting.run_figures.exploration.plot_latents", plot)
    monkeypatch.setattr("maesn.reporting.run_figures.save_figure", lambda *_: [])
    draw_runs([run], tmp_path / "out", print)
    assert coloured == [False, True]  # ood, then test


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("metrics.jsonl", "Expected lines of JSON objects at .*metrics.jsonl`.*line 1 is"),
        ("adaptation/test-sparse.csv", "Expected the column `task`"),
        ("config.json", "Expected a JSON object at .*config.json"),
    ],
)
def test_a_broken_file_is_refused_by_name(tmp_path: Path, name: str, complaint: str) -> None:
    run = write_run(tmp_path / "run", without=["metrics"])
    (run / name).write_text("broken\n")
    with pytest.raises(RunError, match=complaint):
        draw_runs([run], tmp_path / "out", print)


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        RunError, match=r"config.json`, got no such file or directory; .*maesn train METHOD"
    ):
        draw_runs([tmp_path], tmp_path, print)


def test_plotting_loads_no_learner_no_physics_and_no_windows() -> None:
    program = "import sys, maesn.reporting.run_figures; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    loaded = set(output.split())
    assert not {name.partition(".")[0] for name in loaded} & LEARNER_AND_PHYSICS
    assert "matplotlib.figure" in loaded
    assert "matplotlib.pyplot" not in loaded
