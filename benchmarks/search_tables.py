"""Latent search beside other rules and beside controls: every row, and the tables of them.

    export PYTHONPATH=examples
    python benchmarks/search_tables.py --tasks validation --lines trials --out trials
    python benchmarks/search_tables.py --tasks final --out final

A row that is there is not made again, so the command can be stopped and repeated. The tables are
`tables.md` in the same directory, their numbers `curves.csv`; with `--only-show` nothing else is
made. Settings are chosen on `validation`; `final` is for one last look.
"""

import csv
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from search_rows import (
    Line,
    adapted_rows,
    archive_returns,
    ceiling_rows,
    evaluation,
    permuted,
    private_copy,
    write_row,
)
from search_summary import summarize, write_tables

from maesn.runs.process import enable_compilation_cache

GRADIENT = 50  # episodes of an update, the paper's
MAIN = {
    "search": Line(seeds=5),
    "gradient": Line("gradient", 500, GRADIENT),
    "cma_es": Line("own_searches:CmaEs", 500),
    "cross_entropy": Line("own_searches:CrossEntropy", 500),
    "best_of": Line("own_searches:BestOf", 500),
    "gradient_wide": Line("gradient start_std=3", 500, GRADIENT),
    "gradient_by_20": Line("gradient", 500, 20),
    "best_of_wide": Line("own_searches:BestOf spread=3", 500),
}
CONTROLS = {
    "discrete": Line("search residual=0"),
    "permuted": Line("search familiar=1", change=permuted),
    "stationary": Line("stationary"),
    "thompson": Line("search acquisition=thompson"),
    "archive_alone": Line("search draws=0"),
    "half_radius": Line(prior=("sparse", 0.5)),
    "wide_radius": Line(prior=("sparse", 1.5)),
    "dense_prior": Line(prior=("dense", 1.0)),
    "ood": Line(tasks="ood"),
    "ood_discrete": Line("search residual=0", tasks="ood"),
}
# What the search's rivals were chosen from, on validation tasks.
TRIALS = {
    **{f"gradient_by_{n}_scale_{scale}": Line(f"gradient step_scale={scale}", 100, n)
       for n in (5, 10, 20) for scale in (0.3, 1, 3)},
    **{f"gradient_wide_scale_{scale}":
       Line(f"gradient start_std=3 step_scale={scale}", 200, GRADIENT) for scale in (0.3, 1, 3)},
    **{f"cross_entropy_{std}_{size}":
       Line(f"own_searches:CrossEntropy spread={std} round_size={size}", 100)
       for std in (1, 3) for size in (10, 20)},
    **{f"cma_es_{spread}": Line(f"own_searches:CmaEs spread={spread}", 100) for spread in (1, 3)},
    **{f"best_of_{spread}": Line(f"own_searches:BestOf spread={spread}", 100) for spread in (1, 3)},
}  # fmt: skip
GROUPS = {"main": MAIN, "controls": CONTROLS, "trials": TRIALS}
CEILING = "ceiling"


@dataclass(frozen=True)
class Settings:
    """Which rows are made, and where they are kept."""

    out: Path
    """Directory of the rows and the tables."""
    tasks: str = "validation"
    """Task set."""
    runs: tuple[str, ...] = ("wheeled", "blockpush", "ant")
    """Policies that come with the library by name, others as NAME=DIRECTORY;
    NAME=untrained:DIRECTORY for a run before its first meta-iteration."""
    lines: tuple[str, ...] = ("main", CEILING)
    """Lines by name, or groups of them: main, controls, trials; and `ceiling`."""
    num_tasks: int | None = None
    """The first so many tasks; None: all."""
    long_tasks: int | None = None
    """The same for lines of more than 100 episodes."""
    seeds: int = 5
    """At most so many seeds of a line."""
    num_threads: int = 1
    """Threads of the physics engine; the rows do not depend on them."""
    only_show: bool = False
    """Whether to write the tables of what is there, and to make nothing."""


def wanted(settings: Settings) -> dict[str, Line]:
    """Return the lines that are asked for."""
    known = {name: line for group in GROUPS.values() for name, line in group.items()}
    found: dict[str, Line] = {}
    for name in settings.lines:
        if name != CEILING:
            found |= GROUPS.get(name) or {name: known[name]}
    return found


def make(settings: Settings) -> None:
    """Make the rows that are not there, those of the first seed first."""
    lines = wanted(settings)
    sources = (one.partition("=")[::2] for one in settings.runs)
    runs = {name: private_copy(name, source or name, settings.out) for name, source in sources}
    for seed in range(max([line.seeds for line in lines.values()], default=0)):
        for name, run in runs.items():
            for title, line in lines.items():
                path = settings.out / f"{name}-{title}-{seed}.csv"
                if seed >= min(line.seeds, settings.seeds) or path.exists():
                    continue
                if line.tasks and line.tasks not in run.family.draw_unfamiliar:
                    continue
                begin = time.perf_counter()
                count = settings.long_tasks if line.episodes > 100 else settings.num_tasks
                asked = evaluation(run, line, settings.tasks, count, seed, settings.num_threads)
                write_row(path, adapted_rows(run, line, asked))
                print(f"{path.name}: {time.perf_counter() - begin:.0f} s", flush=True)
    for name, run in runs.items():
        path = settings.out / f"{name}-{CEILING}-0.csv"
        if CEILING in settings.lines and not path.exists():
            _, returns, _ = archive_returns(run, settings.tasks, settings.out)
            write_row(path, ceiling_rows(returns))
            print(path.name, flush=True)


def main(settings: Settings) -> None:
    """Make rows, and write the tables of all that are there."""
    settings.out.mkdir(parents=True, exist_ok=True)
    enable_compilation_cache()
    if not settings.only_show:
        make(settings)
    curves: list[dict[str, Any]] = summarize(settings.out)
    with (settings.out / "curves.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(curves[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {
                n: f"{v:.5g}" if isinstance(v, float) and np.isfinite(v) else v
                for n, v in row.items()
            }
            for row in curves
        )
    (settings.out / "tables.md").write_text(write_tables(curves, settings.out))
    print(settings.out / "tables.md")


if __name__ == "__main__":
    main(tyro.cli(Settings))
