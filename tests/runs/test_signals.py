"""Signals that end a program: what is unsaved is saved, and a second one does not wait for it."""

import io
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from small_runs import Drift, create, finish, outcome, reopened

from maesn.runs.log import RunLog
from maesn.runs.process import ending_by_signals
from maesn.runs.run import Run
from maesn.runs.training import train_live

SIGNALS = [signal.SIGTERM, signal.SIGHUP]


@pytest.fixture(autouse=True)
def no_signal_is_ignored() -> Iterator[None]:
    """Let the tests, and the programs that they start, run under `nohup` as well."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    ("owner", "method", "call", "iteration"),
    [(Drift, "step", 3, 3), (RunLog, "write", 3, 3), (Run, "save_state", 0, 6)],
)
@pytest.mark.parametrize("number", [*SIGNALS, signal.SIGINT])
def test_a_signal_saves_says_so_and_ends_with_its_status(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
    owner: Any,
    method: str,
    call: int,
    iteration: int,
) -> None:
    run, text = create(tmp_path / "run", checkpoint_every=100), io.StringIO()
    original, calls = getattr(owner, method), itertools.count()

    def signalled(self: Any, *arguments: Any) -> Any:
        is_due = next(calls) == call
        if is_due and owner is RunLog:  # it is ahead of the checkpoint then
            original(self, *arguments)
        if is_due:
            signal.raise_signal(number)
        return original(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(owner, method, signalled)
        with pytest.raises((SystemExit, KeyboardInterrupt)) as stopped:
            train_live(run, console=Console(file=text, width=40))
    if number != signal.SIGINT:
        assert stopped.value.code == 128 + number
        assert signal.getsignal(number) == signal.SIG_DFL
    signal.signal(signal.SIGINT, signal.default_int_handler)
    assert f"maesn resume {run.directory} --method small_runs:Drift\n" in text.getvalue()
    assert run.latest().iteration == iteration
    assert outcome(finish(reopened(run))) == outcome(finish(create(tmp_path / "whole")))


class Gone(io.StringIO):
    """A terminal that was closed at some time."""

    closed_at = 10**9

    def write(self, text: str) -> int:
        if self.tell() > self.closed_at:
            raise OSError("Input/output error")
        return super().write(text)


def test_a_closed_terminal_ends_training_as_its_signal_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, terminal, step = create(tmp_path / "run", checkpoint_every=100), Gone(), Drift.step

    def closing(learner: Drift, key: Any, state: Any, collect: Any) -> Any:
        if int(state.iteration) == 3:
            terminal.closed_at = 0
            signal.raise_signal(signal.SIGHUP)
        return step(learner, key, state, collect)

    monkeypatch.setattr(Drift, "step", closing)
    with pytest.raises(SystemExit, match="129"):
        train_live(run, console=Console(file=terminal, force_terminal=True, width=80))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    assert run.latest().iteration == 3


TWICE = """
import signal, sys, time
from maesn import cli
from maesn.runs.process import ending_by_signals
def command(arguments):
    try:
        with ending_by_signals():
            print("at work", flush=True)
            time.sleep(60)
    finally:
        print("saving", flush=True)
        time.sleep(60)
cli.run = command
cli.main()
"""


@pytest.mark.parametrize(
    ("first", "second"), [("SIGTERM", "SIGINT"), ("SIGHUP", "SIGHUP"), ("SIGINT", "SIGINT")]
)
def test_a_second_signal_ends_the_process_at_once(first: str, second: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", TWICE],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        for number, said in ((first, b"at work"), (second, b"saving")):
            assert process.stdout.readline().strip() == said
            process.send_signal(signal.Signals[number])
        assert process.wait(timeout=30) == -signal.Signals[second]


def test_a_handler_that_the_program_has_itself_is_left_alone() -> None:
    def own(*_: Any) -> None:
        seen.append(1)

    seen: list[int] = []
    signal.signal(signal.SIGTERM, own)
    with ending_by_signals():
        signal.raise_signal(signal.SIGTERM)
    assert seen == [1]
    assert signal.getsignal(signal.SIGTERM) is own
