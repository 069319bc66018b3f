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
from collections.abc import Iterator, Mapping, Sequence, Set
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Float
from matplotlib.axes import Axes

from maesn.reporting import statistics, style
from maesn.reporting.reading import EXPLORE, read_adaptation
from maesn.reporting.sources import MANIFEST, joined_files
from maesn.reporting.style import METHOD_STYLES, MethodStyle
from maesn.reporting.tables import UNITS, TextTable, to_page
from maesn.storage import read_json, read_rows, write_rows, write_whole
from maesn.studies.study import Study

HERE = Path(__file__).parent / "field"
RESULTS, LINES, PUBLISHED = map(HERE.joinpath, ("results.csv.gz", "lines.csv", "published.csv"))
RESULT = ("family", "line", "seed", "task", "episodes", "return", "success")
LINE = ("family", "line", "source", "label", "kind", "tasks", "protocol", "trained_for", "seed")
LINE += ("purpose", "steps", "training", "iteration")  # of training, of a meta-iteration: seconds
LINE += ("hours_left", "job")  # digest of the job that evaluates it
FIGURES = Path(__file__).parents[1] / "docs" / "figures"
EPISODES = (0, 1, 2, 3, 5, 10, 20, 100, 500)
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
KINDS = {"lines": "method", "baselines": FLOOR}  # of the lines of a comparison
COSTS = ("seeds", "steps (M)", "minutes", "seconds")  # of training; of a meta-iteration
_PANELS = 4  # in a row
LEGEND = """\
Columns are numbers of episodes in a new task before those that are judged, which are fresh ones
without noise, on sparse reward (`cheetah_vel` and Meta-World: dense). Nothing was chosen on these
tasks; `grid_navi` has only those of training. ± is half the 95 % interval over tasks and seeds,
brackets hold its ends; ± of a published number is the spread that its source gives.

MAESN and LatentSpace by themselves adapt by policy gradient, with (search) by latent search, with
(stationary process) by the same search without training tasks, with (random latents) they deploy
the best of as many draws. An untrained policy has no meta-training, and a floor learns nothing. RL²
has a hypernetwork on `sparse_point` and `grid_navi`.

Success, the share of episodes that ever reach the goal, and worst tenth, the mean return of the
worst tenth of the tasks (CVaR, from 50 tasks on), are those after 20 episodes, or after the most
before. Lines of one method share its training, whose steps, minutes with one thread, and seconds of
a meta-iteration (median) are means over the seeds. Several trainings shared two cores, so the times
are upper bounds. What a search plays for its prior is not in them: 1 to 4 % of the steps, and on
Meta-World as many again. -: not played, more episodes than a trial in training has, or fewer than
three seeds; under success: the family defines none.

Differences are in the tasks that both lines have; above 0, search is ahead. Search plays 20
episodes at most: columns 100 and 500 set its return after 20 against that of others after so many.
"""

Row = Mapping[str, Any]
Returns = Float[np.ndarray, "seed task"]


def collect(studies: Sequence[str], out: Path) -> None:
    """Write the raw results of studies, and what their lines took or would take."""
    kept, guesses = _by_job(), _guesses()
    lines: list[Row] = []
    results: list[Row] = []
    for study in map(Study.load, studies):
        directory, execution = out / study.spec.name, study.execution(out)
        if out.resolve() != HERE.parent.resolve():  # where studies may be pruned
            directory.mkdir(parents=True, exist_ok=True)
            study.write_results(out)
        done, joined = _done(directory), joined_files(directory)
        for row, jobs in _planned(study):
            one, address = done.get(_place(row)), _address(row)
            found: tuple[Row, Sequence[Row]]
            if one is not None and joined.get(one["table"]) == jobs:
                found = _seed(row, one, directory)
            elif address in kept:
                found = {**kept[address][0], **row}, kept[address][1]
            else:
                hours = execution.hours_left(jobs)
                if not any((execution.directory / name).exists() for name in jobs):
                    hours = guesses.get(address, hours)
                found = {**row, "hours_left": hours}, ()
            lines.append(found[0])
            results += found[1]
    anew = {row["family"] for row in lines}
    _replace(LINES, lines, LINE, anew)
    _replace(RESULTS, results, RESULT, anew)


def _planned(study: Study) -> Iterator[tuple[Row, Sequence[str]]]:
    """Yield what a study says of each seed of its lines, and the jobs that compute it."""
    for comparison, (group, kind) in product(study.comparisons, KINDS.items()):
        for line in comparison.lines[group]:
            about = {"family": comparison.name, "line": line.name, "source": line.source}
            about |= {"label": LABELS.get(line.name, line.label), "kind": kind}
            about |= {"tasks": line.asked.tasks, "protocol": line.asked.protocol}
            about |= {"trained_for": line.trial_episodes}
            for member, jobs in line.seeds:
                yield about | {"seed": member.seed, "job": jobs[-1].rpartition("-")[2]}, jobs


def _done(directory: Path) -> dict[tuple[str, ...], Row]:
    """Return the seeds that the manifest of a study has, by `_place`."""
    path = directory / MANIFEST
    worlds = read_json(path)["comparisons"] if path.exists() else ()
    return {
        (world["name"], line["name"], str(one["seed"])): one
        for world, group in product(worlds, KINDS)
        for line in world[group]
        for one in line["seeds"]
    }


def _seed(row: Row, one: Row, directory: Path) -> tuple[Row, Sequence[Row]]:
    """Return what the training of a seed took, and its results in each task."""
    table = read_adaptation(directory / one["table"])
    took = {x: one.get(f"{x}_seconds") for x in ("training", "iteration")}
    numbers = [*enumerate(zip(table.mean_return, table.success_rate, strict=True))]
    results = [
        {**row, "episodes": table.episodes[k], "task": task, "return": y[k], "success": reached[k]}
        for k in np.flatnonzero(np.isin(table.episodes, EPISODES))
        for task, (y, reached) in numbers
    ]
    return {**row, "purpose": table.purpose, "steps": one["training_steps"], **took}, results


def _replace(path: Path, rows: Sequence[Row], names: Sequence[str], families: Set[str]) -> None:
    """Write rows in the place of those that a file has of the families, which keep their order."""
    before = read_rows(path) if path.exists() else []
    every = [*rows, *(row for row in before if row["family"] not in families)]
    order = list(dict.fromkeys(row["family"] for row in (*before, *every)))
    every.sort(key=lambda row: order.index(row["family"]))
    write_rows(path, [{x: _short(row.get(x)) for x in names} for row in every], names)


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


def _guesses() -> dict[tuple[str, ...], float]:
    """Return the hours that seeds in the file still take, by `_address`.

    They hold until a job of the seed is begun here: where it was begun before, its speed was seen.
    """
    rows = read_rows(LINES) if LINES.exists() else []
    return {_address(row): float(row["hours_left"]) for row in rows if row["hours_left"]}


def _place(row: Row) -> tuple[str, ...]:
    """Return where a seed stands."""
    return tuple(str(row[name]) for name in ("family", "line", "seed"))


def _address(row: Row) -> tuple[str, ...]:
    """Return what must be the same for the results of a seed to be the same."""
    return (*_place(row), row["job"])


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
    def num_tasks(self) -> int:
        """Number of tasks, the first ones; 0 if nothing is done."""
        return next((cell.returns.shape[1] for cell in self.cells.values()), 0)

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
        steps, training, each = (
            np.mean([float(row[name]) for row in self.done if row[name]] or [np.nan])
            for name in ("steps", "training", "iteration")
        )
        shown = f"{steps / 1e6:.2g}", f"{training / 60:.1f}", f"{each:.2f}"
        return seeds, *("" if text == "nan" else text for text in shown)


def entries() -> dict[str, list[Entry]]:
    """Return the lines of each family, from the raw results.

    A line that learns has no cells before three seeds of it are done: fewer say little.
    """
    raw = _by_line(RESULTS)
    tables: dict[str, list[Entry]] = {}
    for name, seeds in _by_line(LINES).items():
        beyond = int(seeds[0]["trained_for"] or max(EPISODES) + 1)
        one = Entry(seeds, dict(_cells(raw.get(name, ()), beyond)))
        shown = one.is_floor or len(one.done) >= statistics.FEWEST_SEEDS
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
    tasks = max(one.num_tasks for one in lines)
    rows = [_row(one, tasks) for one in lines]
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
    told = f"return after so many episodes in {tasks} tasks" if tasks else "to do"
    return TextTable(f"{family}: {told}", headings, tuple(rows), tuple(notes.values()))


def _row(entry: Entry, tasks: int) -> tuple[str, ...]:
    """Return the row of a line in a family's table of so many tasks."""
    unit, last = UNITS["mean_return"], entry.last
    texts = {
        count: unit.text(statistics.bootstrap(statistics.mean, cell.returns), brief=True)
        for count, cell in entry.cells.items()
    }
    few = ["", ""]
    if last is not None:
        few[0] = UNITS["success_rate"].number(last.success.mean())
        if entry.num_tasks >= statistics.FEWEST_TASKS:
            few[1] = unit.text(statistics.bootstrap(statistics.cvar, last.returns))
    first, done = entry.seeds[0], entry.done or entry.seeds
    label = f"{first['label']}, floor" if entry.is_floor else first["label"]
    if done[0]["purpose"] == EXPLORE and not entry.is_floor:
        label += ", z drawn"
    label += f", by {first['protocol']}" if first["protocol"] else ""
    label += f", {first['tasks']} tasks" if first["tasks"] != USUAL else ""
    label += f", first {entry.num_tasks} tasks" if 0 < entry.num_tasks < tasks else ""
    return (label, *(texts.get(count, "-") for count in EPISODES), *few, *entry.costs)


def differences(family: str, lines: Sequence[Entry]) -> TextTable:
    """Return how far search is ahead of other lines after as many episodes, in the same tasks.

    Search stops after `FEW`, which are set against the more episodes of others as well.
    """
    mine = [one for one in lines if one.seeds[0]["line"] == SEARCH]
    rows = []
    for search, one in product(mine, lines):
        alike = {entry.seeds[0]["tasks"] for entry in (search, one)}
        if one is search or one.is_floor or len(alike) > 1 or not (one.cells and search.cells):
            continue
        rows.append((one.seeds[0]["label"], *(_ahead(search, one, k) for k in EPISODES)))
    title = f"{family}: return of search less that of others, and its 95 % interval"
    return TextTable(title, ("", *map(str, EPISODES)), tuple(rows))


def _ahead(search: Entry, other: Entry, episodes: int) -> str:
    """Say how far search is ahead in the tasks that both have, which come first."""
    pair, mine = (search, other), min(episodes, FEW)
    if mine not in search.cells or episodes not in other.cells:
        return "-"
    tasks = min(one.num_tasks for one in pair)
    first, second = search.cells[mine].returns, other.cells[episodes].returns
    first, second = first[:, :tasks], second[:, :tasks]
    if len({(one.seeds[0]["source"], *(row["seed"] for row in one.done)) for one in pair}) == 1:
        gap = statistics.bootstrap(statistics.mean, first - second)  # of the same policies
    else:
        gap = statistics.bootstrap(
            lambda x, y: statistics.mean(x) - statistics.mean(y), first, second
        )
    return UNITS["mean_return"].text(gap)


@style.publication_style()
def draw(tables: Mapping[str, Sequence[Entry]]) -> None:
    """Draw a panel for each family in which a search has results, if there is one.

    Bands are 95 % intervals over tasks and seeds; solid the oracle, dotted what learns nothing. A
    panel has the tasks that all its lines have.
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
    by_name = {one.seeds[0]["line"]: one for one in lines if one.cells.keys() - {0}}
    shown = [(look, by_name[name]) for name, look in SHOWN.items() if name in by_name]
    tasks = min((one.num_tasks for _, one in shown), default=None)
    for order, (look, one) in enumerate(shown):
        counts = [count for count in one.cells if count > 0]
        values = np.stack([one.cells[count].returns[:, :tasks] for count in counts], axis=-1)
        mean, low, high = statistics.curve(values).band
        axes.fill_between(counts, low, high, color=look.colour, alpha=0.15, linewidth=0)
        axes.plot(counts, mean, color=look.colour, linestyle=look.line, marker=look.marker,
                  markersize=3, label=look.label, zorder=3 + order)  # fmt: skip
    floors = [one for one in lines if one.is_floor and one.cells]
    still = [one.cells[0].returns[:, :tasks].mean() for one in floors]
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
