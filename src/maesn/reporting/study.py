"""The report of a study: figures and tables, from the files that it left and nothing else."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from maesn.reporting.adaptation_table import Line
from maesn.reporting.comparison import Comparison, summary_tables, tidy_rows
from maesn.reporting.figures.curves import plot_curves
from maesn.reporting.figures.ends import plot_ends, plot_profiles
from maesn.reporting.published import comparable_curve
from maesn.reporting.reading import read_adaptation
from maesn.reporting.style import DARK_GREY, Drawn, MethodStyle, save_figure, series_styles
from maesn.reporting.tables import TextTable, write_tables
from maesn.storage import RunError, read_json, write_rows

MANIFEST = "study.json"
RESULTS, SUMMARY = "results.csv", "summary.md"

Wrote: TypeAlias = Callable[[Path], None]
Document: TypeAlias = Mapping[str, Any]


def is_study(directory: Path) -> bool:
    """Whether a directory holds a study, or studies."""
    return bool(studies_in(directory))


def studies_in(directory: Path) -> list[Path]:
    """Return the directory of a study, or those of all in it."""
    if (directory / MANIFEST).exists():
        return [directory]
    return [path.parent for path in sorted(directory.glob(f"*/{MANIFEST}"))]


def report_studies(directory: Path, wrote: Wrote) -> list[TextTable]:
    """Draw figures and write tables of a study, or of all in a directory; return the tables.

    Raises:
        RunError: a file is missing or damaged, or there is nothing to compare yet.
    """
    found = [table for path in studies_in(directory) for table in report_study(path, wrote)]
    if not found:
        raise RunError(f"`{directory}` holds no study that has something to compare yet.")
    return found


def report_study(directory: Path, wrote: Wrote) -> list[TextTable]:
    """Draw figures and write tables of one study.

    All results are in one table; each comparison has a directory of its own for the rest.
    """
    document, compared = read_comparisons(directory)
    rows = (
        {"comparison": world["name"], **row}
        for world, comparison in compared
        for row in tidy_rows(comparison)
    )
    if compared:
        write_rows(directory / RESULTS, rows)
    return [
        table
        for world, comparison in compared
        for table in _report(
            comparison, world, document["figures"], directory / world["name"], wrote
        )
    ]


def read_comparisons(directory: Path) -> tuple[Document, list[tuple[Document, Comparison]]]:
    """Read a study's manifest, and its comparisons, each with what the manifest says of it.

    Raises:
        RunError: a file is missing or damaged.
    """
    document = read_json(directory / MANIFEST, "run the study again")
    try:
        return document, [
            (one, _comparison(one, directory))
            for one in document["comparisons"]
            if one["lines"] and one["baselines"]
        ]
    except (KeyError, TypeError) as error:
        raise RunError(
            f"`{directory / MANIFEST}` is not what a study writes ({error!r}): run the study again."
        ) from error


def _comparison(document: Document, directory: Path) -> Comparison:
    styles = _styles(document["lines"])
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


def _styles(lines: Sequence[Document]) -> list[MethodStyle]:
    """Return a style for each line: those of one run or method have one colour and other dashes."""
    sources = list(dict.fromkeys(line["source"] for line in lines))
    methods = {line["source"]: line["method"] for line in reversed(lines)}
    own = dict(zip(sources, series_styles([methods[one] for one in sources]), strict=True))
    styles = []
    for position, line in enumerate(lines):
        before = sum(one["source"] == line["source"] for one in lines[:position])
        styles.append(own[line["source"]].with_rule(before, "more" if before else ""))
    return styles


def _line(line: Document, style: MethodStyle, world: Document, directory: Path) -> Line:
    """Read the tables of all seeds."""
    style = replace(style, label=line["label"])
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
    comparison: Comparison, world: Document, figures: Iterable[Document], out: Path, wrote: Wrote
) -> list[TextTable]:
    """Write summary and figures of one comparison."""
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
            drawn = _drawn(figure["kind"], replace(comparison, lines=lines), world)
            for path in save_figure(drawn, out, f"{figure['name']}-{world['name']}"):
                wrote(path)
    return titled


def _drawn(kind: str, comparison: Comparison, world: Document) -> Drawn:
    """Draw one kind of figure."""
    radius = f", radius {world['sparse_radius']:g} m" if world["sparse_radius"] else ""
    title = f"{world['family']}, {world['tasks']} tasks, {world['reward']} reward{radius}"
    if kind == "dots":
        return plot_ends(comparison, title)
    if kind == "profiles":
        return plot_profiles(comparison, title)
    bounds = comparison.bounds(max(line.num_tasks for line in comparison.lines))
    about = (world["family"], world["variant"], world["sparse_radius"])
    methods = {line["name"]: line["method"] for line in world["lines"] if not line["addition"]}
    published = {
        line.name: comparable_curve(*about, methods[line.name], line.table)
        for line in comparison.lines
        if line.name in methods
    }
    references = dict(zip(("baseline", "oracle"), bounds, strict=True))
    return plot_curves(comparison.lines, title, references, published)


def _titled(table: TextTable, name: str) -> TextTable:
    """Return a table whose title says which comparison it is of."""
    return table._replace(title=f"{name}: {table.title[0].lower()}{table.title[1:]}")
