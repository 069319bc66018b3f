"""However training is interrupted, what comes out is what would have come out."""

import dataclasses
import itertools
import logging
import os
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from faults.processes import on_a_full_disk
from small_runs import create, finish, metrics, outcome, reopened, tensors

from maesn.runs import config, log
from maesn.runs.training import train
from maesn.storage import RunError


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


class Crash(BaseException):
    """The process is gone."""


class Death:
    """Lets a process die at its n-th write: that one is half done, and nothing follows."""

    def __init__(self, moment: int) -> None:
        self._left = moment
        self.dead = False

    def before(self, call: Callable[..., Any], half: Callable[..., Any] | None = None) -> Any:
        def wrapped(*arguments: Any, **options: Any) -> Any:
            if not self.dead and self._left > 0:
                self._left -= 1
                return call(*arguments, **options)
            if half is not None and not self.dead:
                half(*arguments)
            self.dead = True
            raise Crash

        return wrapped


def half(path: Path, content: bytes) -> None:
    with path.open("ab") as file:
        file.write(content[:20])


def test_death_at_any_write_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: tuple[bytes, dict[str, bytes]]
) -> None:
    begun = create(tmp_path / "begun")
    for moment in range(1000):
        directory, death = shutil.copytree(begun.directory, tmp_path / str(moment)), Death(moment)
        run = dataclasses.replace(begun, directory=directory)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", death.before(os.fsync))
            # Removing is also the clean-up after an exception, which a dead process does not do.
            for method in ("replace", "unlink"):
                patch.setattr(Path, method, death.before(getattr(Path, method)))
            patch.setattr(log, "append", death.before(log.append, half))
            patch.setattr(log, "cut_lines", death.before(log.cut_lines))
            try:
                finish(run)
            except Crash:
                assert death.dead
        assert outcome(finish(reopened(run))) == whole
        if not death.dead:
            break
    # Three checkpoints of five writes, six iterations of two lines, and the files' beginnings.
    assert moment > 27


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


def test_a_full_disk_is_one_sentence_and_loses_nothing(
    tmp_path: Path, whole: tuple[bytes, dict[str, bytes]]
) -> None:
    failed = set()
    for size in (10, 75, *range(140, 2500, 150)):
        run = create(tmp_path / str(size))
        try:
            on_a_full_disk(partial(finish, run), size)()
        except RunError as error:
            (place,) = re.findall(f"`{run.directory}/([a-z]+)", str(error))
            failed.add(place)
        assert outcome(finish(reopened(run))) == whole
    assert failed >= {"timing", "tensorboard", "checkpoints"}
