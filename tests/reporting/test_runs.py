"""Run directories: what is read, and one sentence about what cannot be."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_runs import (
    NUM_TASKS,
    RADIUS,
    exploration,
    latents,
    learning_curve,
    write_exploration,
    write_metrics,
    write_run,
)

from maesn.reporting.runs import (
    EXPLORATION,
    Latents,
    RecordedExploration,
    read_learning_curve,
    read_record,
    read_recorded,
    read_run,
)
from maesn.storage import RunError


def read_exploration(run: Path) -> RecordedExploration | None:
    return read_recorded(RecordedExploration, run / EXPLORATION)


def refused(call: Callable[[], object]) -> str:
    with pytest.raises(RunError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith(".")
    return message


def test_settings_are_read(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path / "a", "maml", seed=3, learner={"meta_batch_size": 20}))
    assert (run.method, run.family, run.seed) == ("maml", "wheeled", 3)
    assert run.settings["iterations"] == 30
    assert run.settings["learner"] == {"meta_batch_size": 20}


@pytest.mark.parametrize(
    "content", [None, "{", "[1]", '{"schema": 1}', '{"settings": {"method": "maesn"}}']
)
def test_what_is_no_run_is_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "config.json").write_text(content)
    assert "maesn train" in refused(lambda: read_run(tmp_path))


def test_metrics_are_read(tmp_path: Path) -> None:
    write_metrics(tmp_path / "metrics.jsonl", learning_curve(5))
    curve = read_learning_curve(tmp_path)
    assert curve is not None
    for name, expected in vars(learning_curve(5)).items():
        np.testing.assert_array_equal(getattr(curve, name), expected)


def test_a_metric_that_a_method_lacks_is_nan(tmp_path: Path) -> None:
    lines = [{"iteration": 1, "return_after": -3}, {"iteration": 2, "return_after": None}]
    (tmp_path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    curve = read_learning_curve(tmp_path)
    assert curve is not None
    np.testing.assert_array_equal(curve.return_after, [-3.0, np.nan])
    assert np.isnan(curve.return_before).all()


def test_the_line_that_is_being_written_is_left_out(tmp_path: Path) -> None:
    assert read_learning_curve(tmp_path) is None
    file = tmp_path / "metrics.jsonl"
    write_metrics(file, learning_curve(3))
    file.write_text(file.read_text() + '{"iteration": 4, "ret')
    curve = read_learning_curve(tmp_path)
    assert curve is not None
    assert curve.iteration.tolist() == [1, 2, 3]
    file.write_text("")
    assert read_learning_curve(tmp_path) is None


@pytest.mark.parametrize("has_latents", [True, False])
def test_exploration_is_read(tmp_path: Path, *, has_latents: bool) -> None:
    places = np.random.default_rng(0).normal(size=(10, 3, 2))
    laid_out = {"training_landmarks": places, "landmarks": places[:NUM_TASKS]}
    for written in (exploration(has_latents=has_latents), replace(exploration(), **laid_out)):
        write_exploration(tmp_path / "figures" / "exploration.npz", written)
        read = read_exploration(tmp_path)
        assert read is not None
        assert read.sparse_radius == RADIUS
        for name, expected in vars(written).items():
            np.testing.assert_array_equal(getattr(read, name), expected)


def test_another_record_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "figures" / "exploration.npz"
    write_exploration(file, exploration())
    whole = dict(np.load(file))
    for arrays in (
        {name: array for name, array in whole.items() if name != "goals"},
        whole | {"another": np.zeros(3)},
        whole | {"goals": np.array(["x"])},
    ):
        np.savez(file, **arrays)
        assert refused(lambda: read_exploration(tmp_path)).endswith("delete it, and report again.")


@pytest.mark.parametrize("changed", [{"mean": np.zeros((8, 4))}, {"log_std": np.zeros((8, 4, 3))}])
def test_latents_of_other_shapes_are_refused(
    tmp_path: Path, changed: dict[str, np.ndarray]
) -> None:
    np.savez(tmp_path / "latents.npz", **{**vars(latents()), **changed})
    with pytest.raises(RunError, match=r"(?s)adapt again\.$"):
        read_record(Latents, tmp_path / "latents.npz", "adapt again")
