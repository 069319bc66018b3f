"""A user's own tasks: kept with the run, or refused for a reason."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_problems.probes import PROBES
from small_runs import create, goals, tiny_maesn

from maesn.envs import FAMILIES
from maesn.envs.sources import find_tasks, load_tasks
from maesn.runs.run import Run
from maesn.storage import RunError

POINT = FAMILIES["point"]


def write_goals(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def test_a_run_keeps_the_tasks_of_its_user(tmp_path: Path) -> None:
    file = write_goals(tmp_path / "mine.npz", goal=goals(5).astype(float), more=np.zeros(2))
    made = create(tmp_path / "run", tiny_maesn(), tasks=str(file))
    file.unlink()
    opened = Run.open(tmp_path / "run")
    np.testing.assert_array_equal(opened.training_tasks.tasks, goals(5))
    assert opened.training_tasks.digest() == made.training_tasks.digest()
    assert opened.latest_state().parameters.context_table.mean.shape == (5, 2)
    np.testing.assert_array_equal(opened.task_set("training").tasks, goals(5))
    np.testing.assert_array_equal(opened.task_set("test").tasks, POINT.task_set("test").tasks)


def test_changed_tasks_are_noticed(tmp_path: Path) -> None:
    file = write_goals(tmp_path / "mine.npz", goal=goals(5))
    create(tmp_path / "run", tiny_maesn(), tasks=str(file))
    write_goals(tmp_path / "run" / "tasks.npz", goal=goals(6))
    with pytest.raises(RunError, match=r"mine\.npz"):
        Run.open(tmp_path / "run")
    (tmp_path / "run" / "tasks.npz").unlink()
    with pytest.raises(RunError, match=r"tasks\.npz"):
        Run.open(tmp_path / "run")


def test_other_tasks_by_path(tmp_path: Path) -> None:
    file = write_goals(tmp_path / "test", goal=goals(3)).with_suffix(".npz")
    run = create(tmp_path / "run")
    found = run.task_set(file)
    np.testing.assert_array_equal(found.tasks, goals(3))
    assert found.tasks.dtype == POINT.task_set("test").tasks.dtype
    with pytest.raises(RunError, match="`tset`"):
        run.task_set("tset")


def test_tasks_out_of_distribution_by_name(tmp_path: Path) -> None:
    run = create(tmp_path / "run")
    np.testing.assert_array_equal(run.task_set("ood").tasks, POINT.task_set("ood").tasks)
    with pytest.raises(RunError, match="`ood`"):
        find_tasks("ood", PROBES["hidden_side"])


def arrays(**named: Any) -> Callable[[Path], Any]:
    return lambda path: np.savez(path, **named)


@pytest.mark.parametrize(
    "write",
    [
        lambda path: None,
        Path.mkdir,
        lambda path: path.write_bytes(b"goal"),
        arrays(goals=goals(3)),
        arrays(),
        arrays(goal=goals(3)[0]),
        arrays(goal=np.zeros((3, 3))),
        arrays(goal=np.zeros((0, 2))),
        arrays(goal=[["a", "b"]]),
        arrays(goal=[[0.0, 1.0], [np.nan, 1.0]]),
        arrays(goal=[[0.0, 1e300]]),
    ],
)
def test_tasks_that_cannot_be_used(tmp_path: Path, write: Callable[[Path], Any]) -> None:
    file = tmp_path / "mine.npz"
    write(file)
    with pytest.raises(RunError, match=r"mine\.npz"):
        load_tasks(file, POINT)


def laid(**changes: Any) -> dict[str, Any]:
    tasks = FAMILIES["blockpush"].task_set("test", size=5).tasks
    return tasks._asdict() | changes


def test_laid_tables_of_a_user(tmp_path: Path) -> None:
    block = np.array([4, 3, 2, 1, 0])  # of another integer type than the family's own
    file = write_goals(tmp_path / "mine.npz", **laid(block=block))
    found = load_tasks(file, FAMILIES["blockpush"]).tasks
    assert (found.block.tolist(), found.block.dtype) == (block.tolist(), np.int32)
    np.testing.assert_array_equal(found.layout, laid()["layout"])
    run = create(tmp_path / "run", tiny_maesn(), family="blockpush", tasks=str(file))
    assert run.latest_state().parameters.context_table.mean.shape == (5, 2)


@pytest.mark.parametrize(
    "changes",
    [
        {"block": [0, 1, 7, 3, 4]},
        {"block": [0, 1, -1, 3, 4]},
        {"block": [0, 1, 2.5, 3, 4]},
        {"block": [0, 1, 2**32, 3, 4]},
        {"layout": np.zeros((5, 4, 2))},
    ],
)
def test_laid_tables_that_mean_nothing(tmp_path: Path, changes: dict[str, Any]) -> None:
    file = write_goals(tmp_path / "mine.npz", **laid(**changes))
    (name,) = changes
    with pytest.raises(RunError, match=f"`{name}`"):
        load_tasks(file, FAMILIES["blockpush"])


def test_tasks_of_several_arrays_need_one_row_each(tmp_path: Path) -> None:
    two = POINT._replace(
        draw_tasks=lambda stream, size: (np.zeros((size, 2)), np.zeros(size, np.int32)),
        task_names=("goal", "mass"),
    )
    file = write_goals(tmp_path / "two.npz", goal=goals(3), mass=np.arange(3, dtype=np.int32))
    np.testing.assert_array_equal(load_tasks(file, two).tasks[1], [0, 1, 2])
    write_goals(file, goal=goals(3), mass=np.arange(4, dtype=np.int32))
    with pytest.raises(RunError, match="3, 4 rows"):
        load_tasks(file, two)
    write_goals(file, goal=goals(3), mass=np.arange(3.0))
    with pytest.raises(RunError, match="`mass`"):
        load_tasks(file, two)
    unnamed = two._replace(task_names=("goal",))
    with pytest.raises(RunError, match="they are 2 arrays, but the names are goal"):
        load_tasks(file, unnamed)


def test_tasks_may_be_truths(tmp_path: Path) -> None:
    sides = POINT._replace(
        draw_tasks=lambda stream, size: np.zeros(size, bool), task_names=("left",)
    )
    file = write_goals(tmp_path / "sides.npz", left=np.array([True, False]))
    found = load_tasks(file, sides).tasks
    assert (found.tolist(), found.dtype) == ([True, False], bool)
    mask = write_goals(tmp_path / "mask.npz", goal=np.ones((2, 2), bool))
    with pytest.raises(RunError, match="must hold values of type float32, got bool"):
        load_tasks(mask, POINT)
