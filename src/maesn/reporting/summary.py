"""Tables of a comparison: where each method ends, and who beats whom."""

from itertools import combinations

import numpy as np

from maesn.reporting import statistics
from maesn.reporting.comparison import Comparison, Line, note_on_judging
from maesn.reporting.statistics import Interval, bootstrap
from maesn.reporting.tables import UNITS, TextTable, Unit, labels_of, note_on_solved, sentences

_SCORE = Unit("score", digits=2)
_NO_ORACLE = (
    "no score: it needs an oracle; give the run of one with --oracle DIR (maesn train oracle)"
)
_SCORE_INTERVAL = (
    "the score's interval draws the same tasks for method, baseline and oracle; there is none if "
    "in some of the draws the oracle is not above the baseline"
)
_PROBABILITY = Unit("probability", digits=2)


def summary_tables(comparison: Comparison) -> list[TextTable]:
    """Return where each method ends, in all tasks and in parts of them, and who beats whom."""
    found = [_ends(part, addition) for addition, part in comparison.parts().items()]
    return [*found, *([_improvements(comparison)] if len(comparison.lines) > 1 else [])]


def _ends(comparison: Comparison, addition: str) -> TextTable:
    first, lines = comparison.lines[0].table, comparison.lines
    intervals: list[Interval] = []
    rows = [_end(comparison, line, intervals) for line in comparison.everyone]
    is_trained = any(row["trained on"] for row in rows)
    scoreless = ", ".join(row["method"] for row in rows[: len(lines)] if not row["score"])
    is_scored = any(row["score"] for row in rows)
    if scoreless and comparison.oracle:
        scoreless = (
            f"no score of {scoreless}: on these tasks the oracle is not above the baseline; train "
            "it for longer"
        )
    notes = sentences(
        f"mean and interquartile mean (IQM) of the {first.reward}-reward curves' last points",
        note_on_judging(lines),
        f"in brackets: {labels_of(intervals)}",
        "trained on: environment steps of meta-training" if is_trained else "",
        note_on_solved(comparison.is_solved_at_reset),
        *map(_beyond, lines),
        _SCORE_INTERVAL if is_scored else "",
        scoreless if comparison.oracle else _NO_ORACLE,
    )
    return TextTable(
        f"After each method's last update, in {first.tasks} tasks{addition}",
        tuple(rows[0]),
        tuple(tuple(row.values()) for row in rows),
        notes,
        is_named=True,
    )


def _end(comparison: Comparison, line: Line, intervals: list[Interval]) -> dict[str, str]:
    """Return one method's row by headings, and append the intervals of its returns."""
    last, steps = line.column(-1), line.training_steps
    returns, middle = (bootstrap(x, last) for x in (statistics.mean, statistics.interquartile_mean))
    success = bootstrap(statistics.mean, line.column(-1, "success_rate"))
    intervals += [returns, middle]
    score = ""
    if not np.isnan(comparison.score(last, line.num_tasks)).any():
        rivals = (*comparison.oracle, *comparison.baselines)
        bounds = (one.column(0, num_tasks=line.num_tasks) for one in rivals)
        score = _SCORE.text(bootstrap(statistics.score, last, *bounds))
    return {
        "method": line.label,
        "trained on": "" if steps is None else f"{steps / 1e6:.3g} M",
        "seeds": str(len(line.seeds)),
        "tasks": str(line.num_tasks),
        "updates": str(line.table.updates[-1]),
        "steps": f"{line.table.episodes[-1] * comparison.horizon:,}",
        "return": UNITS["mean_return"].text(returns),
        "IQM": UNITS["mean_return"].text(middle),
        "reaches goal (%)": UNITS["success_rate"].text(success),
        "score": score,
    }


def _beyond(line: Line) -> str:
    """Say from where on a method is beyond its training, and where it is just before."""
    first = line.table.first_beyond
    if first is None:
        return ""
    within = bootstrap(statistics.mean, line.column(first - 1))
    update, text = line.table.updates[first - 1], UNITS["mean_return"].text(within)
    return f"{line.beyond}; after update {update}, the last within, its return is {text}"


def _improvements(comparison: Comparison) -> TextTable:
    """Compare the methods' last points in pairs, over the tasks that both have."""
    rows, intervals = [], []
    for pair in combinations(comparison.lines, 2):
        both = min(line.num_tasks for line in pair)
        ends = (line.column(-1, num_tasks=both) for line in pair)
        intervals.append(bootstrap(statistics.improvement, *ends))
        rows.append((*(line.label for line in pair), _PROBABILITY.text(intervals[-1])))
    return TextTable(
        "Probability that the first method's last point is above the second's in a task",
        ("first", "second", "probability"),
        tuple(rows),
        sentences(
            f"in brackets: {labels_of(intervals)}. A tie counts as half a win",
            *(line.beyond for line in comparison.lines),
        ),
        is_named=True,
    )
