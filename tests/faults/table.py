"""What a campaign of faults finds, as one table."""

import random
import signal
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from faults.material import Material

CLEAR, CONTINUED, LOSS, TRACEBACK, HANG, EXECUTED = OUTCOMES = (
    "clear errors",
    "continued correctly",
    "silent losses",
    "tracebacks",
    "hangs",
    "executed",
)
WRONG = (LOSS, TRACEBACK, HANG, EXECUTED)


class Hang(BaseException):
    """It did not end within its time."""


@dataclass
class Findings:
    """What became of the faults of one kind."""

    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    """A sentence for each fault that the library did not survive."""

    def add(self, outcome: str, what: str) -> None:
        self.counts[outcome] += 1
        if outcome in WRONG:
            self.wrong.append(f"{outcome}: {what}")


def is_of_tests(error: object) -> bool:
    """Whether it is an annotation that an argument broke: in the tests, these are checked first."""
    return "TypeCheckError" in repr(error) or "BeartypeCallHint" in repr(error)


Attempt: TypeAlias = Callable[[random.Random, Material, Path, Findings], None]
"""Draws one fault, or a few that belong together, and says what became of each of them."""


class Kind(NamedTuple):
    """One kind of fault."""

    name: str
    attempt: Attempt
    number: int
    """Attempts of a full campaign."""
    limit: float
    """Seconds that an attempt may take."""


def campaign(
    kinds: Sequence[Kind],
    material: Material,
    seed: int,
    scale: float = 1.0,
    index: int | None = None,
) -> Iterator[tuple[Kind, Findings]]:
    """Draw the faults of each kind.

    Each attempt has a stream of its own: one that is drawn alone, by its index, is the same.
    """
    for kind in kinds:
        findings = Findings()
        indices = range(max(1, round(kind.number * scale))) if index is None else [index]
        for number in indices:
            _attempt(kind, material, f"{seed}/{kind.name}/{number}", findings)
        yield kind, findings


def _attempt(kind: Kind, material: Material, name: str, findings: Findings) -> None:
    own = Findings()
    with tempfile.TemporaryDirectory(dir=material.directory) as directory:
        try:
            with time_limit(kind.limit):
                kind.attempt(random.Random(name), material, Path(directory), own)
        except Hang:
            own.add(HANG, f"more than {kind.limit:g} s, at {traceback.format_exc()}")
        except Exception:  # noqa: BLE001
            own.add(TRACEBACK, traceback.format_exc())
    findings.counts += own.counts
    findings.wrong += [f"{name}: {what}" for what in own.wrong]


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise `Hang` if the block takes longer."""

    def ring(*_: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def header() -> str:
    """The names of the columns."""
    return _line("kind of fault", ["tried", *OUTCOMES]) + "\n" + _line("---", ["---:"] * 7)


def line(name: str, findings: Findings) -> str:
    """One kind of fault."""
    counts = [findings.counts[outcome] for outcome in OUTCOMES]
    return _line(name, [f"{count:,}" for count in (sum(counts), *counts)])


def _line(name: str, columns: Sequence[str]) -> str:
    return "| " + " | ".join([name, *columns]) + " |"
