"""Live progress of training on a terminal; plain lines where there is none."""

import contextlib
import datetime
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Column

from maesn.runs.log import Progress
from maesn.runs.run import Run
from maesn.runs.training import train

# Iterations whose mean duration, without compilation, predicts the time that is left.
_WINDOW = 20

# Columns of a terminal that has room for a bar beside the numbers.
_WIDE = 110


def train_live(
    run: Run, iterations: int | None = None, console: Console | None = None
) -> Progress | None:
    """Train and show how it goes: one live line on a terminal, else one line per iteration.

    Returns the last iteration; None if there was nothing left to do. At Ctrl-C a line says how to
    go on. All else is as for `train`.
    """
    console = console or Console()
    total = run.settings.iterations if iterations is None else iterations
    last: Progress | None = None
    try:
        with contextlib.closing(train(run, iterations)) as steps, _display(console, total) as show:
            recent: deque[float] = deque(maxlen=_WINDOW)
            for last in steps:
                recent.append(last.seconds - last.compile_seconds)
                left = sum(recent) / len(recent) * (total - last.iteration)
                show(last, f"{datetime.timedelta(seconds=round(left))} left")
    except KeyboardInterrupt:
        more = "" if total == run.settings.iterations else f" --iterations {total}"
        more += run.settings.family_option
        _say(console, f"Stopped, and saved. To go on: maesn resume {run.directory}{more}")
        raise
    if last is None:
        done = run.latest().iteration
        _say(console, f"{run.directory} has done {done} of {total} iterations: nothing is left.")
    return last


def describe(progress: Progress) -> str:
    """Return one iteration in a line of text."""
    info, parts = progress.info, []
    if "return_before" in info and "return_after" in info:
        parts.append(f"return {info['return_before']:.1f} -> {info['return_after']:.1f}")
    if "success_after" in info:
        parts.append(f"success {info['success_after']:.0%}")
    kl = progress.find("kl")
    if kl is not None:
        rejected = progress.find("accepted") == 0.0
        parts.append("step rejected" if rejected else f"KL {kl:.4f}")
    parts.append(f"{progress.steps_per_second:,.0f} steps/s")
    if progress.compile_seconds > 1:
        parts.append(f"compiled for {progress.compile_seconds:.0f} s")
    return ", ".join(parts)


@contextlib.contextmanager
def _display(console: Console, total: int) -> Iterator[Callable[[Progress, str], None]]:
    """Yield what shows an iteration and the time that is left."""
    if not console.is_terminal:
        yield lambda progress, left: _say(
            console, f"{progress.iteration}/{total}: {describe(progress)}, {left}"
        )
        return
    columns: list[Any] = [
        MofNCompleteColumn(table_column=Column(min_width=2 * len(str(total)) + 1)),
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
    ]
    if console.width >= _WIDE:
        columns.insert(1, BarColumn(bar_width=20, table_column=Column(min_width=20)))
    with Bar(*columns, console=console) as bar:
        shown = bar.add_task("compiling", total=total)
        yield lambda progress, left: bar.update(
            shown, completed=progress.iteration, description=f"{left}: {describe(progress)}"
        )


def _say(console: Console, text: str) -> None:
    # As it is: no markup, no colours, no line breaks of its own.
    console.print(text, markup=False, highlight=False, soft_wrap=True)
