"""The report of a study: figures and tables, from the files that it left and nothing else."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from maesn.report.adaptation_table import Line
from maesn.report.comparison import Comparison, summary_tables, tidy_rows
from maesn.report.figures.adaptation import plot_comparison
from maesn.report.figures.ends import plot_ends, plot_profiles
from maesn.report.reading import read_adaptation
from maesn.report.style import DARK_GREY, MethodStyle, save_figure, series_styles
from maesn.report.tables import TextTable, write_tables
from maesn.storage import RunError, read_json, write_rows

MANIFEST = "study.json"
TABLE, SUMMARY = "table.csv", "summary.md"
_DASHED = (0, (2.0, 1.0))

Say: TypeAlias = Callable[[str], None]
Document: TypeAlias = Mapping[str, Any]


def is_study(directory: Path) -> bool:
    """Whether a directory holds a study, or studies."""
    return bool(list(_manifests(directory)))


def _manifests(directory: Path) -> Iterable[Path]:
    own = directory / MANIFEST
    return [own] if own.exists() else sorted(directory.glob(f"*/{MANIFEST}"))


def report_studies(directory: Path, say: Say) -> list[TextTable]:
    """Draw figures and write tables of a study, or of all in a directory; return the tables.

    Raises:
        RunError: a file is missing or damaged, or there is nothing to compare yet.
    """
    found = [table for path in _manifests(directory) for table in report_study(path.parent, say)]
    if not found:
        raise RunError(f"`{directory}` holds no study that has something to compare yet.")
    return found


def report_study(directory: Path, say: Say) -> list[TextTable]:
    """Draw figures and write tables of one study, each comparison in a directory of its own."""
    document, found = read_json(directory / MANIFEST, "run the study again"), []
    try:
        for one in document["comparisons"]:
            if one["lines"] and one["baselines"]:
                comparison = _comparison(one, directory)
                found += _report(comparison, one, document["figures"], directory / one["name"], say)
    except (KeyError, TypeError) as error:
        raise RunError(
            f"`{directory / MANIFEST}` is not what a study writes ({error!r}): run the study again."
        ) from error
    return found


def _comparison(document: Document, directory: Path) -> Comparison:
    styles = series_styles([line["method"] for line in document["lines"]])
    lines = [
        _line(one, style, document, directory)
        for one, style in zip(document["lines"], styles, strict=True)
    ]
    plain = MethodStyle("", DARK_GREY, ":", ".")
    above = [_line(one, plain, document, directory) for one in document["oracle"]]
    return Comparison(
        lines=tuple(lines),
        horizon=document["horizon"],
        baselines=tuple(_line(one, plain, document, directory) for one in document["baselines"]),
        oracle=next(iter(above), None),
    )


def _line(line: Document, style: MethodStyle, world: Document, directory: Path) -> Line:
    """Read the tables of all seeds."""
    style = replace(style, label=line["label"])
    if line["addition"]:
        style = replace(style, line=_DASHED, marker="d")
    tables = tuple(
        replace(
            read_adaptation(directory / seed["table"]),
            tasks=world["tasks"],
            reward=world["reward"],
            trial_episodes=line["trial_episodes"],
        )
        for seed in line["seeds"]
    )
    steps = [seed["training_steps"] for seed in line["seeds"] if seed["training_steps"] is not None]
    seeds = tuple(seed["seed"] for seed in line["seeds"])
    return Line(line["name"], style, seeds, tables, max(steps, default=None))


def _report(
    comparison: Comparison, world: Document, figures: Iterable[Document], out: Path, say: Say
) -> list[TextTable]:
    """Write table, summary and figures of one comparison."""
    write_rows(out / TABLE, tidy_rows(comparison))
    titled = [_titled(one, world["name"]) for one in summary_tables(comparison)]
    write_tables(titled, out / SUMMARY)
    everything = {"name": "comparison", "kind": "curves", "lines": [], "families": []}
    sources = {one["name"]: one["source"] for one in world["lines"]}
    for figure in (everything, *figures):
        if figure["families"] and world["family"] not in figure["families"]:
            continue
        chosen = figure["lines"] or list(sources.values())
        lines = tuple(one for one in comparison.lines if sources[one.name] in chosen)
        if lines:
            draw = {"curves": plot_comparison, "dots": plot_ends, "profiles": plot_profiles}
            drawn = draw[figure["kind"]](replace(comparison, lines=lines))
            for path in save_figure(drawn, out, f"{figure['name']}-{world['name']}"):
                say(str(path))
    return titled


def _titled(table: TextTable, name: str) -> TextTable:
    """Return a table whose title says which comparison it is of."""
    return table._replace(title=f"{name}: {table.title[0].lower()}{table.title[1:]}")
