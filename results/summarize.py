"""Tabulate the runs of a directory, and compare them with its first method.

    python results/summarize.py results/wheeled > results/wheeled/tables.md

Each run is a directory `METHOD-...-seed-N` that `maesn train` has filled, to its last iteration.
Those that `maesn adapt` has filled as well have tables of their adaptation, in which directories
that differ in the seed alone are taken together.
"""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from safetensors.numpy import load_file

from maesn.context import Latent, LatentContext
from maesn.reporting.comparison import Line
from maesn.reporting.reading import AdaptationTable, read_adaptation, stack_seeds
from maesn.reporting.statistics import INTERVAL, bootstrap, difference
from maesn.reporting.style import MethodStyle
from maesn.reporting.tables import (
    UNITS,
    TextTable,
    markdown_row,
    note_on_solved,
    sentences,
    update_tables,
)

REFERENCE = "maesn-20x20"


def experiments(directory: Path) -> dict[str, list[Path]]:
    """Return the finished runs of every experiment, by its name, that of the reference first."""
    found: dict[str, list[Path]] = {}
    for metrics in sorted(directory.glob("*/metrics.jsonl")):
        run = metrics.parent
        if len(metrics_of(run)) >= config_of(run)["settings"]["iterations"]:
            found.setdefault(re.sub(r"-seed-\d+$", "", run.name), []).append(run)
    return dict(sorted(found.items(), key=lambda item: (item[0] != REFERENCE, item[0])))


def adaptation_tables(runs: list[Path]) -> list[AdaptationTable]:
    """Return the tables of those runs that have been adapted."""
    files = [run / "adaptation" / "test-sparse.csv" for run in runs]
    return [read_adaptation(file) for file in files if file.exists()]


def config_of(run: Path) -> dict[str, Any]:
    """Return what a run was begun with."""
    config: dict[str, Any] = json.loads((run / "config.json").read_text())
    return config


def metrics_of(run: Path) -> list[dict[str, float]]:
    """Return what was measured in every meta-iteration."""
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]


def last_metrics(run: Path) -> dict[str, float]:
    """Return what was measured in the last meta-iterations, averaged over 20 of them."""
    lines = metrics_of(run)[-20:]
    return {name: float(np.mean([line[name] for line in lines])) for name in lines[0]}


def divergence_from_prior(run: Path) -> float | None:
    """Return the mean KL of the training tasks' latents in the last checkpoint, in nats.

    None for methods without latents.
    """
    arrays = load_file(sorted((run / "checkpoints").glob("*.safetensors"))[-1])
    names = [f"parameters/context_table/{part}" for part in ("mean", "log_std")]
    if not all(name in arrays for name in names):
        return None
    latents = Latent(*(jnp.asarray(arrays[name]) for name in names))
    return float(jax.vmap(LatentContext(kl_weight=1.0).penalty)(latents).mean())


def training_row(name: str, run: Path) -> str:
    """Return one line of the table of training."""
    last = last_metrics(run)
    divergence = divergence_from_prior(run)
    sizes = [last.get(f"step_sizes/context/{part}") for part in ("mean", "log_std", "value")]
    of_context = ", ".join(f"{size:.2f}" for size in sizes if size is not None) or "-"
    of_policy = [last[name] for name in last if name.startswith("step_sizes/policy/")]
    cells = (
        name,
        str(config_of(run)["settings"]["seed"]),
        f"{last['return_before']:.1f}",
        f"{last['return_after']:.1f}",
        "-" if divergence is None else f"{divergence:.2f}",
        of_context,
        f"{np.mean(of_policy):.3f}" if of_policy else "-",
        f"{last['action_std']:.2f}",
    )
    return markdown_row(cells)


def difference_table(
    reference: Sequence[AdaptationTable],
    others: Mapping[str, Sequence[AdaptationTable]],
    title: str,
) -> TextTable:
    """Compare last updates with a reference on the same tasks: method minus reference, paired.

    There is one table per seed, of the reference and of each method by its name.
    """
    rows, beyond = [], []
    first = stack_seeds(reference)
    for name, tables in others.items():
        line = Line(name, MethodStyle(name), tuple(range(len(tables))), stack_seeds(tables))
        cells = [name]
        for measure, unit in UNITS.items():
            ends = (getattr(table, measure)[..., -1] for table in (line.table, first))
            cells.append(unit.text(bootstrap(difference, *ends), sign="+"))
        rows.append(tuple(cells))
        beyond.append(line.beyond)
    solved = note_on_solved(first.is_solved_at_reset)
    notes = sentences(f"in brackets: {INTERVAL}", solved, *beyond)
    headings = ("method", *(unit.heading for unit in UNITS.values()))
    return TextTable(title, headings, tuple(rows), notes)


def main() -> None:
    """Print all tables as Markdown."""
    found = experiments(Path(sys.argv[1]))
    tables = {name: filled for name, runs in found.items() if (filled := adaptation_tables(runs))}
    print("# Training, mean of the last 20 meta-iterations, dense reward\n")
    print("| run | seed | before | after | KL to prior | steps of context | of θ | action std |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name, runs in found.items():
        for run in runs:
            print(training_row(name, run))
    print("\nKL to prior: of the training tasks' latents in the last checkpoint, in nats.")
    print("Steps of θ: mean over its arrays of their mean step sizes, signs included.")
    if tables:
        print("\n# Adaptation to the 100 test tasks, sparse reward\n")
    for name, all_seeds in tables.items():
        for summary in update_tables(all_seeds, f"{name}, seeds: {len(all_seeds)}"):
            print(summary.to_markdown())
    reference = tables.pop(REFERENCE, None)
    if tables and reference is not None:
        print("# Differences after the last update\n")
        title = f"method minus {REFERENCE}, paired over tasks"
        print(difference_table(reference, tables, title).to_markdown())


if __name__ == "__main__":
    main()
