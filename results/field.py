"""The table and the figure of the field: every method on every task set, few episodes apart.

    python results/field.py    # both, of what is in results/field
    python results/field.py --studies field results/field_robots.toml    # anew, from studies

`field/results.csv.gz` has the return of each seed in each task; `field/lines.csv` what the training
of each seed took, and what the seeds that are not done would take. A training that several lines
need is counted in each of them. A seed that is in these files stays there, also if the studies'
directory lacks it, as long as its job is the same: several machines can each do a part. So do
the families of studies that are not named.
`field/published.csv` has numbers of others, and limits. The table is `field/table.md`, the figure
docs/figures/field.png.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Float
from matplotlib.axes import Axes

from maesn.reporting import statistics, style
from maesn.reporting.reading import EXPLORE, read_adaptation
from maesn.reporting.sources import MANIFEST
from maesn.reporting.style import METHOD_STYLES, MethodStyle
from maesn.reporting.tables import UNITS, TextTable, to_page
from maesn.storage import read_json, read_rows, write_rows, write_whole
from maesn.studies.study import Study

HERE = Path(__file__).parent / "field"
RESULTS, LINES, PUBLISHED = map(HERE.joinpath, ("results.csv.gz", "lines.csv", "published.csv"))
RESULT = ("family", "line", "seed", "task", "episodes", "return", "success")
LINE = ("family", "line", "label", "kind", "tasks", "protocol", "trained_for", "seed", "purpose")
LINE += ("steps", "training", "iteration", "hours_left", "job")  # seconds, seconds, hours, digest
FIGURES = Path(__file__).parents[1] / "docs" / "figures"
EPISODES = (0, 1, 2, 3, 5, 10, 20, 100, 500)
FEWEST_SEEDS = 3  # of a line that is shown: one seed says little
# Lines whose rule has a name that says less.
LABELS = dict.fromkeys(("maesn-random", "maesn-ml1_random"), "MAESN (random latents)")
FEW = 20  # episodes, at most, after which success and the worst tasks are told
SEARCH, USUAL = "maesn-search", "final"  # line that others are compared with, and its tasks
# Lines of the figure -> their looks.
SHOWN = {
    "maesn-random": MethodStyle("MAESN, random latents", style.GREY, ":", "s"),
    **{name: METHOD_STYLES[name] for name in ("maml", "pearl", "rl2", "varibad")},
    "maesn-gradient": MethodStyle("MAESN, gradient", style.VERMILLION, "--", "D"),
    SEARCH: MethodStyle("MAESN, search", style.VERMILLION, "-", "o"),
}
ORACLE, FLOOR = "oracle", "baseline"
COSTS = ("seeds", "steps (M)", "minutes", "seconds")  # of training; of a meta-iteration
_PANELS = 4  # in a row
LEGEND = """\
Columns are numbers of episodes in a new task before the ones that are judged. ± is half the 95 %
interval over tasks and seeds; of a published number, the spread that its source gives. Success and
worst tenth (CVaR of the tasks) are those after 20 episodes, or after the most before. Lines of one
method share its training, whose steps, minutes with one thread, and seconds of a meta-iteration
(median) are means over the seeds. -: not played, or more episodes than a trial in training has;
under success: the family defines none.
"""

Row = Mapping[str, str]
Returns = Float[np.ndarray, "seed task"]


def collect(studies: Sequence[str], out: Path) -> None:
    """Write the raw results of studies, and what their lines took or would take."""
    kept = _by_job()
    results: list[dict[str, Any]] = []
    lines: list[dict[str, Any]] = []
    for study in map(Study.load, studies):
        directory, execution = out / study.spec.name, study.execution(out)
        if out.resolve() != HERE.parent.resolve():  # where studies may be pruned
            directory.mkdir(parents=True, exist_ok=True)
            study.write_results(out)
        manifest = read_json(directory / MANIFEST) if (directory / MANIFEST).exists() else {}
        worlds = {world["name"]: world for world in manifest.get("comparisons", ())}
        groups = {"lines": "method", "baselines": FLOOR}.items()
        for planned, (group, of) in product(study.comparisons, groups):
            found = {line["name"]: line for line in worlds.get(planned.name, {}).get(group, ())}
            for line in planned.lines[group]:
                label = LABELS.get(line.name, line.label)
                about = {"family": planned.name, "line": line.name, "label": label, "kind": of}
                about |= {"tasks": line.asked.tasks, "protocol": line.asked.protocol or ""}
                about["trained_for"] = line.trial_episodes
                done = {one["seed"]: one for one in found.get(line.name, {}).get("seeds", ())}
                for member, jobs in line.seeds:
                    row = about | {"seed": member.seed, "job": jobs[-1].rpartition("-")[2]}
                    if (one := done.get(member.seed)) is None:
                        if (address := _address(row)) in kept:
                            lines.append(kept[address][0])
                            results += kept[address][1]
                        else:
                            lines.append(row | {"hours_left": execution.hours_left(jobs)})
                        continue
                    table = read_adaptation(directory / one["table"])
                    row |= {"purpose": table.purpose, "steps": one["training_steps"]}
                    row |= {x: one.get(f"{x}_seconds") for x in ("training", "iteration")}
                    lines.append(row)
                    for k in np.flatnonzero(np.isin(table.episodes, EPISODES)):
                        numbers = enumerate(zip(table.mean_return, table.success_rate, strict=True))
                        at = row | {"episodes": table.episodes[k]}
                        results += (
                            at | {"task": task, "return": y[k], "success": reached[k]}
                            for task, (y, reached) in numbers
                        )
    anew = {row["family"] for row in lines}
    for path, rows, names in ((LINES, lines, LINE), (RESULTS, results, RESULT)):
        before = read_rows(path) if path.exists() else []
        rows += [row for row in before if row["family"] not in anew]
        order = list(dict.fromkeys(row["family"] for row in (*before, *rows)))
        rows.sort(key=lambda row: order.index(row["family"]))  # families stay where they were
        write_rows(path, [{name: _short(row.get(name)) for name in names} for row in rows])


def _by_job() -> dict[tuple[str, ...], tuple[Row, list[Row]]]:
    """Return the seeds that are in the files, each with its results, by `_address`."""
    if not LINES.exists():
        return {}
    results, lines = _by_line(RESULTS), _by_line(LINES)
    return {
        _address(row): (row, [one for one in results.get(name, ()) if one["seed"] == row["seed"]])
        for name, seeds in lines.items()
        for row in seeds
        if not row["hours_left"]
    }


def _address(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what must be the same for the results of a seed to be the same."""
    return tuple(str(row[name]) for name in ("family", "line", "seed", "job"))


def _short(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return f"{value:.3f}".rstrip("0").rstrip(".")
    return "" if value is None else str(value)


@dataclasses.dataclass(frozen=True)
class Cell:
    """What a line does after some episodes in the new tasks."""

    returns: Returns
    success: Returns


@dataclasses.dataclass(frozen=True)
class Entry:
    """A line of a table."""

    seeds: Sequence[Row]
    """Rows of `LINES`."""
    cells: Mapping[int, Cell]
    """Episodes in the new task -> results of the seeds that are done."""

    @property
    def is_floor(self) -> bool:
        """Whether it learns nothing."""
        return self.seeds[0]["kind"] == FLOOR

    @property
    def done(self) -> list[Row]:
        """The seeds that are done."""
        return [row for row in self.seeds if not row["hours_left"]]

    @property
    def last(self) -> Cell | None:
        """The last of the few episodes."""
        few = [count for count in self.cells if count <= FEW]
        return self.cells[max(few)] if few else None

    @property
    def costs(self) -> tuple[str, ...]:
        """Seeds, millions of steps, minutes, seconds of a meta-iteration."""
        left = [float(row["hours_left"]) for row in self.seeds if row["hours_left"]]
        seeds = str(len(self.done))
        if left:
            seeds += f" of {len(self.seeds)} ({max(sum(left), 0.1):.1f} h to do)"
        numbers = {
            name: np.mean([float(row[name]) for row in self.done if row[name]] or [np.nan])
            for name in ("steps", "training", "iteration")
        }
        steps, training, each = numbers.values()
        shown = f"{steps / 1e6:.2g}", f"{training / 60:.1f}", f"{each:.2f}"
        return seeds, *("" if text == "nan" else text for text in shown)


def entries() -> dict[str, list[Entry]]:
    """Return the lines of each family, from the raw results.

    A line that learns has no cells before `FEWEST_SEEDS` of it are done.
    """
    raw = _by_line(RESULTS)
    tables: dict[str, list[Entry]] = {}
    for name, seeds in _by_line(LINES).items():
        beyond = int(seeds[0]["trained_for"] or max(EPISODES) + 1)
        one = Entry(seeds, dict(_cells(raw.get(name, ()), beyond)))
        shown = one.is_floor or len(one.done) >= FEWEST_SEEDS
        tables.setdefault(name[0], []).append(one if shown else Entry(seeds, {}))
    return tables


def _by_line(path: Path) -> dict[tuple[str, str], list[Row]]:
    """Return the rows of a file for each family and line."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in read_rows(path):
        found.setdefault((row["family"], row["line"]), []).append(row)
    return found


def _cells(rows: Sequence[Row], beyond: int) -> Iterator[tuple[int, Cell]]:
    """Yield the cells of rows, in which tasks are in the same order for each seed."""
    seeds = len({row["seed"] for row in rows})
    for count in sorted({int(row["episodes"]) for row in rows}):
        if count < beyond:
            here = (row for row in rows if int(row["episodes"]) == count)
            numbers = np.array([[row["return"], row["success"]] for row in here], float)
            yield count, Cell(*np.moveaxis(numbers.reshape(seeds, -1, 2), -1, 0))


def table(family: str, lines: Sequence[Entry]) -> TextTable:
    """Return the table of a family, with limits and the numbers of others."""
    rows = [_row(one) for one in lines]
    notes = {}
    for row in read_rows(PUBLISHED):
        if row["family"] == family:
            cells = {int(row["episodes"] or 0): row["return"] + row["spread"]}
            same = next((one for one in rows if one[0] == row["name"]), None)
            shown = tuple(cells.get(count, "") for count in EPISODES)
            if same is None:
                rows.append((row["name"], *shown, *[""] * (2 + len(COSTS))))
            else:
                merged = (new or old for new, old in zip(shown, same[1:], strict=False))
                rows[rows.index(same)] = (row["name"], *merged, *same[len(EPISODES) + 1 :])
            if row["source"]:
                notes[row["name"]] = f"{row['name']}: {row['source']}"
    headings = ("", *map(str, EPISODES), "success (%)", "worst tenth", *COSTS)
    tasks = max((cell.returns.shape[1] for one in lines for cell in one.cells.values()), default=0)
    title = (
        f"{family}: return after so many episodes in {tasks} tasks" if tasks else f"{family}: to do"
    )
    return TextTable(title, headings, tuple(rows), tuple(notes.values()))


def _row(entry: Entry) -> tuple[str, ...]:
    unit, last = UNITS["mean_return"], entry.last
    texts = {
        count: unit.text(statistics.bootstrap(statistics.mean, cell.returns), brief=True)
        for count, cell in entry.cells.items()
    }
    few = ["", ""]
    if last is not None:
        few[0] = UNITS["success_rate"].number(last.success.mean())
        if last.returns.shape[1] >= statistics.FEWEST_TASKS:
            few[1] = unit.text(statistics.bootstrap(statistics.cvar, last.returns), brief=True)
    first, done = entry.seeds[0], entry.done or entry.seeds
    label = f"{first['label']}, floor" if entry.is_floor else first["label"]
    if done[0]["purpose"] == EXPLORE and not entry.is_floor:
        label += ", z drawn"
    label += f", by {first['protocol']}" if first["protocol"] else ""
    label += f", {first['tasks']} tasks" if first["tasks"] != USUAL else ""
    return (label, *(texts.get(count, "-") for count in EPISODES), *few, *entry.costs)


def differences(family: str, lines: Sequence[Entry]) -> TextTable:
    """Return how far search is ahead of other lines after as many episodes, in the same tasks."""
    few = [count for count in EPISODES if count <= FEW]
    mine = [one for one in lines if one.seeds[0]["line"] == SEARCH]
    rows = []
    for search, one in product(mine, lines):
        alike = {entry.seeds[0]["tasks"] for entry in (search, one)}
        if one is search or one.is_floor or len(alike) > 1 or not (one.cells and search.cells):
            continue
        pairs = [[x.cells[k].returns for x in (search, one) if k in x.cells] for k in few]
        gaps = (_gap(*pair) if len(pair) == 2 else None for pair in pairs)
        texts = (UNITS["mean_return"].text(gap) if gap else "-" for gap in gaps)
        rows.append((one.seeds[0]["label"], *texts))
    title = f"{family}: return of search less that of others, and its 95 % interval"
    return TextTable(title, ("", *map(str, few)), tuple(rows))


def _gap(first: Returns, second: Returns) -> statistics.Interval:
    """Return by how much the first is ahead in the tasks that both have, which come first."""
    tasks = min(first.shape[1], second.shape[1])
    pair = first[:, :tasks], second[:, :tasks]
    return statistics.bootstrap(lambda x, y: statistics.mean(x) - statistics.mean(y), *pair)


@style.publication_style()
def draw(tables: Mapping[str, Sequence[Entry]]) -> None:
    """Draw a panel for each family in which a search has results, if there is one.

    Bands are 95 % intervals over tasks and seeds; solid the oracle, dotted what learns nothing.
    The legend takes the last panel where one is free.
    """
    shown = {
        name: lines
        for name, lines in tables.items()
        if any(one.cells for one in lines if one.seeds[0]["line"] == SEARCH)
    }
    if not shown:
        return
    rows = -(-len(shown) // _PANELS)
    drawn = style.new_figure(style.TWO_COLUMNS, 0.6 + 1.9 * rows)
    panels = drawn.subplots(rows, min(len(shown), _PANELS), squeeze=False).ravel()
    limits = [row for row in read_rows(PUBLISHED) if row["name"] == ORACLE]
    known: dict[str, Any] = {}
    for axes, (family, lines) in zip(panels, shown.items(), strict=False):
        oracle = [float(row["return"]) for row in limits if row["family"] == family]
        _draw(axes, family, lines, oracle)
        handles, labels = axes.get_legend_handles_labels()
        known |= zip(labels, handles, strict=True)
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    for axes in panels[::_PANELS]:
        axes.set_ylabel("return")
    key = {"handles": list(known.values()), "labels": list(known)}
    if len(shown) < len(panels):
        panels[-1].legend(**key, loc="center")
    else:
        drawn.legend(**key, loc="outside lower center", ncols=5)
    style.settle(drawn)
    drawn.savefig(FIGURES / "field.png")
    print(FIGURES / "field.png")


def _draw(axes: Axes, family: str, lines: Sequence[Entry], oracle: Sequence[float]) -> None:
    for order, (name, look) in enumerate(SHOWN.items()):
        for one in lines:
            counts = [count for count in one.cells if count > 0]
            if one.seeds[0]["line"] != name or not counts:
                continue
            values = np.stack([one.cells[count].returns for count in counts], axis=-1)
            mean, low, high = statistics.curve(values).band
            axes.fill_between(counts, low, high, color=look.colour, alpha=0.15, linewidth=0)
            axes.plot(counts, mean, color=look.colour, linestyle=look.line, marker=look.marker,
                      markersize=3, label=look.label, zorder=3 + order)  # fmt: skip
    still = [one.cells[0].returns.mean() for one in lines if one.is_floor and one.cells]
    for values, line, label in ((still, ":", "learns nothing"), (oracle, "-", "knows the goal")):
        if values:
            limit = {"color": style.DARK_GREY, "linestyle": line, "linewidth": 0.8}
            axes.axhline(max(values), **limit, label=label)
    axes.set(title=family, xscale="log", xlim=(0.9, 600), xlabel="episodes")
    axes.xaxis.set_major_formatter("{x:g}")


def main(studies: tuple[str, ...] = (), out: Path = HERE.parent) -> None:
    """Write the table and the figure.

    Args:
        studies: those whose results are taken: names, or paths of files. None: what is kept.
        out: directory of the studies.
    """
    if studies:
        collect(studies, out)
    tables = entries()
    pages = [make(*item) for item in tables.items() for make in (table, differences)]
    page = to_page([one for one in pages if one.rows])
    write_whole(HERE / "table.md", f"{LEGEND}\n{page}".encode())
    print(HERE / "table.md")
    draw(tables)


if __name__ == "__main__":
    tyro.cli(main)
