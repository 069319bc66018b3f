"""Training: what it leaves behind, and what it does about numbers that are not finite."""

import json
import logging
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_runs import Drift, create, finish, metrics, outcome, reopened, tensors, tiny_maesn
from tensorboardX.proto.event_pb2 import Event

from maesn import latent_space
from maesn.context import LatentContext
from maesn.policies import GaussianMLP
from maesn.runs.run import Run
from maesn.runs.training import describe, train
from maesn.storage import RunError


def test_what_is_left_behind(tmp_path: Path) -> None:
    run = create(tmp_path / "run", iterations=5)
    seen = list(train(run))
    assert run.metrics() == metrics(run)
    assert [progress.iteration for progress in seen] == [1, 2, 3, 4, 5]
    assert [line["iteration"] for line in metrics(run)] == [1, 2, 3, 4, 5]
    assert [path.stem[-2:] for path in run.checkpoints()] == ["00", "02", "04", "05"]
    assert [line["return_after"] for line in metrics(run)] == [p.info["return_after"] for p in seen]
    timing = [json.loads(x) for x in (run.directory / "timing.jsonl").read_text().splitlines()]
    assert [line["seconds"] for line in timing] == [progress.seconds for progress in seen]


def test_a_family_without_success_has_no_line_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = create(tmp_path / "usual", tiny_maesn(), iterations=1)
    assert "success" in describe(next(train(usual)))
    run = create(tmp_path / "run", tiny_maesn(), iterations=1)
    monkeypatch.setattr(type(run.env()), "defines_success", False)
    assert "success" not in describe(next(train(run)))
    assert "success_after" not in metrics(run)[0]


def test_nothing_left_to_do_changes_nothing(tmp_path: Path) -> None:
    run = finish(create(tmp_path / "run"))
    before = outcome(run)
    assert list(train(reopened(run))) == list(train(run, iterations=2)) == []
    assert outcome(run) == before


def events(run: Run) -> dict[str, list[tuple[int, float]]]:
    """Tag -> (global step, scalar)."""
    found: dict[str, list[tuple[int, float]]] = {}
    for event in read_events(run):
        for value in event.summary.value:
            found.setdefault(value.tag, []).append((event.step, value.simple_value))
    return found


def read_events(run: Run) -> Iterator[Event]:
    """Read as the format of TensorBoard's files is specified."""
    for path in sorted((run.directory / "tensorboard").iterdir()):
        content = path.read_bytes()
        while content:
            (length,) = struct.unpack("<Q", content[:8])
            yield Event.FromString(content[12 : 12 + length])
            content = content[16 + length :]


def test_the_real_learner_reports_what_it_does(tmp_path: Path) -> None:
    run = create(tmp_path / "run", tiny_maesn(), iterations=2)
    first, second = train(run)
    steps = 2 * 4 * 3 * 40  # two collections of four tasks, three episodes, forty steps
    assert (first.environment_steps, second.environment_steps) == (steps, 2 * steps)
    assert second.steps_per_second == pytest.approx(steps / second.seconds)
    assert math.isclose(
        sum(second.info[f"shares/{x}"] for x in ("policy", "context", "step_sizes")),
        1,
        rel_tol=1e-5,
    )
    seen = events(run)
    assert set(seen) >= {"steps_per_second", "shares/policy", "step_sizes/context/log_std"}
    for name in ("return_after", "outer/kl"):
        wanted = [(p.environment_steps, pytest.approx(p.info[name])) for p in (first, second)]
        assert seen[name] == wanted
    assert seen["steps_per_second"][1][1] == pytest.approx(second.steps_per_second)


@pytest.mark.long
def test_a_loss_that_is_not_finite_is_skipped_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    # Larger than single precision can weigh: the real learner must reject every step.
    learner = latent_space(
        context=LatentContext(kl_weight=3e38, initial_spread=30.0),
        policy=GaussianMLP((8,)),
        meta_batch_size=4,
    )
    run = create(tmp_path / "run", learner, iterations=20, checkpoint_every=100)
    before = tensors(run.checkpoints()[0])
    with (
        caplog.at_level(logging.WARNING),
        pytest.raises(RunError, match="iteration 5: the loss of 4 tasks"),
    ):
        finish(run)
    assert [f"iteration {n}: the loss" in caplog.messages[n - 1] for n in range(1, 6)] == [True] * 5
    after = tensors(run.checkpoints()[-1])
    assert run.latest().iteration == len(metrics(run)) == 5
    assert {name for name in after if after[name] != before[name]} == {"iteration"}


def test_broken_steps_that_do_not_follow_each_other_are_bad_luck(tmp_path: Path) -> None:
    learner = Drift(nonfinite_from=1, nonfinite_until=5)
    run = finish(create(tmp_path / "run", learner))
    assert [line["return_after"] is None for line in metrics(run)] == [False, *[True] * 4, False]
    with pytest.raises(RunError, match="iteration 6: the loss of 4 tasks"):
        finish(create(tmp_path / "five", Drift(nonfinite_from=1, nonfinite_until=6)))
