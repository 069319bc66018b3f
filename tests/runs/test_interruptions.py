"""However training is interrupted, what comes out is what would have come out."""

import itertools
import logging
from pathlib import Path

import pytest
from small_runs import create, finish, metrics, outcome, reopened, tensors

from maesn.runs import config
from maesn.runs.training import train


@pytest.fixture
def whole(tmp_path: Path) -> tuple[bytes, dict[str, bytes]]:
    """Outcome of the six iterations that other tests interrupt."""
    return outcome(finish(create(tmp_path / "whole")))


@pytest.mark.parametrize("first", range(7))
@pytest.mark.parametrize("every", [1, 4])
def test_leaving_the_loop_saves(
    tmp_path: Path, whole: tuple[bytes, dict[str, bytes]], first: int, every: int
) -> None:
    run = create(tmp_path / "run", checkpoint_every=every)
    steps = train(run)
    list(itertools.islice(steps, first))
    steps.close()
    assert run.latest().iteration == first
    assert len(metrics(run)) == first if first else not (run.directory / "metrics.jsonl").exists()
    assert outcome(finish(reopened(run))) == whole


@pytest.mark.parametrize("how", ["end", "all", "byte"])
def test_lines_that_are_lost_are_missed_and_sound_ones_kept(
    tmp_path: Path,
    whole: tuple[bytes, dict[str, bytes]],
    caplog: pytest.LogCaptureFixture,
    how: str,
) -> None:
    run = finish(create(tmp_path / "run"), iterations=4)
    path = run.directory / "metrics.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    broken = lines[1].replace(b"{", b"\x00", 1)
    left = {"end": [*lines[:3], lines[3][:-9]], "all": [], "byte": [lines[0], broken, *lines[2:]]}
    path.write_bytes(b"".join(left[how]))
    lost = {"end": {4}, "all": {1, 2, 3, 4}, "byte": {2}}[how]
    for iterations in (5, 6):  # a later session loses no more
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            finish(reopened(run), iterations)
        assert f"{len(lost)} of the {iterations - 1} iterations" in caplog.text
    kept = whole[0].splitlines(keepends=True)
    assert path.read_bytes() == b"".join(x for n, x in enumerate(kept, 1) if n not in lost)
    assert tensors(run.checkpoints()[-1]) == whole[1]


def test_other_versions_are_mentioned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    older = config.installed_versions("jax") | {"jax": "0.1"}
    with monkeypatch.context() as patch:
        patch.setattr(config, "installed_versions", lambda engine: older)
        run = create(tmp_path / "run")
    finish(run, iterations=2)
    with caplog.at_level(logging.WARNING):
        finish(reopened(run))
    assert "'jax': '0.1'" in caplog.text
    assert len(caplog.records) == 1
