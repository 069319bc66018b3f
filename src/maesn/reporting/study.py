"""The report of a study: figures and tables, from the files that it left and nothing else."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from maesn.reporting.comparison import Comparison, Line, tidy_rows
from maesn.reporting.figures import recorded
from maesn.reporting.figures.curves import plot_curves, plot_ends, plot_profiles
from maesn.reporting.published import comparable_curve
from maesn.reporting.reading import latents_beside, read_adaptation, stack_seeds
from maesn.reporting.style import MethodStyle, save_figure, series_styles
from maesn.reporting.tables import TextTable, summary_tables
from maesn.storage import RunError, read_json, write_rows, write_whole

MANIFEST = "study.json"
RESULTS, SUMMARY = "results.csv", "summary.md"

_KINDS = {
    "curves": plot_curves,
    "dots": plot_ends,
    "profiles": plot_profiles,
    "tasks": recorded.plot_tasks,
    "exploration": recorded.plot_paths,
    "noise": recorded.plot_noise,
    "latents": recorded.plot_adapted_latents,
}
_EVERYTHING = {"name": "comparison", "kind": "curves", "lines": [], "families": []}

Wrote: TypeAlias = Callable[[Path], None]
Document: TypeAlias = Mapping[str, Any]


def studies_in(directory: Path) -> list[Path]:
    """Return the directory of a study, or those of all in it."""
    if (directory / MANIFEST).exists():
        return [directory]
    return [path.parent for path in sorted(directory.glob(f"*/{MANIFEST}"))]


def report_studies(directory: Path, wrote: Wrote) -> list[TextTable]:
    """Draw figures and write tables of a study, or of all in a directory; return the tables.

    A `RunError` says which file is missing or damaged, or that there is nothing to compare yet.
    """
    found = [table for path in studies_in(directory) for table in report_study(path, wrote)]
    if not found:
        raise RunError(f"`{directory}` holds no study that has something to compare yet.")
    return found


def report_study(directory: Path, wrote: Wrote) -> list[TextTable]:
    """Draw figures and write tables of one study: all results in one, a summary per comparison."""
    document, comparisons = read_comparisons(directory)
    rows = ({"comparison": one.name, **row} for one in comparisons for row in tidy_rows(one))
    if comparisons:
        write_rows(directory / RESULTS, rows)
    return [
        table
        for one in comparisons
        for table in _report(one, document, directory / one.name, wrote)
    ]


def _report(comparison: Comparison, study: Document, out: Path, wrote: Wrote) -> list[TextTable]:
    """Write summary and figures of one comparison; the titles of tables say which it is."""
    name = comparison.name
    tables = [
        table._replace(title=f"{name}: {table.title[0].lower()}{table.title[1:]}")
        for table in summary_tables(comparison)
    ]
    write_whole(out / SUMMARY, "\n".join(table.to_markdown() for table in tables).encode())
    for figure in (_EVERYTHING, *study["figures"]):
        if figure["families"] and comparison.family not in figure["families"]:
            continue
        chosen = figure["lines"] or [line.source for line in comparison.lines]
        lines = tuple(line for line in comparison.lines if line.source in chosen)
        drawn = _KINDS[figure["kind"]](replace(comparison, lines=lines)) if lines else None
        for path in save_figure(drawn, out, f"{figure['name']}-{name}") if drawn else ():
            wrote(path)
    return tables


def read_comparisons(directory: Path) -> tuple[Document, list[Comparison]]:
    """Read a study's manifest, and its comparisons; a `RunError` says which file is damaged."""
    document = read_json(directory / MANIFEST, "run the study again")
    try:
        worlds = [one for one in document["comparisons"] if one["lines"] and one["baselines"]]
        return document, [_comparison(world, directory) for world in worlds]
    except (KeyError, TypeError) as error:
        raise RunError(
            f"`{directory / MANIFEST}` is not what a study writes ({error!r}): run the study again."
        ) from error


def _comparison(world: Document, directory: Path) -> Comparison:
    """Read the tables of a comparison; lines of one source have one colour and other dashes."""
    methods: dict[str, str] = {}
    for line in world["lines"]:
        methods.setdefault(line["source"], line["method"])
    styles = dict(zip(methods, series_styles([*methods.values()]), strict=True))
    lines: list[Line] = []
    for line in world["lines"]:
        number = sum(one.source == line["source"] for one in lines)
        style = styles[line["source"]].variant(number, line["label"])
        lines.append(_line(line, style, world, directory))
    baselines, oracle = (
        tuple(_line(one, MethodStyle(one["label"]), world, directory) for one in world[group])
        for group in ("baselines", "oracle")
    )
    records = world.get("recorded", {})  # studies of earlier versions have none
    return Comparison(
        lines=tuple(lines),
        name=world["name"],
        family=world["family"],
        sparse_radius=world["sparse_radius"],
        horizon=world["horizon"],
        baselines=baselines,
        oracle=oracle,
        recorded={name: directory / file for name, file in records.items()},
    )


def _line(line: Document, style: MethodStyle, world: Document, directory: Path) -> Line:
    """Read the tables of all seeds."""
    seeds = line["seeds"]
    table = replace(
        stack_seeds([read_adaptation(directory / seed["table"]) for seed in seeds]),
        tasks=world["tasks"],
        reward=world["reward"],
        trial_episodes=line["trial_episodes"],
    )
    steps = [seed["training_steps"] for seed in seeds if seed["training_steps"] is not None]
    evaluation = {f"evaluation.{name}": value for name, value in line["evaluation"].items()}
    latents = latents_beside(directory / seeds[0]["table"])
    about = (world["family"], world["variant"], world["sparse_radius"], line["method"])
    return Line(
        line["name"],
        style,
        tuple(seed["seed"] for seed in seeds),
        table,
        training_steps=max(steps, default=None),
        source=line["source"],
        settings={**evaluation, **line["settings"]},
        published=None if line["addition"] else comparable_curve(*about, table),
        latents=latents if latents.exists() else None,
    )
